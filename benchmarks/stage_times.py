"""Where a build's time goes, and what each stage cannot do without.

    python benchmarks/stage_times.py LOG [--method graph|fastslam] [--set NAME=VALUE ...]

Builds the log (twice: kernels are compiled by the first), then repeats the bare work on the same
data with libraries alone: reading and decompressing the file, decoding the nodes' pictures,
detecting their features, storing the map's bytes, solving the accepted constraints by gtsam's
Levenberg-Marquardt from one start, casting the rays with all scans in memory. CPU seconds.
"""

from __future__ import annotations

import argparse
import bz2
import json
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import gtsam
import numpy as np
from reading import decompress_all

from formats.database import open_store
from formats.logs import open_log
from formats.logs.recorded_log import RecordedLog
from mapmyworld.config import Config
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.mapping.occupancy import build_grid
from mapmyworld.types import ConstraintKind, ImageMessage, MapStore

STAGES_OF = {
    "reading and decompressing": ("survey", "track"),
    "decoding the nodes' pictures": ("features",),
    "decoding and detecting": ("features",),
    "storing the map's bytes": ("track",),
    "gtsam, one start, no verdicts": ("optimise", "refine"),
    "rays, scans in memory": ("grid",),
}


@dataclass(frozen=True, slots=True)
class Bare:
    """What some stages do at least, and its CPU seconds."""

    work: str
    seconds: float


def cpu_of(work: Callable[[], Any]) -> float:
    started = time.process_time()
    work()
    return time.process_time() - started


def build(log: Path, path: Path, options: list[str]) -> dict[str, Any]:
    """The costs of a build's stages, as the build itself indicates them."""
    command = [sys.executable, "-m", "cli.main", "build", str(log), "-o", str(path), "-q"]
    for _ in range(2):
        subprocess.run([*command, "--overwrite", *options], check=True, capture_output=True)
    found: dict[str, Any] = json.loads(path.with_suffix(".timing.json").read_text("utf-8"))
    return found


def bare_work(log: Path, path: Path) -> Iterator[Bare]:
    """What cannot be avoided, measured on this log and its map."""
    yield Bare("reading and decompressing", cpu_of(lambda: read_file(log)))
    with open_store(path, read_only=True) as store:
        pictures = [p for node in store.nodes() for p in pictures_of(store, node.id)]
        if pictures:
            yield Bare("decoding the nodes' pictures", cpu_of(lambda: decode(pictures)))
            yield Bare("decoding and detecting", cpu_of(lambda: detect(pictures)))
        yield Bare("storing the map's bytes", cpu_of(lambda: store_bytes(path)))
        yield Bare("gtsam, one start, no verdicts", solve(store))
        frames = store.frame_poses()
        if frames is not None and (scans := list(store.scans(np.arange(len(frames))))):
            placed = [(matrix_to_planar(frames[frame]), scan) for frame, scan in scans]
            yield Bare("rays, scans in memory", cpu_of(lambda: build_grid(placed, Config())))


def read_file(log: Path) -> None:
    opened = open_log([log])
    if isinstance(opened, RecordedLog) and opened.index().blocks:
        decompress_all(opened)
    elif log.suffix == ".bz2":
        bz2.decompress(log.read_bytes())
    elif log.is_file():
        log.read_bytes()


def pictures_of(store: MapStore, node_id: int) -> list[ImageMessage]:
    images = store.node_data(node_id, features=False).images
    return [image.colour for image in images if image.colour is not None]


def decode(pictures: list[ImageMessage]) -> None:
    for picture in pictures:
        if picture.encoded is not None:
            cv2.imdecode(np.frombuffer(picture.encoded, np.uint8), cv2.IMREAD_GRAYSCALE)


def detect(pictures: list[ImageMessage]) -> None:
    settings = Config().visual
    orb = cv2.ORB_create(settings.feature_count, 1.2, 8)
    for picture in pictures:
        if picture.encoded is not None:
            data = np.frombuffer(picture.encoded, np.uint8)
            orb.detectAndCompute(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), None)


def store_bytes(path: Path) -> None:
    """The same bytes in as few rows of a database as they fill pages of a megabyte."""
    data = path.read_bytes()
    with sqlite3.connect(path.with_suffix(".bare")) as bare:
        bare.execute("CREATE TABLE Bytes (page BLOB)")
        pages = range(0, len(data), 1 << 20)
        bare.executemany(
            "INSERT INTO Bytes VALUES (?)", ((data[i : i + (1 << 20)],) for i in pages)
        )


def solve(store: MapStore) -> float:
    """CPU seconds of gtsam on the accepted constraints, from the chain of neighbours."""
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    accepted = [c for c in store.constraints() if c.accepted and c.from_id != c.to_id]
    noise = {}
    place = {store.nodes()[0].id: np.eye(4)}
    for c in accepted:
        if c.kind == ConstraintKind.NEIGHBOUR and c.from_id in place:
            place.setdefault(c.to_id, place[c.from_id] @ c.i_from_j)
    for c in accepted:
        if c.from_id in place and c.to_id in place:
            key = c.information.tobytes()
            noise[key] = noise.get(key) or gtsam.noiseModel.Gaussian.Information(c.information)
            step = gtsam.Pose3(c.i_from_j)
            graph.add(gtsam.BetweenFactorPose3(c.from_id, c.to_id, step, noise[key]))
    first = next(iter(place))
    graph.add(gtsam.PriorFactorPose3(first, gtsam.Pose3(), gtsam.noiseModel.Unit.Create(6)))
    for node, pose in place.items():
        start.insert(node, gtsam.Pose3(pose))
    return cpu_of(gtsam.LevenbergMarquardtOptimizer(graph, start).optimize)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("log", type=Path)
    parser.add_argument("--method", default="graph")
    parser.add_argument("--set", action="append", default=[], dest="settings")
    options = parser.parse_args()
    chosen = ["--method", options.method, *(f"--set={setting}" for setting in options.settings)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.db"
        reported = build(options.log, path, chosen)
        print(f"{options.log.name}, {options.method}: {reported['cpu_s']:.1f} CPU s, ", end="")
        print(
            f"{reported['duration_s'] / reported['cpu_s']:.0f}x by CPU, "
            f"{reported['peak_memory_mb']:.0f} MB\n"
        )
        print("| stage | CPU s | share |\n|---|---|---|")
        for stage in reported["stages"]:
            print(
                f"| {stage['name']} | {stage['cpu_s']:.2f} "
                f"| {stage['cpu_s'] / reported['cpu_s']:.0%} |"
            )
        print("\n| bare work | CPU s | stages that do it | their CPU s |\n|---|---|---|---|")
        for bare in bare_work(options.log, path):
            names = STAGES_OF[bare.work]
            of = sum(s["cpu_s"] for s in reported["stages"] if s["name"] in names)
            print(f"| {bare.work} | {bare.seconds:.2f} | {', '.join(names)} | {of:.2f} |")


if __name__ == "__main__":
    main()
