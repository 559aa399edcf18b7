"""Builds maps of RGB-D logs with the default settings and prints accuracy, time and memory.

    python benchmarks/rgbd.py                        the recorded sequences in ../shared/data
    python benchmarks/rgbd.py FOLDER_OR_LOG ...      any TUM RGB-D folders, or other logs
    python benchmarks/rgbd.py --world hall --seeds 0 1 2 3 4 5 6 7 8 9 --sensors laser wheels
                                                     simulated here, one after the other
                                                     (--simulate camera.rate=5 --laps 2: shorter)

A log's ground truth is groundtruth.txt in its folder, or LOG.truth/trajectory.tum beside it. A
closure is right within 0.2 m and 1 degree; recall is of the moments at which the robot was back.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

from common import DATA, ROOT

from cli.scoring import score_loops, truth_beside
from formats.database import open_store
from formats.trajectory_files import read_trajectory
from mapmyworld.evaluation.trajectory_error import ate
from mapmyworld.types import CLOSURES, MapStore, Trajectory


@dataclass(frozen=True)
class Row:
    log: str
    frames: int
    posed: float
    ate_m: float
    nodes: int
    closures: int
    wrong: str
    """Closures beyond 0.2 m or 1 degree; empty where the truth of the robot is not known."""
    recall: str
    log_s: float
    wall_s: float
    cpu_s: float
    memory_mb: float

    def text(self) -> str:
        return (
            f"{self.log:<28} {self.frames:>6} {self.posed:>7.1%} {self.ate_m:>8.4f} "
            f"{self.nodes:>6} {self.closures:>8} {self.wrong:>6} {self.recall:>7} "
            f"{self.log_s:>7.1f} "
            f"{self.wall_s:>7.1f} {self.cpu_s:>7.1f} "
            f"{self.memory_mb:>7.0f}"
        )


SENSORS = {
    "laser": [],
    "wheels": ["sensing.use_scans=false"],
    "camera": ["sensing.use_scans=false", "sensing.odometry_topic=none"],
}

HEAD = (
    f"{'log':<28} {'frames':>6} {'posed':>7} {'ATE m':>8} {'nodes':>6} {'closures':>8} "
    f"{'wrong':>6} {'recall':>7} "
    f"{'log s':>7} {'wall s':>7} {'CPU s':>7} {'MB':>7}"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("logs", nargs="*", type=Path)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--world", help="Simulate this world instead.")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--sensors", nargs="+", choices=list(SENSORS), default=["laser"])
    parser.add_argument("--laps", type=int, help="Of the simulated drive.")
    parser.add_argument("--simulate", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--no-head", action="store_true", help="Rows alone, to be joined.")
    arguments = parser.parse_args()
    if not arguments.no_head:
        print(HEAD)
    if arguments.world:
        laps = [] if arguments.laps is None else ["--laps", str(arguments.laps)]
        drive = laps + [word for s in arguments.simulate for word in ("--set", s)]
        for seed in arguments.seeds:
            measure_world(arguments.world, seed, arguments.sensors, drive, arguments.set)
        return
    logs = arguments.logs or sorted((DATA / "rgbd").glob("*/"))
    for log in logs:
        with tempfile.TemporaryDirectory() as folder:
            print(measure(log, Path(folder) / "map.db", arguments.set).text(), flush=True)


def measure_world(
    world: str, seed: int, sensors: list[str], drive: list[str], settings: list[str]
) -> None:
    """Records a drive, builds it with each set of sensors, and forgets it."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / f"{world}_{seed}.mcap"
        command = [sys.executable, "-m", "cli.main", "simulate", world, "--seed", str(seed)]
        subprocess.run([*command, *drive, "-o", str(log), "-q"], cwd=ROOT, check=True)
        for name in sensors:
            row = measure(log, Path(folder) / "map.db", [*settings, *SENSORS[name]])
            print(replace(row, log=f"{row.log} {name}").text(), flush=True)


def measure(log: Path, output: Path, settings: list[str]) -> Row:
    """Builds in a process of its own, so that its memory and CPU time are its own."""
    command = [sys.executable, "-m", "cli.main", "build", str(log), "-o", str(output), "-q"]
    command.append("--overwrite")
    for setting in settings:
        command += ["--set", setting]
    start = time.monotonic()
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=errors)
        _, status, used = os.wait4(process.pid, 0)  # this process alone, not those before it
        wall = time.monotonic() - start
        if os.waitstatus_to_exitcode(status) not in (0, 3):
            errors.seek(0)
            sys.exit(errors.read().decode())
    return score(log, output, wall, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)


def score(log: Path, output: Path, wall: float, cpu: float, memory: float) -> Row:
    store = open_store(output, read_only=True)
    try:
        frames, poses = store.tracked_frames(), store.frame_poses()
        constraints, nodes = store.constraints(), store.nodes()
        wrong, recall = _closures_judged(store, log)
    finally:
        store.close()
    assert poses is not None
    truth = read_trajectory(truth_of(log))
    stamps = frames.stamps_ns
    error = ate(Trajectory(stamps, poses), truth).rmse
    closures = [c for c in constraints if c.accepted and c.kind in CLOSURES]
    total = image_count(log) or len(stamps)
    length = (stamps[-1] - stamps[0]) * 1e-9
    return Row(
        log.name, len(stamps), len(stamps) / total, error, len(nodes), len(closures),
        wrong, recall, length, wall, cpu, memory,
    )  # fmt: skip


def _closures_judged(store: MapStore, log: Path) -> tuple[str, str]:
    """How many closures are wrong, and the recall, where the robot's own truth is known."""
    path = truth_of(log)
    if path.name != "trajectory.tum":
        return "", ""
    judged = score_loops(store, read_trajectory(path), truth_beside(path))
    return str(int((~judged.right).sum())), f"{judged.recall:.1%}"


def truth_of(log: Path) -> Path:
    inside = log / "groundtruth.txt"
    return inside if inside.is_file() else log.with_name(log.name + ".truth") / "trajectory.tum"


def image_count(log: Path) -> int:
    """Colour images that a TUM folder lists; 0 for other logs."""
    listing = log / "rgb.txt"
    if not listing.is_file():
        return 0
    return sum(1 for line in listing.read_text().splitlines() if line.strip() and line[0] != "#")


if __name__ == "__main__":
    main()
