"""What a log becomes: frames, the nodes chosen from them, and the data they keep."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from mapmyworld.types.messages import CameraInfoMessage, GpsMessage, ImageMessage
from mapmyworld.types.rows import Rows

_HOUSING = 0.1  # m from its base at which a lens still sits in a camera's own housing


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One planar laser sweep, motion-corrected, in the base frame at its stamp."""

    points: NDArray[np.float32]
    """(N, 2) returns, metres, base frame, in the order of the sweep."""
    origin: NDArray[np.float64]
    """(3,) base_from_lidar as x, y, yaw."""
    missing: NDArray[np.float32]
    """(M,) bearings in radians, about `origin` and relative to the base's x axis, of beams
    that came back with nothing."""
    range_max: float
    """Metres beyond which the lidar reports nothing."""
    angle_increment: float
    """Radians between neighbouring beams."""
    passed: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    """(K, 2) base frame: ends of beams that were seen to meet nothing up to there."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraModel:
    """A pinhole camera with distortion, mounted on the base."""

    width: int
    height: int
    intrinsics: NDArray[np.float64]
    """(3, 3)."""
    distortion_model: str
    """"plumb_bob", "rational_polynomial", "equidistant" or "" for a rectified image."""
    distortion: NDArray[np.float64]
    """(D,) in OpenCV's order."""
    base_from_camera: NDArray[np.float64]
    """(4, 4), camera in its optical frame: z forward, x right, y down."""
    longest_side: ClassVar = 1 << 15
    """Pixels, which OpenCV and a map hold."""

    @property
    def is_carried(self) -> bool:
        """Whether the camera is its own base, which nobody has set level: no robot is so small."""
        return float(np.linalg.norm(self.base_from_camera[:3, 3])) < _HOUSING

    def info(self, stamp_ns: int, frame_id: str) -> CameraInfoMessage:
        """Intrinsics and distortion as a message; images are as the lens made them."""
        projection = np.column_stack([self.intrinsics, np.zeros(3)])
        size = self.width, self.height
        distortion, k = (self.distortion_model, self.distortion), self.intrinsics
        return CameraInfoMessage(stamp_ns, frame_id, *size, *distortion, k, np.eye(3), projection)


@dataclass(frozen=True, slots=True, eq=False)
class RgbdImage:
    """Colour and depth of one camera at one moment; both lazily decoded."""

    camera: CameraModel
    colour: ImageMessage | None
    depth: ImageMessage | None
    """Registered to the colour image; may be smaller by an integer factor."""


@dataclass(frozen=True, slots=True, eq=False)
class ImuSample:
    """What the inertial unit says at one moment."""

    stamp_ns: int
    angular_velocity: NDArray[np.float64]
    """(3,) rad/s, base frame."""
    linear_acceleration: NDArray[np.float64]
    """(3,) m/s^2, base frame."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One moment: everything the sensors indicate about it, matched by header stamps."""

    stamp_ns: int
    odom_from_base: NDArray[np.float64] | None
    """(4, 4) recorded odometry at `stamp_ns`; None where the log has none."""
    scan: Scan | None = None
    images: tuple[RgbdImage, ...] = ()
    cloud: NDArray[np.float32] | None = None
    """(N, 3) 3D scan in the base frame."""
    imu: tuple[ImuSample, ...] = ()
    """Samples since the last frame."""
    ground_truth: NDArray[np.float64] | None = None
    """(4, 4) recorded true pose of the base, where the log has one."""
    gps: GpsMessage | None = None
    """The newest fix, not older than a second."""
    is_interpolated: bool = False
    """Whether the odometry stood still there and `odom_from_base` lies between what it measured."""


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """A vertex of the graph. Its data never change when its pose does."""

    id: int
    """From 1 upwards in time."""
    session: int
    """0, 1, ...: nodes of different sessions have unrelated odometry frames."""
    stamp_ns: int
    odom_from_base: NDArray[np.float64]
    """(4, 4): recorded odometry, or the tracker's own where the log has none."""
    tracked_from_base: NDArray[np.float64]
    """(4, 4): pose after laser or visual tracking, before loop closures; the graph's start."""
    weight: int = 0
    ground_truth: NDArray[np.float64] | None = None
    """(4, 4) true pose, where the log has one."""
    gps: GpsMessage | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Features(Rows):
    """Local features of one image, for words and matching."""

    pixels: NDArray[np.float32]
    """(N, 2) u, v in the full-size image."""
    points: NDArray[np.float32]
    """(N, 3) in the base frame, metres; NaN without depth."""
    descriptors: NDArray[np.uint8] | NDArray[np.float32]
    """(N, D)."""
    sizes: NDArray[np.float32]
    """(N,) pixels, diameter."""
    angles: NDArray[np.float32]
    """(N,) degrees, -1 if unoriented."""
    responses: NDArray[np.float32]
    """(N,) how distinct each is."""
    octaves: NDArray[np.int32]
    """(N,) of the image pyramid."""
    words: NDArray[np.int32] | None = None
    """(N,) vocabulary ids from 1; 0 = none."""


@dataclass(frozen=True, slots=True, eq=False)
class NodeData:
    """The raw material of a node, as much of it as there is."""

    scan: Scan | None = None
    images: tuple[RgbdImage, ...] = ()
    cloud: NDArray[np.float32] | None = None
    """(N, 3) points of a 3D laser, base frame, metres."""
    features: Features | None = None


@dataclass(frozen=True, slots=True, eq=False)
class TrackedFrames(Rows):
    """Every tracked moment of the log, nodes or not, as parallel arrays in time order."""

    stamps_ns: NDArray[np.int64]
    """(F,)."""
    node_ids: NDArray[np.int64]
    """(F,) the node each frame hangs on: the last one at or before it."""
    node_from_frame: NDArray[np.float64]
    """(F, 4, 4) motion since that node, by the tracker."""
    is_node: NDArray[np.bool_]
    """(F,) whether the frame is that node itself."""
    odom_from_base: NDArray[np.float64] | None = None
    """(F, 4, 4) recorded odometry; None where the log has none at some frame."""


def nodes_as_frames(nodes: Sequence[Node]) -> TrackedFrames:
    """One frame a node, in their order, where only nodes were kept."""
    return TrackedFrames(
        np.array([node.stamp_ns for node in nodes], np.int64),
        np.array([node.id for node in nodes], np.int64),
        np.tile(np.eye(4), (len(nodes), 1, 1)),
        np.ones(len(nodes), np.bool_),
    )


_LOOKED_AT = 20  # nodes of a session: a camera may be slower than the laser, or start late


def first_nodes(nodes: Sequence[Node]) -> list[Node]:
    """The first nodes of every session: sessions that were merged may carry different sensors."""
    seen: Counter[int] = Counter()
    found = []
    for node in nodes:
        seen[node.session] += 1
        if seen[node.session] <= _LOOKED_AT:
            found.append(node)
    return found
