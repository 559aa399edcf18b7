"""What a node keeps, as the messages that its sensors would have sent."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.planar import invert_planar, planar_to_matrix, transform_points_planar
from mapmyworld.types import (
    LaserScanMessage,
    Message,
    MessageKind,
    Node,
    NodeData,
    OdometryMessage,
    PointCloudMessage,
    PoseMessage,
    RawMessage,
    RgbdImage,
    Scan,
    TransformsMessage,
    TransformStamped,
)

_BASE, _ODOM, _LASER = "base_link", "odom", "laser"
# Bearings that stray further from the lattice of beams than this share of a step were moved by
# motion correction: they get a lattice as many times finer, so as not to be moved back.
_ON_LATTICE = 1e-3
_FINER = 16
_MAX_BEAMS = 1 << 20


@dataclass(frozen=True, slots=True)
class Moment:
    """A tracked frame: its node, where it was, and whether it is that node itself."""

    index: int
    stamp_ns: int
    node: Node
    odom_from_base: NDArray[np.float64]
    """(4, 4)."""
    is_node: bool


def messages_at(
    moment: Moment, data: NodeData, mounts: dict[str, NDArray[np.float64]]
) -> Iterator[RawMessage]:
    """Everything of one moment.

    `mounts`, sensor frame -> base_from_sensor (4, 4), remembers which were reported already.
    """
    fresh = {name: at for name, at in _mounts(data).items() if name not in mounts}
    if fresh:
        mounts |= fresh
        yield _raw("/tf_static", MessageKind.TRANSFORMS, moment, lambda: _static(moment, fresh))
    yield _raw("/odom", MessageKind.ODOMETRY, moment, lambda: _odometry(moment))
    stamp_ns, truth, fix = moment.stamp_ns, moment.node.ground_truth, moment.node.gps
    if moment.is_node and truth is not None:
        pose = PoseMessage(stamp_ns, "world", truth, np.zeros((6, 6)))
        yield _raw("/ground_truth", MessageKind.POSE, moment, lambda: pose)
    if moment.is_node and fix is not None:
        yield _raw("/gps/fix", MessageKind.GPS, moment, lambda: fix)
    for number, image in enumerate(data.images):
        yield from _camera_messages(moment, number, image)
    scan, cloud = data.scan, data.cloud
    if scan is not None:
        yield _raw(
            "/scan",
            MessageKind.LASER_SCAN,
            moment,
            lambda: message_from_scan(scan, stamp_ns, _LASER),
        )
    if cloud is not None:
        yield _raw(
            "/points",
            MessageKind.POINT_CLOUD,
            moment,
            lambda: PointCloudMessage(stamp_ns, _BASE, cloud, None),
        )


def _raw(
    topic: str, kind: MessageKind, moment: Moment, decode: Callable[[], Message]
) -> RawMessage:
    return RawMessage(topic, kind, moment.stamp_ns, moment.stamp_ns, decode)


def _mounts(data: NodeData) -> dict[str, NDArray[np.float64]]:
    """Sensor frame -> base_from_sensor."""
    mounts = {
        _camera_frame(i): image.camera.base_from_camera for i, image in enumerate(data.images)
    }
    if data.scan is not None:
        mounts[_LASER] = planar_to_matrix(data.scan.origin)
    return mounts


def _static(moment: Moment, mounts: dict[str, NDArray[np.float64]]) -> TransformsMessage:
    return TransformsMessage(
        tuple(TransformStamped(moment.stamp_ns, _BASE, name, at) for name, at in mounts.items()),
        static=True,
    )


def _odometry(moment: Moment) -> OdometryMessage:
    unknown = np.zeros((6, 6))
    pose, twist = moment.odom_from_base, np.zeros(6)
    return OdometryMessage(moment.stamp_ns, _ODOM, _BASE, pose, unknown, twist, unknown)


def _camera_frame(number: int) -> str:
    return "camera_optical" if number == 0 else f"camera_{number}_optical"


def _camera_messages(moment: Moment, number: int, image: RgbdImage) -> Iterator[RawMessage]:
    """Info, colour and depth of one camera; the second and later have topics of their own."""
    space = "/camera" if number == 0 else f"/camera_{number}"
    frame, model = _camera_frame(number), image.camera
    stamp = image.colour or image.depth
    at = moment.stamp_ns if stamp is None else stamp.stamp_ns
    yield _raw(
        f"{space}/rgb/camera_info",
        MessageKind.CAMERA_INFO,
        moment,
        lambda: model.info(at, frame),
    )
    for kind, picture in (("rgb", image.colour), ("depth", image.depth)):
        if picture is not None:
            topic, decode = f"{space}/{kind}/image", partial(replace, picture, frame_id=frame)
            yield RawMessage(topic, MessageKind.IMAGE, moment.stamp_ns, picture.stamp_ns, decode)


def message_from_scan(scan: Scan, stamp_ns: int, frame_id: str) -> LaserScanMessage:
    """A sweep about `scan.origin`, taken at once: returns as ranges, missing beams as inf."""
    points = transform_points_planar(invert_planar(scan.origin), scan.points)
    points = points[np.isfinite(points).all(axis=1)]  # a damaged map may hold anything
    bearings = np.arctan2(points[:, 1], points[:, 0])
    missing = np.asarray(scan.missing, np.float64) - scan.origin[2]
    missing = missing[np.isfinite(missing)]
    missing = np.mod(missing + math.pi, 2 * math.pi) - math.pi
    both = np.concatenate([bearings, missing])
    first, step = _lattice(both, scan.angle_increment)
    slots = np.rint((both - first) / step).astype(np.int64)
    limit = scan.range_max if math.isfinite(scan.range_max) else 0.0
    lengths = np.hypot(points[:, 0], points[:, 1]).astype(np.float32)
    if limit > 0:  # a return at the limit itself would read as none
        lengths = np.minimum(lengths, np.nextafter(np.float32(limit), np.float32(0)))
    ranges = np.full(int(slots.max(initial=-1)) + 1, np.nan, np.float32)
    ranges[slots[len(points) :]] = np.inf
    # Of two returns in one beam the nearer hides the farther.
    order = np.argsort(-lengths, kind="stable")
    ranges[slots[: len(points)][order]] = lengths[order]
    return LaserScanMessage(
        stamp_ns, frame_id, first, step, 0.0, 0.0, 0.0, limit, ranges, np.empty(0, np.float32)
    )


def _lattice(bearings: NDArray[np.float64], increment: float) -> tuple[float, float]:
    """First bearing and step on which all bearings lie, or nearly."""
    if len(bearings) == 0:
        return 0.0, increment or 0.01
    first = float(bearings.min())
    span = float(bearings.max()) - first
    if increment <= 0:
        gaps = np.diff(np.sort(bearings))
        gaps = gaps[gaps > 1e-6]
        increment = float(np.median(gaps)) if len(gaps) else 0.01
    increment = max(increment, span / _MAX_BEAMS, 1e-6)
    places = (bearings - first) / increment
    off = float(np.abs(places - np.rint(places)).max())
    return first, increment if off < _ON_LATTICE else increment / _FINER
