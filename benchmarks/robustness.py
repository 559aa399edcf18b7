"""What broken files, killed builds, full disks and long drives do to mapmyworld.

python benchmarks/robustness.py fuzz-logs --count 20000
python benchmarks/robustness.py fuzz-logs --count 2500 --first 5000
python benchmarks/robustness.py fuzz-maps --count 5000
python benchmarks/robustness.py fuzz-graphs --count 2000
python benchmarks/robustness.py fuzz-files --count 2000
python benchmarks/robustness.py settings
python benchmarks/robustness.py cuts --count 200
python benchmarks/robustness.py kills --count 100
python benchmarks/robustness.py signals --count 20
python benchmarks/robustness.py full-disk --count 500
python benchmarks/robustness.py long-drive --count 20 --only /big/disk
"""

from __future__ import annotations

import argparse
import itertools
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is there

from robust import (  # noqa: E402
    corpus,
    cuts,
    full_disk,
    fuzzing,
    kills,
    long_drive,
    settings_ends,
    signals,
    small_files,
    trials,
)  # fmt: skip

INSPECT = ("inspect", "log", "FILE")
_QUICK, _CONVERT = (*INSPECT, "--quick"), ("convert", "FILE", "-o", "OUT.mcap")
LOG_COMMANDS = [  # in turn; what costs most comes least often
    INSPECT, _QUICK, _CONVERT, INSPECT, _QUICK, _CONVERT, ("build", "FILE", "-o", "OUT.db", "-q"),
    INSPECT, _QUICK, _CONVERT, (*INSPECT, "--format", "json"), _CONVERT,
]  # fmt: skip
MAP_COMMANDS = [
    ("inspect", "map", "FILE"), ("inspect", "graph", "FILE", "--all"),
    ("export", "trajectory", "FILE", "-o", "OUT.tum"), ("export", "grid", "FILE", "-o", "OUT"),
    ("export", "graph", "FILE", "-o", "OUT.g2o"), ("inspect", "node", "FILE", "2"),
    ("export", "cloud", "FILE", "-o", "OUT.ply"), ("export", "images", "FILE", "-o", "OUT"),
    ("inspect", "log", "FILE"), ("optimise", "FILE", "-o", "OUT.g2o"),
    ("check", "FILE", "--require", "nodes >= 0"), ("export", "report", "FILE", "-o", "OUT.html"),
]  # fmt: skip
GRAPH_COMMANDS = [
    ("optimise", "FILE", "-o", "OUT.g2o"),
    ("optimise", "FILE", "--robust", "-o", "OUT.g2o"),
]

_FEW_LINES = 20  # of a CARMEN log, of which a map of one node is made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", choices=sorted(PARTS))
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="case to begin with, of fuzz-*")
    parser.add_argument("--only", default="", help="sources whose name contains this")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="robustness-") as folder:
        PARTS[options.part](options, Path(folder))


def _fuzz_logs(options: argparse.Namespace, folder: Path) -> None:
    _fuzz(corpus.make_logs(folder / "logs"), LOG_COMMANDS, options)


def _fuzz_maps(options: argparse.Namespace, folder: Path) -> None:
    log = next(path for path in corpus.make_logs(folder / "logs") if path.name == "whole.mcap")
    _fuzz(corpus.make_maps(folder / "maps", log), MAP_COMMANDS, options)


