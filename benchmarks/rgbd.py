"""Builds maps of RGB-D logs with the default settings and prints accuracy, time and memory.

    python benchmarks/rgbd.py                        the recorded sequences in ../shared/data
    python benchmarks/rgbd.py FOLDER_OR_LOG ...      any TUM RGB-D folders, or other logs

A log's ground truth is groundtruth.txt in its folder, or LOG.truth.tum beside it.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from formats.database import open_store
from formats.trajectory import read_trajectory
from mapmyworld.evaluation.trajectory import ate
from mapmyworld.types import ConstraintKind, Trajectory

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("MAPMYWORLD_DATA", ROOT.parent / "shared" / "data"))


@dataclass(frozen=True)
class Row:
    log: str
    frames: int
    posed: float
    ate_m: float
    nodes: int
    closures: int
    log_s: float
    wall_s: float
    cpu_s: float
    memory_mb: float

    def text(self) -> str:
        return (
            f"{self.log:<28} {self.frames:>6} {self.posed:>7.1%} {self.ate_m:>8.4f} "
            f"{self.nodes:>6} {self.closures:>8} {self.log_s:>7.1f} "
            f"{self.wall_s:>7.1f} {self.cpu_s:>7.1f} "
            f"{self.memory_mb:>7.0f}"
        )


HEAD = (
    f"{'log':<28} {'frames':>6} {'posed':>7} {'ATE m':>8} {'nodes':>6} {'closures':>8} "
    f"{'log s':>7} {'wall s':>7} {'CPU s':>7} {'MB':>7}"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("logs", nargs="*", type=Path)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    arguments = parser.parse_args()
    logs = arguments.logs or sorted((DATA / "rgbd").glob("*/"))
    print(HEAD)
    for log in logs:
        with tempfile.TemporaryDirectory() as folder:
            print(measure(log, Path(folder) / "map.db", arguments.set).text(), flush=True)


def measure(log: Path, output: Path, settings: list[str]) -> Row:
    """Builds in a process of its own, so that its memory and CPU time are its own."""
    command = [sys.executable, "-m", "cli.main", "build", str(log), "-o", str(output), "-q"]
    for setting in settings:
        command += ["--set", setting]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.monotonic()
    result = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    wall = time.monotonic() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if result.returncode not in (0, 3):
        sys.exit(result.stderr)
    cpu = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return score(log, output, wall, cpu, after.ru_maxrss / 1024)


def score(log: Path, output: Path, wall: float, cpu: float, memory: float) -> Row:
    store = open_store(output, read_only=True)
    try:
        frames, poses = store.tracked_frames(), store.frame_poses()
        constraints, nodes = store.constraints(), store.nodes()
    finally:
        store.close()
    assert poses is not None
    truth = read_trajectory(truth_of(log))
    stamps = frames.stamps_ns
    error = ate(Trajectory(stamps, poses), truth).rmse
    closures = [
        c
        for c in constraints
        if c.accepted and c.kind in (ConstraintKind.LOOP_CLOSURE, ConstraintKind.PROXIMITY)
    ]
    total = image_count(log) or len(stamps)
    length = (stamps[-1] - stamps[0]) * 1e-9
    return Row(
        log.name, len(stamps), len(stamps) / total, error, len(nodes), len(closures),
        length, wall, cpu, memory,
    )  # fmt: skip


def truth_of(log: Path) -> Path:
    inside = log / "groundtruth.txt"
    return inside if inside.is_file() else log.with_name(log.name + ".truth.tum")


def image_count(log: Path) -> int:
    """Colour images that a TUM folder lists; 0 for other logs."""
    listing = log / "rgb.txt"
    if not listing.is_file():
        return 0
    return sum(1 for line in listing.read_text().splitlines() if line.strip() and line[0] != "#")


if __name__ == "__main__":
    main()
