"""What the map database costs: size and CPU time per node, scans, and questions to a large file.

python benchmarks/database.py [--data FOLDER] [--nodes 10000] [--megabytes 5000]

Writes the nodes of RTAB-Map's own two databases again with our writer, and compares size.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from common import DATA

from formats.database import RtabmapStore, open_store
from mapmyworld.types import (
    CameraModel,
    ConstraintKind,
    ImageMessage,
    Judged,
    Node,
    NodeData,
    Poses,
    RgbdImage,
    Scan,
)


def cpu_of(work: Callable[[], Any]) -> float:
    started = time.process_time()
    work()
    return time.process_time() - started


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--nodes", type=int, default=10_000)
    parser.add_argument("--megabytes", type=int, default=5000)
    parser.add_argument("--scans", type=int, default=60_000)
    parser.add_argument("--log", type=Path, help="only build this log: the database's share")
    options = parser.parse_args()
    if options.log is not None:
        share(options.log)
        return
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        print(
            f"{'same nodes as RTAB-Map':<28}{'theirs':>10}{'ours':>10}{'ratio':>7}{'CPU/node':>10}"
        )
        for name in ("freiburg1_rpy", "fr079_laser"):
            compare(options.data / "rtabmap" / f"{name}.db", place / f"{name}.db")
        scans(place / "scans.db", options.scans)
        questions(place / "large.db", options.nodes, options.megabytes)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory {peak:.0f} MB")


def share(log: Path) -> None:
    """CPU time of a build that is spent in the database, compression and codecs with it."""
    from cli.storing import storage_arguments
    from formats.database import DatabaseStore
    from formats.logs import open_log
    from mapmyworld.api import Silent
    from mapmyworld.config import Config
    from mapmyworld.pipeline import build_map

    spent: dict[str, float] = {}
    for name in ("add_node", "add_scan", "add_constraints", "judge", "close",
                 "set_poses", "set_grid", "set_tracked_frames", "set_frame_poses", "set_features",
                 "set_words"):  # fmt: skip
        timed(DatabaseStore, name, spent)
    started = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.db"
        config = Config()
        with open_store(path, create=True, **storage_arguments(config)) as store:
            build_map(open_log([log]), store, config, Silent())
        size = path.stat().st_size / 1e6
    total, stored = time.process_time() - started, sum(spent.values())
    print(
        f"{log.name}: {total:.1f} CPU s, the database {stored:.2f} of them ({stored / total:.1%});"
        f" {size:.1f} MB"
    )
    for name, seconds in sorted(spent.items(), key=lambda item: -item[1])[:5]:
        print(f"  {name:<22}{seconds:>7.2f} s")


def timed(owner: Any, name: str, spent: dict[str, float]) -> None:
    """Adds up the calling thread's CPU time in a method."""
    method = getattr(owner, name)

    def wrapper(*arguments: Any, **named: Any) -> Any:
        started = time.thread_time()
        try:
            return method(*arguments, **named)
        finally:
            spent[name] = spent.get(name, 0.0) + time.thread_time() - started

    setattr(owner, name, wrapper)


def compare(theirs: Path, ours: Path) -> None:
    """Everything of a node that RTAB-Map stored, stored by us."""
    with open_store(theirs, read_only=True) as source:
        assert isinstance(source, RtabmapStore)
        nodes, words, constraints = source.nodes(), source.words(), source.constraints()
        data = [loaded(source.node_data(node.id)) for node in nodes]
    warm_up(ours.with_suffix(".warm"), nodes[0], data[0])

    def write() -> None:
        with open_store(ours, create=True) as store, store.write_stage("track", "t"):
            for frame, (node, kept) in enumerate(zip(nodes, data, strict=True)):
                if kept.scan is not None:
                    store.add_scan(frame, kept.scan)
                store.add_node(node, kept)
            store.set_words(words)
            store.add_constraints(constraints)

    spent = cpu_of(write)
    a, b = theirs.stat().st_size / 1e6, ours.stat().st_size / 1e6
    print(
        f"{theirs.stem:<28}{a:>7.2f} MB{b:>7.2f} MB{b / a:>7.2f}{spent / len(nodes) * 1e3:>7.2f} ms"
    )


