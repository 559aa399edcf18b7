"""A newcomer's first hour: what was broken there, done again as a user would, one line each.

    python benchmarks/first_hour.py             # all items
    python benchmarks/first_hour.py 7 12        # some of them

Runs the installed command on sample_logs, on simulated logs and, where they are, on ../shared/data;
prints what was run, what came, and whether that is as it should be. Exit code 1 where it is not.
Items are functions `(desk) -> Came` in ITEMS; 19 is what the first minute shows.
"""

from __future__ import annotations

import json
import os
import pty
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from common import DATA, ROOT

SAMPLES = ROOT / "sample_logs"
APARTMENT = SAMPLES / "apartment.mcap"
LASER = ("/graph_slam_bot/laser/scan", "/odom", "/tf", "/tf_static")
_SHOWN = 110  # characters of what came


@dataclass(frozen=True)
class Came:
    """What one item gave."""

    run: str
    reported: str
    ok: bool | None
    """None where it could not be tried."""


class Desk:
    """A folder to work in, and the command."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def run(self, *words: object) -> subprocess.CompletedProcess[str]:
        """`mapmyworld` with these words, in the folder."""
        return subprocess.run(
            [sys.executable, "-m", "cli.main", *map(str, words)],
            cwd=self.folder,
            capture_output=True,
            text=True,
            check=False,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
        )

    def json(self, *words: object) -> dict[str, object]:
        """What it prints with --format json."""
        return dict(json.loads(self.run(*words, "--format", "json").stdout))

    def at_a_terminal(self, *words: object) -> str:
        """What it shows on a terminal."""
        shown = list[bytes]()

        def keep(handle: int) -> bytes:
            shown.append(os.read(handle, 65536))
            return shown[-1]

        here = Path.cwd()
        os.chdir(self.folder)
        silence = os.dup(1)
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 1)
            try:
                pty.spawn([sys.executable, "-m", "cli.main", *map(str, words)], keep)
            finally:
                os.dup2(silence, 1)
                os.chdir(here)
        return b"".join(shown).decode("utf-8", "replace")

    def simulated(self, name: str, *options: object) -> Path:
        """A short drive in a simulated apartment, without a camera."""
        path = self.folder / f"{name}.mcap"
        if not path.exists():
            words = ("simulate", "apartment", "-o", path, "--no-camera", "-q", *options)
            done = self.run(*words)
            assert path.exists(), done.stderr
        return path

    def sample_map(self, name: str = "hall.bag") -> Path:
        """The map of one of sample_logs."""
        path = (self.folder / name).with_suffix(".db")
        if not path.exists():
            self.run("build", SAMPLES / name, "-o", path, "-q")
        return path

    def apartment(self) -> Path:
        """The map of the log that has a camera."""
        return self.sample_map(APARTMENT.name)


def several_drives(desk: Desk) -> Came:
    """1: logs of different drives are refused in one line."""
    done = desk.run("build", SAMPLES)
    lines = done.stderr.strip().splitlines()
    ok = done.returncode == 2 and len(lines) == 1 and "batch" in lines[0]
    return Came("build sample_logs", lines[-1], ok)


def batch_of_a_folder(desk: Desk) -> Came:
    """1: and `batch FOLDER` makes a map of each."""
    done = desk.run("batch", SAMPLES, "-q")
    return Came("batch sample_logs", _last(done), done.returncode in (0, 3))


def appended(desk: Desk) -> Came:
    """3: what stands beside an extended map is of that map; jumps are no path."""
    desk.run("build", desk.simulated("one"), "-o", "both.db", "-q")
    alone = desk.json("inspect", "map", "both.db")
    for ending in (".ply", ".html"):
        (desk.folder / "both").with_suffix(ending).write_text("stale")
    again = desk.simulated("again", "--seed", 1)
    desk.run("build", "--append", "both.db", again, "-q")
    both = desk.json("inspect", "map", "both.db")
    page = (desk.folder / "both.html").read_text("utf-8")
    ratio = both["length_m"] / alone["length_m"]  # type: ignore[operator]
    ok = (
        both["sessions"] == 2
        and "stale" not in page
        and ratio < 2.1
        and (desk.folder / "both.timing.json").exists()
    )
    reported = f"{both['sessions']} sessions, path {ratio:.2f} times that of one; report is new"
    return Came("build --append both.db again.mcap", reported, ok)


def carmen_at_a_terminal(desk: Desk) -> Came:
    """7: no literal code ends the output."""
    log = DATA / "laser" / "mit-csail.clf.bz2"
    if not log.exists():
        return _absent(log)
    shown = desk.at_a_terminal("inspect", "log", log, "--quick")
    return Came("inspect log mit-csail", shown.strip().splitlines()[-1], "\\x1b" not in shown)


def failed_build(desk: Desk) -> Came:
    """8: it leaves no map."""
    path = desk.folder / "imu_only.mcap"
    desk.run("convert", SAMPLES / "apartment.mcap", "-o", path, "--topic", "/imu", "-q")
    done = desk.run("build", path, "-o", "dead.db", "-q")
    left = (desk.folder / "dead.db").exists()
    return Came("build imu_only.mcap", f"exit {done.returncode}, map left: {left}", not left)


def figures_agree(desk: Desk) -> Came:
    """9: terminal, report and `inspect map` show the same."""
    built = desk.json("build", SAMPLES / "hall.bag", "-o", "figures.db", "-q")
    seen = desk.json("inspect", "map", "figures.db")
    page = (desk.folder / "figures.html").read_text("utf-8")
    path, seconds = f"{built['distance_m']:.1f} m", f"{built['duration_s']:.0f} s"
    ok = built["distance_m"] == seen["length_m"] and built["duration_s"] == seen["duration_s"]
    ok = ok and f"<dd>{path}</dd>" in page and f"<dd>{seconds}</dd>" in page
    return Came("build, inspect map, report", f"{path} in {seconds} in all three: {ok}", ok)


def markdown(desk: Desk) -> Came:
    """11: code spans hold what was given."""
    options = ("--require", "nodes < 5", "--markdown", "check.md", "--allow-partial")
    desk.run("check", desk.sample_map(), *options)
    row = (desk.folder / "check.md").read_text("utf-8").splitlines()[-1]
    return Came("check --markdown", row, "`nodes < 5`" in row)


def shares(desk: Desk) -> Came:
    """11: no share that misses a limit is shown as that limit."""
    found = desk.run("inspect", "graph", desk.sample_map(), "--all").stdout
    same = [line for line in found.splitlines() if "overlap 70% below 70%" in line]
    return Came("inspect graph --all", f"{len(same)} of 'overlap 70% below 70%'", not same)


def typos(desk: Desk) -> Came:
    """12: what is mistyped is reported; American spelling is understood."""
    reported = [desk.run(*words.split()).stderr for words in ("biuld", "inspct")]
    asked = desk.run("build", "x.bag", "--resolution", "0.1").stderr
    american = [desk.run(name, "--help").returncode for name in ("localize", "optimize")]
    ok = "'build'" in reported[0] and "'inspect'" in reported[1] and american == [0, 0]
    ok = ok and "mapping.resolution" in asked and "--resume" not in asked
    return Came("biuld, inspct, localize, --resolution", asked.strip().splitlines()[-1], ok)


def inspect_file(desk: Desk) -> Came:
    """12: `inspect FILE` shows the log."""
    done = desk.run("inspect", SAMPLES / "hall.bag", "--quick")
    first = done.stdout.partition("\n")[0]
    return Came("inspect hall.bag", first, "hall.bag" in first)


def clock_set_back(desk: Desk) -> Came:
    """15: what follows a clock that was set back by 7 s is moved, and that is said."""
    from formats.logs import open_log
    from formats.recording_files import LogWriter
    from mapmyworld.types import TransformsMessage

    path, plain = desk.folder / "set_back.mcap", desk.simulated("one")
    middle, back = open_log([plain]).info().start_ns + 30 * 10**9, 7 * 10**9
    with LogWriter(path) as writer:
        for raw in open_log([plain]).messages():
            late = back if raw.log_time_ns >= middle else 0
            if raw.topic == "/robot_description":
                continue
            message = raw.decode()
            if isinstance(message, TransformsMessage):
                moved = (replace(t, stamp_ns=t.stamp_ns - late) for t in message.transforms)
                message = replace(message, transforms=tuple(moved))
            else:
                message = replace(message, stamp_ns=message.stamp_ns - late)
            writer.write(raw.topic, message, raw.log_time_ns - late)
    done = desk.run("build", path, "-o", "set_back.db", "-q", "--no-export")
    first = done.stdout.partition("\n")[0]
    ok = done.returncode == 3 and "the clock was set back by 7.0 s" in done.stderr
    return Came("build set_back.mcap", f"exit {done.returncode}, {first}", ok)


def blind_laser(desk: Desk) -> Came:
    """15: a log whose scans are all invalid is mapped with its camera."""
    from formats.logs import open_log
    from formats.recording_files import LogWriter
    from mapmyworld.types import LaserScanMessage

    path = desk.folder / "blind.mcap"
    with LogWriter(path) as writer:
        for raw in open_log([SAMPLES / "apartment.mcap"]).messages():
            if raw.log_time_ns == 0 or raw.topic == "/robot_description":
                continue
            message = raw.decode()
            if isinstance(message, LaserScanMessage):
                message = replace(message, ranges=np.zeros_like(message.ranges))
            writer.write(raw.topic, message, raw.log_time_ns)
    done = desk.run("build", path, "-o", "blind.db", "-q", "--no-export")
    return Came("build blind.mcap", f"exit {done.returncode}: {_last(done)}", done.returncode == 3)


def optimised_here(desk: Desk) -> Came:
    """16: the result goes into the current folder."""
    graph = DATA / "graphs" / "tinyGrid3D.g2o"
    if not graph.exists():
        return _absent(graph)
    done = desk.run("optimise", graph)
    here = (desk.folder / "tinyGrid3D_optimised.g2o").exists()
    return Came(f"optimise {graph.name}", f"exit {done.returncode}, in this folder: {here}", here)


def rates(desk: Desk) -> Came:
    """18: rates are those of the messages."""
    found = desk.json("inspect", "log", SAMPLES / "apartment.mcap", "--quick")
    topics = {t["topic"]: t["frequency_hz"] for t in found["log"]["topics"]}  # type: ignore[index]
    info, image = (rate for name, rate in topics.items() if "/camera_ir/rgb" in name)
    ok = bool(np.isclose(info, image, rtol=0.01))
    return Came("inspect log apartment", f"camera_info {info:.2f} Hz, images {image:.2f} Hz", ok)


def merged_camera(desk: Desk) -> Came:
    """2: a camera session merged with an earlier one of the laser alone."""
    topics = [word for topic in LASER for word in ("--topic", topic)]
    desk.run("convert", APARTMENT, "-o", "laser.mcap", *topics)
    desk.run("convert", APARTMENT, "-o", "camera.mcap", "--start", 3)
    for name in ("laser", "camera"):
        desk.run("build", f"{name}.mcap", "-o", f"{name}.db", "-q", "--no-export")
    done = desk.run("merge", "laser.db", "camera.db", "-o", "merged.db", "-q")
    reported = desk.run("inspect", "map", "merged.db").stdout
    line = next(line.strip() for line in reported.splitlines() if "camera:" in line)
    has_cloud = (desk.folder / "merged.ply").exists()
    ok = "none" not in line and has_cloud
    return Came(
        "merge laser.db camera.db", f"exit {done.returncode}; {line}; cloud: {has_cloud}", ok
    )


def relations_of_a_part(desk: Desk) -> Came:
    """4: relations of a whole drive against a map of a part of it."""
    rows = np.loadtxt(desk.apartment().with_suffix(".tum"))
    moments = [(rows[0, 0], rows[0, 0] + 1e6)] * 8 + [(rows[0, 0], rows[0, 0])] * 2
    lines = [f"{a:.6f} {b:.6f} 0 0 0 0 0 0\n" for a, b in moments]
    (desk.folder / "a.relations").write_text("".join(lines))
    done = desk.run("evaluate", "relations", "apartment.db", "a.relations")
    first = done.stdout.partition("\n")[0]
    ok = done.returncode == 3 and "2 relations" in done.stdout + done.stderr
    return Came("evaluate relations", f"exit {done.returncode}; {first}", ok)


def smaller_voxels(desk: Desk) -> Came:
    """5: points of clouds with ever smaller voxels."""
    desk.apartment()
    counts = []
    for voxel in (0.05, 0.02, 0.01):
        desk.run("export", "cloud", "apartment.db", "-o", "c.ply", "--voxel", voxel)
        head = (desk.folder / "c.ply").read_bytes()[:400].decode("ascii", "replace")
        counts.append(int(head.split("element vertex ")[1].split()[0]))
    return Came("export cloud", f"{counts} points at 5, 2, 1 cm", counts == sorted(counts))


def contradicted_edit(desk: Desk) -> Came:
    """6: a wrong addition is reported, with what it cost and what fights it."""
    shutil.copy(desk.apartment(), desk.folder / "edited.db")
    (desk.folder / "e.toml").write_text(
        '[[add]]\nfrom = 3\nto = 150\npose = [4.2, 0, 90]\nsigma = [0.05, 2]\nreason = "wrong"\n'
    )
    done = desk.run("edit", "edited.db", "e.toml", "-q")
    reported = done.stdout + done.stderr
    fine = (
        done.returncode == 3
        and "is contradicted" in reported
        and "contradict the edits" in reported
    )
    between = desk.run("inspect", "graph", "edited.db", "--between", 1, 50).stdout
    turn = next(line for line in between.splitlines() if "turned" in line).split("turned ")[1]
    lost = reported.count("  rejected: ")
    shown = f"exit {done.returncode}; {lost} constraints named as lost; turned {turn}"
    return Came("edit edited.db e.toml", shown, fine and turn[0] in "+-")


def late_odometry(desk: Desk) -> Came:
    """10: settings that shift stamps, and messages that troubleshooting holds."""
    shift = ("--set", "sensing.odometry_offset=0.12")
    done = desk.run("build", APARTMENT, "-o", "shifted.db", "--no-export", *shift)
    page = (ROOT / "docs" / "troubleshooting.md").read_text("utf-8")
    known = all(words in page for words in ("has the wrong sign", "header stamps step back"))
    reported = f"exit {done.returncode}; messages in troubleshooting: {known}"
    return Came(" ".join(shift), reported, done.returncode == 0 and known)


def python_paths(desk: Desk) -> Came:
    """13: the library with paths, and its completion."""
    code = (
        "import mapmyworld as m\n"
        f"built = m.build({str(APARTMENT)!r}, into='python.db')\n"
        "print(built.result.nodes, len(m.export(built, 'out')), len(m.to_arrays(built)))\n"
        "print({'build', 'localise', 'merge', 'edit', 'export'} <= set(dir(m)))\n"
    )
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=desk.folder, check=False
    )
    reported = " ".join(found.stdout.split()) or found.stderr[-200:]
    return Came("mapmyworld.build(path)", reported, "True" in found.stdout)


def symmetric_information(desk: Desk) -> Came:
    """14: information matrices that differ from their transpose."""
    with closing(sqlite3.connect(desk.apartment())) as database:
        blobs = [row[0] for row in database.execute("SELECT information_matrix FROM Link")]
    matrices = np.stack([np.frombuffer(blob, "<f8").reshape(6, 6) for blob in blobs])
    wrong = int((matrices != matrices.transpose(0, 2, 1)).any(axis=(1, 2)).sum())
    return Came("map.db", f"{wrong} of {len(blobs)} differ from their transpose", wrong == 0)


def sensors_left_out(desk: Desk) -> Came:
    """17: real logs whose sensors no map can use yet: refused, or partial, with the reason."""
    logs = [DATA / name for name in ("lidar3d/hku_1.mcap", "imu/euroc_v1_01.mcap")]
    absent = [log for log in logs if not log.exists()]
    if absent:
        return _absent(absent[0])
    done = [desk.run("build", log, "-o", f"{log.stem}.db", "-q") for log in logs]
    reported = ", ".join(
        f"{log.stem} exit {d.returncode}" for log, d in zip(logs, done, strict=True)
    )
    fine = all(d.returncode in {2, 3} and d.stderr.strip() for d in done)
    return Came("build of a 3D lidar, of stereo", reported, fine)


def rounds_in_one_line(desk: Desk) -> Came:
    """19: a stage is one line, whatever its rounds; every decision is in the log of --debug."""
    done = desk.run("build", APARTMENT, "-o", "again.db", "--no-export", "--debug", "debug.log")
    names = [line.partition(":")[0] for line in done.stderr.splitlines() if " s" in line]
    decisions = len((desk.folder / "debug.log").read_text("utf-8").splitlines())
    reported = f"{len(names)} lines, {len(names) - len(set(names))} twice; {decisions} decisions"
    ok = "track" in names and len(names) == len(set(names)) and decisions > 500
    return Came("build --debug debug.log", reported, ok)


def measured_requirement(desk: Desk) -> Came:
    """19: a requirement that fails says what was measured."""
    done = desk.run("check", desk.apartment(), "--require", "largest_sigma < 0.001")
    line = done.stdout.strip().splitlines()[-1]
    return Came("check --require", line, done.returncode == 4 and "of the least certain" in line)


def _last(done: subprocess.CompletedProcess[str]) -> str:
    lines = (done.stdout + done.stderr).strip().splitlines()
    return lines[-1] if lines else "no word"


def _absent(path: Path) -> Came:
    return Came("nothing", f"{path} is absent", None)


ITEMS: dict[str, Callable[[Desk], Came]] = {
    "1": several_drives,
    "1 batch": batch_of_a_folder,
    "2": merged_camera,
    "3": appended,
    "4": relations_of_a_part,
    "5": smaller_voxels,
    "6": contradicted_edit,
    "7": carmen_at_a_terminal,
    "8": failed_build,
    "9": figures_agree,
    "10": late_odometry,
    "11 markdown": markdown,
    "11 shares": shares,
    "12": typos,
    "12 inspect": inspect_file,
    "13": python_paths,
    "14": symmetric_information,
    "15 blind": blind_laser,
    "15 clock": clock_set_back,
    "16": optimised_here,
    "17": sensors_left_out,
    "18": rates,
    "19 terminal": rounds_in_one_line,
    "19 check": measured_requirement,
}


def main() -> None:
    """Runs the items that are named, or all."""
    wanted = [n for n in ITEMS if not sys.argv[1:] or n.split()[0] in sys.argv[1:]]
    failed = 0
    with tempfile.TemporaryDirectory(prefix="first-hour-") as folder:
        for name in sorted(wanted, key=lambda n: (int(n.split()[0]), n)):
            try:
                came = ITEMS[name](Desk(Path(folder)))
            except (
                Exception
            ) as error:  # one that cannot be reported is one that is not as it should be
                came = Came("?", f"{type(error).__name__}: {error}", False)
            verdict = {True: "ok", False: "NOT OK", None: "not tried"}[came.ok]
            failed += came.ok is False
            print(f"{name:12} {verdict:9} {came.run}: {came.reported[:_SHOWN]}", flush=True)
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
