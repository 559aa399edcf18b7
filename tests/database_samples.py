"""Nodes, scans, images and constraints with values that tests can distinguish."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sample_verdicts import REJECTED

from mapmyworld.geometry.rigid import se3_exp
from mapmyworld.types import (
    CameraModel,
    ConstraintKind,
    Features,
    ImageMatch,
    ImageMessage,
    Judge,
    Judged,
    MapStore,
    Node,
    NodeData,
    OccupancyGrid,
    Poses,
    RgbdImage,
    Scan,
    TrackedFrames,
    Verdict,
    Why,
)

START_NS = 1_305_031_229_528_748_123
OPTICAL = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0.05], [0, -1, 0, 0.6], [0, 0, 0, 1]])


def pose(seed: int, size: float = 1.0) -> NDArray[np.float64]:
    return se3_exp(np.random.default_rng(seed).normal(size=6) * size)


def scan(seed: int = 0, beams: int = 181) -> Scan:
    """A sweep of a laser that sits before the base, with some beams that saw nothing."""
    rng = np.random.default_rng(seed)
    bearings = np.linspace(-np.pi / 2, np.pi / 2, beams)
    ranges = rng.uniform(0.5, 7.0, beams)
    gone = rng.random(beams) < 0.1
    x, y, yaw = origin = np.array([0.3, -0.1, 0.02])
    angles = bearings + yaw
    points = np.column_stack([x + ranges * np.cos(angles), y + ranges * np.sin(angles)])
    return Scan(
        points[~gone].astype(np.float32),
        origin,
        angles[gone].astype(np.float32),
        8.0,
        float(np.pi / (beams - 1)),
    )


def picture(
    pixels: NDArray[Any], encoding: str, stamp_ns: int = START_NS, encoded: bytes | None = None
) -> ImageMessage:
    height, width = pixels.shape[:2]
    show: Callable[[], NDArray[Any]] = lambda: pixels  # noqa: E731
    return ImageMessage(stamp_ns, "camera", encoding, width, height, show, encoded)


def camera(width: int = 64, height: int = 48, **changes: Any) -> CameraModel:
    values: dict[str, Any] = {
        "width": width,
        "height": height,
        "intrinsics": np.array([[60.0, 0, 31.5], [0, 61.0, 23.5], [0, 0, 1]]),
        "distortion_model": "",
        "distortion": np.zeros(0),
        "base_from_camera": OPTICAL,
    }
    return CameraModel(**(values | changes))


def image(seed: int = 0, stamp_ns: int = START_NS) -> RgbdImage:
    """Smooth colours, and depth in whole millimetres with holes."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:48, :64]
    colour = np.dstack([3 * u, 4 * v, (u + v + 17 * seed) % 200]).astype(np.uint8)
    depth = np.rint(1000 + 10 * u + 5 * v + rng.integers(0, 9, u.shape)) * 1e-3
    depth[rng.random(u.shape) < 0.2] = 0.0
    return RgbdImage(
        camera(),
        picture(colour, "rgb8", stamp_ns),
        picture(depth.astype(np.float32), "32FC1", stamp_ns),
    )


def features(seed: int = 0, count: int = 20, words: bool = True) -> Features:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3)).astype(np.float32)
    points[::5] = np.nan
    ids = np.arange(count, dtype=np.int32) + 1
    ids[::4] = 0
    return Features(
        pixels=rng.uniform(0, 48, (count, 2)).astype(np.float32),
        points=points,
        descriptors=rng.integers(0, 256, (count, 32), dtype=np.uint8),
        sizes=np.full(count, 31.0, np.float32),
        angles=rng.uniform(0, 360, count).astype(np.float32),
        responses=rng.uniform(0, 1, count).astype(np.float32),
        octaves=rng.integers(0, 8, count).astype(np.int32),
        words=ids if words else None,
    )


