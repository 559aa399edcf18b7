"""Depth kept as the PNG file that was recorded: believed by its sums, stored byte for byte."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formats.database import open_store
from formats.logs.image_pixels import compressed_image
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.geometry.rigid import between, evenly_along
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.registration.image_levels import is_whole_png
from mapmyworld.sensing.sound_images import ImageGuard
from mapmyworld.types import CameraModel, Node, NodeData, RgbdImage

SHAPE = (24, 32)
K = np.array([[30.0, 0.0, 15.5], [0.0, 30.0, 11.5], [0.0, 0.0, 1.0]])
CAMERA = CameraModel(32, 24, K, "", np.zeros(0), np.eye(4))


def millimetres() -> np.ndarray:
    return np.random.default_rng(3).integers(400, 9000, SHAPE).astype(np.uint16)


def depth_file() -> bytes:
    return bytes(cv2.imencode(".png", millimetres())[1])


def message_of(data: bytes) -> RgbdImage:
    depth = compressed_image(7, "camera", "16UC1; compressedDepth png", bytes(12) + data)
    return RgbdImage(CAMERA, None, depth)


@pytest.mark.parametrize("codec", ["png", "float"])
def test_recorded_depth_comes_back_from_the_map_whatever_it_is_kept_as(
    tmp_path: Path, codec: str
) -> None:
    image = ImageGuard().sound(message_of(depth_file()))
    assert image is not None
    node = Node(1, 0, 7, np.eye(4), np.eye(4))
    with open_store(tmp_path / "m.db", create=True, depth_codec=codec) as store:
        store.add_node(node, NodeData(None, (image,)))
        (back,) = store.node_data(1).images
        assert back.depth is not None
        assert np.allclose(back.depth.pixels(), millimetres() * 1e-3, atol=1e-6)
        assert (back.depth.encoded == depth_file()) == (codec == "png")


@settings(max_examples=60)
@given(at=st.integers(0, len(depth_file()) - 1), flip=st.integers(1, 255))
def test_no_damaged_byte_of_a_file_is_believed(at: int, flip: int) -> None:
    data = bytearray(depth_file())
    data[at] ^= flip
    depth = message_of(bytes(data)).depth
    assert depth is not None
    assert not is_whole_png(depth, SHAPE)


@pytest.mark.parametrize("cut", [0, 8, 20, 60, -1])
def test_a_cut_or_otherwise_sized_file_is_not_believed(cut: int) -> None:
    depth = message_of(depth_file()[:cut]).depth
    whole = message_of(depth_file()).depth
    assert depth is not None
    assert whole is not None
    assert not is_whole_png(depth, SHAPE)
    assert is_whole_png(whole, SHAPE)
    assert not is_whole_png(whole, (SHAPE[0], SHAPE[1] + 1))


def test_damaged_depth_is_left_out_and_counted() -> None:
    data = bytearray(depth_file())
    data[len(data) // 2] ^= 255
    guard = ImageGuard()
    assert guard.reason == ""
    assert guard.sound(guard.guarded(message_of(bytes(data)))) is None
    assert guard.failures == 1
    assert "cannot be decoded" in guard.reason


@settings(max_examples=40)
@given(seed=st.integers(0, 999), spacing=st.floats(0.05, 2.0))
def test_poses_chosen_along_a_path_leave_no_gap_beyond_the_spacing(
    seed: int, spacing: float
) -> None:
    steps = np.random.default_rng(seed).uniform(0.0, 0.06, (60, 3))
    poses = planar_to_matrix(np.cumsum(steps, axis=0))
    chosen = evenly_along(poses, spacing)
    assert chosen[0] == 0
    assert (np.diff(chosen) > 0).all()
    moved = between(poses[:-1], poses[1:])
    way = np.maximum(np.linalg.norm(moved[:, :3, 3], axis=1), rotation_angle(moved))
    along = np.concatenate([[0.0], np.cumsum(way)])
    gaps = np.diff(np.append(along[chosen], along[-1]))
    assert gaps.max() <= spacing + 0.06 * np.sqrt(2) + 1e-9
    assert len(chosen) <= along[-1] / spacing + 1
    assert evenly_along(poses, 0.0).tolist() == list(range(60))