def loaded(data: NodeData) -> NodeData:
    """Depth decoded beforehand: that is the tracker's work, which needs it anyhow."""
    images = []
    for image in data.images:
        depth = image.depth
        if depth is not None:
            pixels = depth.pixels()
            depth = ImageMessage(
                depth.stamp_ns, "", "32FC1", depth.width, depth.height, lambda p=pixels: p
            )
        images.append(RgbdImage(image.camera, image.colour, depth))
    return NodeData(data.scan, tuple(images), data.cloud, data.features)


def warm_up(path: Path, node: Node, data: NodeData) -> None:
    with open_store(path, create=True) as store:
        store.add_node(node, data)


def scans(path: Path, count: int) -> None:
    """All sweeps of a long laser log: 360 beams each."""
    bearings = np.radians(np.arange(360.0))
    ranges = np.random.default_rng(0).uniform(1, 10, 360)
    points = np.column_stack([ranges * np.cos(bearings), ranges * np.sin(bearings)])
    sweep = Scan(
        points.astype(np.float32), np.zeros(3), np.zeros(0, np.float32), 12.0, np.radians(1.0)
    )

    def write() -> None:
        with open_store(path, create=True) as store, store.write_stage("track", "t"):
            for frame in range(count):
                store.add_scan(frame, sweep)

    spent = cpu_of(write)
    with open_store(path, read_only=True) as store:
        everything = cpu_of(lambda: sum(1 for _ in store.scans(range(count))))
        sparse = cpu_of(lambda: sum(1 for _ in store.scans(range(0, count, 10))))
    print(
        f"{count} scans of 360 beams: {path.stat().st_size / 1e6:.0f} MB; written {spent:.2f} s,"
        f" read {everything:.2f} s, every tenth {sparse:.2f} s (CPU)"
    )


def questions(path: Path, count: int, megabytes: int) -> None:
    """A large map: what a question costs that concerns no image."""
    share = np.random.default_rng(0).integers(0, 255, megabytes * 1_000_000 // count, np.uint8)
    camera = CameraModel(640, 480, np.eye(3), "", np.zeros(0), np.eye(4))
    frame = b"\xff\xc0\0\x0b\x08\x01\xe0\x02\x80\x01\x01\x11\0"  # 640 x 480, grey
    jpeg = b"\xff\xd8" + frame + share.tobytes()
    colour = ImageMessage(0, "", "rgb8", 640, 480, lambda: np.zeros((480, 640, 3), np.uint8), jpeg)
    data = NodeData(images=(RgbdImage(camera, colour, None),))
    with open_store(path, create=True) as store:
        with store.write_stage("track", "t"):
            for i in range(1, count + 1):
                pose = np.eye(4)
                pose[0, 3] = i * 0.1
                store.add_node(Node(i, 0, i * 10**8, pose, pose), data)
            steps = [
                Judged(i, i + 1, ConstraintKind.NEIGHBOUR, np.eye(4), np.eye(6))
                for i in range(1, count)
            ]
            store.add_constraints(steps)
        with store.write_stage("optimise", "o"):
            store.set_poses(Poses(np.arange(1, count + 1), np.tile(np.eye(4), (count, 1, 1))))
    started = time.monotonic()
    with open_store(path, read_only=True) as store:
        store.nodes(), store.constraints(), store.poses(), store.grid()
        graph = time.monotonic() - started
        started = time.monotonic()
        store.node_data(count // 2)
        one = time.monotonic() - started
    size = path.stat().st_size / 1e6
    print(
        f"{count} nodes, {size:.0f} MB: graph read in {graph:.2f} s, one node in {one * 1e3:.1f} ms"
    )


if __name__ == "__main__":
    sys.exit(main())