def node(number: int, session: int = 0, **changes: Any) -> Node:
    """Node `number`, a second after the one before."""
    values: dict[str, Any] = {
        "id": number,
        "session": session,
        "stamp_ns": START_NS + (number - 1) * 1_000_000_000,
        "odom_from_base": pose(number),
        "tracked_from_base": pose(1000 + number),
    }
    return Node(**(values | changes))


def constraint(from_id: int, to_id: int, kind: ConstraintKind, **changes: Any) -> Judged:
    root = np.random.default_rng(from_id * 31 + to_id).normal(size=(6, 6))
    values: dict[str, Any] = {
        "i_from_j": pose(from_id * 100 + to_id),
        "information": root @ root.T + 6 * np.eye(6),
        "source": ImageMatch(similarity=0.83, inliers=120),
        "verdicts": (Verdict(Judge.CAMERA, True, Why.IMAGES_AGREE, {"inliers": 120, "sigmas": 3}),),
    }
    return Judged(from_id, to_id, kind, **(values | changes))


def sample_constraints() -> list[Judged]:
    """One of every kind, and a rejected one."""
    kinds = ConstraintKind
    return [
        constraint(1, 2, kinds.NEIGHBOUR),
        constraint(2, 3, kinds.NEIGHBOUR),
        constraint(1, 3, kinds.LOOP_CLOSURE),
        constraint(1, 3, kinds.PROXIMITY),
        constraint(2, 3, kinds.USER),
        constraint(2, 2, kinds.PRIOR),
        constraint(3, -7, kinds.LANDMARK),
        constraint(1, 3, kinds.LOOP_CLOSURE, verdicts=(REJECTED,)),
    ]


def fill(store: MapStore) -> None:
    """A small map with something of everything, stage by stage as a build writes it."""
    with store.write_stage("plan", "p"):
        store.put("plan", {"scan": "/scan"})
    with store.write_stage("track", "t"):
        for number in (1, 2, 3):
            store.add_scan(2 * number - 2, scan(number))
            store.add_scan(2 * number - 1, scan(10 + number))
            truth = pose(500 + number) if number > 1 else None
            data = NodeData(scan=scan(number), images=(image(number, node(number).stamp_ns),))
            store.add_node(node(number, ground_truth=truth), data)
        store.add_constraints(sample_constraints()[:2])
        store.set_tracked_frames(tracked_frames())
    with store.write_stage("recognise", "r"):
        for number in (1, 2, 3):
            store.set_features(number, features(number))
        store.set_words({i + 1: features(1).descriptors[i] for i in range(20)})
        store.add_constraints(sample_constraints()[2:])
    with store.write_stage("optimise", "o"):
        store.set_poses(sample_poses())
    with store.write_stage("judge", "j"):
        store.judge(sample_constraints())
    with store.write_stage("map", "m"):
        store.set_frame_poses(np.stack([pose(70 + i) for i in range(6)]))
        store.set_grid(grid())
        store.put("summary", {"nodes": 3})


def tracked_frames() -> TrackedFrames:
    motions = np.stack([np.eye(4) if i % 2 == 0 else pose(40 + i, 0.05) for i in range(6)])
    return TrackedFrames(
        START_NS + np.arange(6) * 500_000_000,
        np.array([1, 1, 2, 2, 3, 3]),
        motions,
        np.array([True, False] * 3),
        np.stack([pose(900 + i) for i in range(6)]),
    )


def sample_poses() -> Poses:
    ids = np.array([1, 2, 3, -7])
    solved = np.stack([pose(200 + int(i)) for i in ids])
    return Poses(ids, solved, np.stack([np.eye(6) * i for i in range(1, 5)]))


def grid() -> OccupancyGrid:
    """Taller than wide, with free, occupied, uncertain and unknown cells."""
    rng = np.random.default_rng(5)
    log_odds = rng.choice([-3.0, 3.0, 0.1, np.nan], (30, 20)).astype(np.float32)
    return OccupancyGrid(log_odds, 0.05, np.array([-1.25, 3.5]))
