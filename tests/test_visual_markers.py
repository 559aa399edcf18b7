"""Markers drawn into images at known poses."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from memory_store import MemoryStore
from numpy.typing import NDArray

from mapmyworld.config import Config, VisualConfig
from mapmyworld.errors import ConfigError
from mapmyworld.geometry.rigid import between, make_transform, se3_exp, se3_log
from mapmyworld.places.markers import find_markers
from mapmyworld.types import CameraModel, ImageMessage, Node, NodeData, RgbdImage

Array = NDArray[np.float64]
K = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
# The marker faces the camera: its x right, its y up (the camera's y is down), z towards it.
FACING = np.diag([1.0, -1.0, -1.0])


class Silent:
    """Progress that nobody watches."""

    def stage(self, name: str, total: float | None = None, unit: str = "") -> None: ...

    def update(self, done: float) -> None: ...

    def note(self, message: str) -> None: ...


def picture_of(camera_from_marker: Array, length: float) -> RgbdImage:
    """Marker 7 of 4x4_50 before a white wall that continues its plane."""
    side = 240
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    face = cv2.aruco.generateImageMarker(dictionary, 7, side)
    corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * length / 2
    world = np.column_stack([corners, np.zeros(4), np.ones(4)]) @ camera_from_marker.T
    target = (world[:, :3] / world[:, 2:3]) @ K.T
    source = np.array(
        [[-0.5, -0.5], [side - 0.5, -0.5], [side - 0.5, side - 0.5], [-0.5, side - 0.5]]
    )
    warp = cv2.getPerspectiveTransform(source.astype(np.float32), target[:, :2].astype(np.float32))
    grey = cv2.warpPerspective(face, warp, (640, 480), flags=cv2.INTER_AREA, borderValue=230)
    normal, point = camera_from_marker[:3, 2], camera_from_marker[:3, 3]
    u, v = np.meshgrid(np.arange(640), np.arange(480))
    rays = np.stack([(u - 320) / 500, (v - 240) / 500, np.ones(u.shape)], axis=-1)
    depth = (normal @ point / (rays @ normal)).astype(np.float32)
    rgb = np.repeat(grey[..., None], 3, axis=2)
    camera = CameraModel(640, 480, K, "", np.zeros(0), np.eye(4))
    colour = ImageMessage(0, "camera", "rgb8", 640, 480, lambda: rgb)
    return RgbdImage(camera, colour, ImageMessage(0, "camera", "32FC1", 640, 480, lambda: depth))


@pytest.mark.parametrize("length", [0.0, 0.16])
def test_a_marker_becomes_a_landmark_where_it_hangs(length: float) -> None:
    """Seen at 30 degrees from 0.9 m; its size given, or measured by depth."""
    tilt = se3_exp(np.array([0.1, 0.5, 0.2, 0.0, 0.0, 0.0]))
    truth = make_transform(FACING, np.array([0.1, -0.05, 0.9])) @ tilt
    store = MemoryStore()
    node = Node(1, 0, 0, np.eye(4), np.eye(4))
    store.add_node(node, NodeData(images=(picture_of(truth, 0.16),)))
    visual = replace(VisualConfig(), markers="4x4_50", marker_length=length)
    (constraint,) = find_markers(store, replace(Config(), visual=visual), Silent())
    assert (constraint.from_id, constraint.to_id) == (1, -8)
    assert constraint.accepted
    error = se3_log(between(truth, constraint.i_from_j))
    assert np.abs(error[:3]).max() < 0.03
    assert np.abs(error[3:]).max() < 0.015
    assert error @ constraint.information @ error < 40  # within what it claims to know


def test_a_wrong_dictionary_is_named() -> None:
    visual = replace(VisualConfig(), markers="9x9_1")
    with pytest.raises(ConfigError, match="4x4_50"):
        find_markers(MemoryStore(), replace(Config(), visual=visual), Silent())