def _fuzz_graphs(options: argparse.Namespace, folder: Path) -> None:
    graphs, grids = corpus.make_graphs(folder / "graphs"), corpus.make_grids(folder / "grids")
    half = argparse.Namespace(**{**vars(options), "count": options.count // 2})
    _fuzz(graphs, GRAPH_COMMANDS, half)
    truth = str(grids[0] / "map.yaml")
    _fuzz(grids, [("evaluate", "grid", "FILE", truth)], half)


def _fuzz_files(options: argparse.Namespace, folder: Path) -> None:
    logs = corpus.make_logs(folder / "logs")
    whole = next(path for path in logs if path.name == "whole.mcap")
    log = _short_log(next(path for path in logs if path.name == "a.log"), folder)
    made = small_files.make_files(
        folder / "files", log, corpus.make_maps(folder / "maps", whole)[0]
    )
    chosen = [file for file in made if options.only in file.path.name]
    last = options.first + options.count
    cases = itertools.islice(small_files.cases(chosen, last, options.seed), options.first, None)
    _tell(fuzzing.fuzz(cases, _progress))


def _fuzz(
    sources: list[Path], commands: list[tuple[str, ...]], options: argparse.Namespace
) -> None:
    sources = [source for source in sources if options.only in source.name]
    with tempfile.TemporaryDirectory(prefix="robustness-") as name:  # compile before the workers
        for source, command in itertools.product(sources[:1], dict.fromkeys(commands)):
            places = {"FILE": str(source), "OUT": f"{name}/out"}
            trials.try_command([fuzzing.replaced(word, places) for word in command], seconds=600.0)
    _tell(fuzzing.fuzz(_chosen(sources, commands, options), _progress))


def _tell(done: fuzzing.Tally) -> None:
    reported = ", ".join(f"{count} x {code}" for code, count in sorted(done.exits.items()))
    print(f"{done.cases} files: exit codes {reported}")
    print(
        f"peak {done.peak_mb:.0f} MB, slowest {done.slowest_s:.1f} CPU s, "
        f"all {done.cpu_s:.0f} CPU s"
    )


def _chosen(
    sources: list[Path], commands: list[tuple[str, ...]], options: argparse.Namespace
) -> Iterator[fuzzing.Case]:
    """`count` cases from the first on: a campaign may be run in parts."""
    last = options.first + options.count
    return itertools.islice(
        fuzzing.cases(sources, commands, last, options.seed), options.first, None
    )


def _progress(tally: fuzzing.Tally) -> None:
    """How far it has come, and the faults found since the last word."""
    print(f"  {tally.cases} done, {len(tally.faults)} faults, {tally.cpu_s:.0f} CPU s", flush=True)
    while tally.reported < len(tally.faults):
        case, fault = tally.faults[tally.reported]
        command = " ".join(case.command)
        print(f"\n{case.source.name} seed {case.seed}: {command}\n{fault}", flush=True)
        tally.reported += 1


def _kill_builds(options: argparse.Namespace, folder: Path) -> None:
    logs = {path.name: path for path in corpus.make_logs(folder / "logs")}
    builds = {
        "laser": (logs["a.log"], ()),
        "RGB-D": (logs["whole.mcap"], ("--set", "sensing.use_scans=false")),
        "FastSLAM": (logs["a.log"], ("--method", "fastslam")),
        "all sensors": (logs["whole.mcap"], ()),
    }
    for name, (log, settings) in builds.items():
        if options.only not in name:
            continue
        count = -(-options.count // len(builds))
        found = kills.kill_builds(log, settings, count, options.seed, lambda _: None)
        reported = ", ".join(f"{n} x {stage}" for stage, n in sorted(found.after.items()))
        print(f"{name}: {found.kills} killed ({found.late} of them too late), after: {reported}")
        print(
            f"  {found.stages_kept} finished stages kept, {len(found.repeated)} done again; "
            f"{len(found.different)} files differ; {len(found.unusable)} maps unusable",
            flush=True,
        )
        for fault in found.faults:
            print(f"  {fault}")


def _short_log(log: Path, folder: Path) -> Path:
    short = folder / "short.log"
    short.write_text("".join(log.read_text().splitlines(keepends=True)[:_FEW_LINES]))
    return short


def _fill_disks(options: argparse.Namespace, folder: Path) -> None:
    """Of a drive so short that every write can be tried; `--only NAME` takes another log."""
    logs = {path.name: path for path in corpus.make_logs(folder / "logs")}
    log = logs[options.only] if options.only else _short_log(logs["a.log"], folder)
    print("\n".join(full_disk.summary_lines(full_disk.fill_disks(log, (), options.count))))


def _end_commands(options: argparse.Namespace, folder: Path) -> None:
    log = next(path for path in corpus.make_logs(folder / "logs") if path.name == "whole.mcap")
    signals.end_all(log, options.count, options.seed, options.only)


def _try_settings(options: argparse.Namespace, folder: Path) -> None:
    """`--only visual.` tries the settings whose names begin so."""
    logs = {path.name: path for path in corpus.make_logs(folder / "logs")}
    for log in (_short_log(logs["a.log"], folder), logs["whole.mcap"]):
        tried, faults = settings_ends.try_ends(log, folder, options.only)
        print(f"{log.name}: {tried} builds, {len(faults)} faults", *faults, sep="\n", flush=True)


def _cut_logs(options: argparse.Namespace, folder: Path) -> None:
    logs = {path.name: path for path in corpus.make_logs(folder / "logs")}
    for name in ("bare.mcap", "plain.mcap", "whole.mcap", "whole.bag", "bz2.bag"):
        for kind in ("cut", "flip"):
            scratch = folder / f"damaged{logs[name].suffix}"
            found = cuts.cut_everywhere(logs[name], scratch, options.count, kind)
            kinds = ", ".join(f"{n} in {kind}" for kind, n in sorted(found.kinds.items()))
            print(f"{name}: {kind} at {found.tried} places ({kinds})")
            print(f"  {found.lost} messages lost in all, {len(found.faults)} faults", flush=True)
            for fault in found.faults[:10]:
                print(f"  {fault}")


def _long_drive(options: argparse.Namespace, folder: Path) -> None:
    """`--count` is in gigabytes; `--only` may name a folder on a disk with room for it."""
    path = (Path(options.only) if options.only else folder) / "long.mcap"
    try:
        count = long_drive.write_drive(path, options.count)
        print(f"{count} messages written", flush=True)
        for name, value in long_drive.build_drive(path, ["--max-memory", "1500"]).items():
            print(f"{name}: {value}", flush=True)
    finally:
        path.unlink(missing_ok=True)


PARTS = {
    "cuts": _cut_logs,
    "long-drive": _long_drive,
    "full-disk": _fill_disks,
    "fuzz-logs": _fuzz_logs,
    "fuzz-maps": _fuzz_maps,
    "fuzz-files": _fuzz_files,
    "fuzz-graphs": _fuzz_graphs,
    "kills": _kill_builds,
    "settings": _try_settings,
    "signals": _end_commands,
}

if __name__ == "__main__":
    main()
