"""A robot with an RGB-D camera and wheels that drives round a room with pictures; all is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from messages_in_memory import MemoryLog, odometry_at
from visual_rooms import FOCAL, HEIGHT, WIDTH, Room, planar_pose

from mapmyworld.geometry.planar import compose_planar, matrix_to_planar
from mapmyworld.geometry.rigid import between
from mapmyworld.types import (
    CameraInfoMessage,
    Message,
    TransformsMessage,
    TransformStamped,
)

START_NS = 1_700_000_000_000_000_000
STEP_NS = 250_000_000
_OPTICAL = "camera_optical"


def circuit(first: float, last: float, step: float = 8.0, radius: float = 1.1) -> np.ndarray:
    """Poses (N, 4, 4) along a circle in the middle of the default room, degrees from east."""
    angles = np.radians(np.arange(first, last, step))
    return np.stack(
        [
            planar_pose(3.0 + radius * np.cos(a), 2.5 + radius * np.sin(a), a + np.pi / 2)
            for a in angles
        ]
    )


def camera_log(room: Room, truth: np.ndarray, later_s: int = 0) -> MemoryLog:
    """The drive as a log; the wheels turn 2 % too much."""
    entries: list[tuple[str, Message, int]] = []
    start = START_NS + later_s * 1_000_000_000
    mount = room.camera().base_from_camera
    static = TransformStamped(0, "base_link", _OPTICAL, mount)
    entries.append(("/tf_static", TransformsMessage((static,), True), start))
    wheels = np.zeros(3)
    for i, pose in enumerate(truth):
        time = start + i * STEP_NS
        if i:
            step = matrix_to_planar(between(truth[i - 1], pose))
            wheels = compose_planar(wheels, step * [1.0, 1.0, 1.02])
        image = room.image(pose, time)
        assert image.colour is not None
        assert image.depth is not None
        for topic, message in (("/rgb/image", image.colour), ("/depth/image", image.depth)):
            entries.append((topic, replace(message, stamp_ns=time, frame_id=_OPTICAL), time))
        entries.append(("/rgb/camera_info", _camera_info(time), time))
        entries.append(("/odom", odometry_at(time, wheels.tolist()), time))
    return MemoryLog(entries)


def _camera_info(stamp_ns: int) -> CameraInfoMessage:
    k = np.array([[FOCAL, 0, WIDTH / 2 - 0.5], [0, FOCAL, HEIGHT / 2 - 0.5], [0, 0, 1.0]])
    projection = np.hstack([k, np.zeros((3, 1))])
    return CameraInfoMessage(
        stamp_ns, _OPTICAL, WIDTH, HEIGHT, "plumb_bob", np.zeros(5), k, np.eye(3), projection
    )
