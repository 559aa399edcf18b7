"""How well a log is localised in a finished map, and how sessions join.

python benchmarks/localisation_logs.py [CASE...] [--data FOLDER] [--keep FOLDER] [--set KEY=VALUE]

Cases: apartment, kidnap, grid, intel, fr079, neato, starts, offices, merge, office; all but office
when none is named. Maps and logs are made in a folder that `--keep` names, and used again from it.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from common import DATA
from localisation_scores import head, report, show_kidnapping
from ros_grids import grid_of_bag

from cli.main import group
from formats.database import open_store
from formats.grid_files import read_grid
from formats.logs import open_log
from formats.trajectory_files import read_trajectory
from mapmyworld.api import Silent
from mapmyworld.config import Config
from mapmyworld.config.settings import apply_settings
from mapmyworld.localisation import localise_log
from mapmyworld.stages.plan_log import plan_log
from mapmyworld.types import Trajectory
from mapmyworld.types.localisation import Localisation, State


@dataclass(frozen=True)
class Bench:
    """Where things are made, and with which settings."""

    folder: Path
    data: Path
    config: Config

    def make(self, name: str, *arguments: object) -> Path:
        """A file of the folder, made by one of the program's commands unless it is there."""
        path = self.folder / name
        if not path.exists():
            run(*arguments, "-o", path)
        return path

    def simulated(self, name: str, world: str, *more: object) -> Path:
        return self.make(f"{name}.mcap", "simulate", world, "--no-camera", *more)

    def built(self, name: str, log: Path) -> Path:
        return self.make(f"{name}.db", "build", log)

    def localised(self, where: Path, log: Path) -> tuple[Localisation, float]:
        """What was found, and the CPU seconds that it took."""
        source, begun = open_log([log]), time.process_time()
        plan = plan_log(source, self.config, Silent())
        if where.suffix == ".yaml":
            found = localise_log(read_grid(where), source, plan, self.config, Silent())
        else:
            with open_store(where, read_only=True) as store:
                found = localise_log(store, source, plan, self.config, Silent())
        return found, time.process_time() - begun


def run(*arguments: object) -> int:
    """The exit code of one of the program's commands."""
    try:
        group.main([*map(str, arguments), "-q"], standalone_mode=False)
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def apartment(bench: Bench) -> None:
    known = bench.built("flat", bench.simulated("flat", "apartment"))
    for seed in (1, 2, 3):
        log = bench.simulated(f"second_{seed}", "apartment", "--route", "second", "--seed", seed)
        truth = read_trajectory(Path(f"{log}.truth") / "trajectory.tum")
        report(f"apartment, second start, seed {seed}", *bench.localised(known, log), truth)


def kidnap(bench: Bench) -> None:
    known = bench.built("flat", bench.simulated("flat", "apartment"))
    for seed in (2, 3, 4):
        log = bench.simulated(f"kidnap_{seed}", "apartment", "--route", "kidnap", "--seed", seed)
        truth = read_trajectory(Path(f"{log}.truth") / "trajectory.tum")
        found, cpu_s = bench.localised(known, log)
        report(f"apartment, kidnapped, seed {seed}", found, cpu_s, truth)
        show_kidnapping(found, truth)


def halves(name: str, seconds: int) -> Callable[[Bench], None]:
    """The map of a log's first half, its second half in it; the truth is the whole log's map."""

    def run(bench: Bench) -> None:
        log = bench.data / "laser" / f"{name}.clf.bz2"
        first = bench.make(f"{name}_1.mcap", "convert", log, "--duration", seconds)
        second = bench.make(f"{name}_2.mcap", "convert", log, "--start", seconds)
        half, whole = bench.built(f"{name}_1", first), bench.built(name, log)
        with open_store(whole, read_only=True) as store:
            final = store.frame_poses()
            assert final is not None
            path = Trajectory(store.tracked_frames().stamps_ns, final)
        report(f"{name}, second half", *bench.localised(half, second), path)

    return run


def neato(bench: Bench) -> None:
    """A grid that another program made while it localised the same robot."""
    log = bench.data / "bags" / "neato_with_particle_filter.bag"
    where = grid_of_bag(log, bench.folder / "neato.yaml")
    found, cpu_s = bench.localised(where, log)
    fits = [e.fit for e in found.estimates if e.state != State.LOST]
    print(
        f"neato in a grid of another program: found after {found.recognised_after_s:.1f} s (it "
        f"stands for 16 s), claimed {1 - found.share(State.LOST):.1%}, scans agree with the grid "
        f"by {np.median(fits):.1%} (median), {cpu_s:.1f} CPU s"
    )


def grid(bench: Bench) -> None:
    """The same drives against the bare PGM and YAML."""
    bench.built("flat", bench.simulated("flat", "apartment"))
    log = bench.simulated("second_1", "apartment", "--route", "second", "--seed", 1)
    truth = read_trajectory(Path(f"{log}.truth") / "trajectory.tum")
    found = bench.localised(bench.folder / "flat.yaml", log)
    report("apartment, second start, bare grid of ours", *found, truth)
    perfect = bench.folder / "flat.mcap.truth" / "grid.yaml"
    report("apartment, second start, true grid", *bench.localised(perfect, log), truth)


_STARTS = {
    "apartment": (
        "start:0,2.6,45 0.4,3.6 7.0,3.6 7.2,0.6 6.6,-0.7 4.6,-0.7 2.6,-0.5 0,0 0,2.6",
        "start:4.6,-0.7,180 2.6,-0.5 0,0 0,2.6 0.4,3.6 7.0,3.6 turn:180 0.4,3.6",
        "start:7.0,3.6,90 turn:-170 7.2,0.6 6.6,-0.7 4.6,-0.7 kidnap:0,2.6,-90 0,0 2.6,-0.5",
    ),
    "hall": (
        "start:0,5,-90 0,0 9,0 9,5 0,5",
        "start:9,0,135 0,5 0,0 9,0",
        "start:4,0,90 4,5 9,5 kidnap:0,0,0 4,0 9,0 9,5",
    ),
}


def starts(bench: Bench) -> None:
    """Other seeds, starts and headings than anything was tried with; the hall is ambiguous."""
    for world, routes in _STARTS.items():
        known = bench.simulated(f"{world}_21", world, "--laps", 1, "--seed", 21)
        for number, route in enumerate(routes):
            name = f"{world}_{31 + number}"
            log = bench.simulated(name, world, "--laps", 1, "--seed", 31 + number, "--route", route)
            truth = read_trajectory(Path(f"{log}.truth") / "trajectory.tum")
            report(name, *bench.localised(bench.built(known.stem, known), log), truth)


def offices(bench: Bench) -> None:
    """A lap of the office from other places in the map of one lap."""
    drive = bench.simulated("office", "office", "--laps", 1, *_COARSE)
    known = bench.built("office_lap", drive)
    for number in (3, 6):
        log = office_log(bench, number)
        truth = read_trajectory(Path(f"{log}.truth") / "trajectory.tum")
        report(f"office, session {number + 1}", *bench.localised(known, log), truth)


def merge(bench: Bench) -> None:
    """Two sessions of one flat; then a flat and a hall."""
    flat = bench.built("flat", bench.simulated("flat", "apartment"))
    second = bench.built(
        "second_1", bench.simulated("second_1", "apartment", "--route", "second", "--seed", 1)
    )
    hall = bench.built("hall", bench.simulated("hall", "hall"))
    for name, maps in (("flat + second", (flat, second)), ("second + flat", (second, flat)),
                       ("flat + hall", (flat, hall))):  # fmt: skip
        out = bench.folder / f"{name.replace(' ', '')}.db"
        with cost() as spent:
            code = run("merge", *maps, "-o", out, "--no-export")
        print(f"merge {name}: exit code {code}; {spent()}")
    ordered = [(bench.folder / f"{n}.db").read_bytes() for n in ("flat+second", "second+flat")]
    print("any order, the same bytes:", ordered[0] == ordered[1])


_COARSE = ("--set", "laser.rate=5", "--set", "laser.beams=361")
_CORNERS = ((-6.0, 0.0), (36.0, 0.0), (36.0, 20.5), (-6.0, 20.5))  # m, of the office's corridors


def office_log(bench: Bench, number: int) -> Path:
    """A lap of the office's corridors, each from another place, every other one the other way."""
    corners = np.array(_CORNERS)[:: 1 if number % 2 == 0 else -1]
    first, share = number * 3 % 4, 0.1 + 0.08 * number
    a, b = corners[first], corners[(first + 1) % 4]
    start, heading = a + share * (b - a), np.degrees(np.arctan2(*(b - a)[::-1]))
    way = [corners[(first + k) % 4] for k in range(1, 5)]
    steps = [f"{x:g},{y:g}" for x, y in (*way, start)]
    route = f"start:{start[0]:g},{start[1]:g},{heading:g} {' '.join(steps)}"
    return bench.simulated(
        f"office_{number}", "office", "--laps", 1, "--seed", number, "--route", route, *_COARSE
    )


def office(bench: Bench) -> None:
    """Ten sessions of one office, added one after the other; each is built first."""
    known = bench.folder / "office.db"
    known.unlink(missing_ok=True)
    for number in range(10):
        log = office_log(bench, number)
        with cost() as spent:
            run("build", "--append", known, log, "--no-export")
        print(f"session {number + 1}: {spent()}, {known.stat().st_size / 1e6:.0f} MB", flush=True)


@contextmanager
def cost() -> Any:
    """Gives the CPU seconds of a block and the peak memory of this process, as text."""
    reported: list[str] = []
    begun = time.process_time()
    yield lambda: reported[0]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    reported.append(f"{time.process_time() - begun:.1f} CPU s, {peak:.0f} MB at most")


CASES: dict[str, Callable[[Bench], None]] = {
    "apartment": apartment,
    "kidnap": kidnap,
    "grid": grid,
    "intel": halves("intel", 1345),
    "fr079": halves("fr079", 530),
    "neato": neato,
    "starts": starts,
    "offices": offices,
    "merge": merge,
    "office": office,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", choices=[[], *CASES], help="what to run")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--keep", type=Path, help="folder for maps and logs")
    parser.add_argument("--set", dest="changes", action="append", default=[], metavar="KEY=VALUE")
    options = parser.parse_args()
    changes = dict(change.split("=", 1) for change in options.changes)
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        bench = Bench(folder, options.data, apply_settings(Config(), changes))
        head()
        for case in options.cases or [name for name in CASES if name != "office"]:
            CASES[case](bench)


if __name__ == "__main__":
    main()
