"""Images decoded no finer than wanted, and points summed by voxel, against plain references."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from formats.logs.image_pixels import encoded_pixels
from mapmyworld.config import Config
from mapmyworld.mapping.voxel_map import VoxelMap
from mapmyworld.registration.features import extract_features
from mapmyworld.registration.image_levels import colours_at, grey_picture
from mapmyworld.sensing.sound_images import ImageGuard
from mapmyworld.types import CameraModel, ImageMessage, RgbdImage

K = np.array([[60.0, 0.0, 31.5], [0.0, 60.0, 23.5], [0.0, 0.0, 1.0]])


def smooth_picture(seed: int) -> NDArray[np.uint8]:
    """(48, 64, 3) RGB without sharp edges, which JPEG would blur."""
    small = np.random.default_rng(seed).integers(0, 256, (4, 5, 3)).astype(np.float32)
    wide = cv2.resize(small, (64, 48), interpolation=cv2.INTER_CUBIC)
    return np.asarray(np.clip(wide, 0, 255), np.uint8)


def image_of(pixels: NDArray[np.uint8], encoded: bytes | None) -> RgbdImage:
    message = ImageMessage(0, "camera", "rgb8", 64, 48, lambda: pixels, encoded)
    return RgbdImage(CameraModel(64, 48, K, "", np.zeros(0), np.eye(4)), message, None)


def jpeg_of(pixels: NDArray[np.uint8]) -> bytes:
    return bytes(cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])[1])


@pytest.mark.parametrize("seed", range(3))
def test_a_jpeg_gives_the_same_grey_levels_as_its_colours(seed: int) -> None:
    picture = smooth_picture(seed)
    plain = grey_picture(image_of(picture, None)).astype(int)
    direct = grey_picture(image_of(picture, jpeg_of(picture))).astype(int)
    assert np.abs(plain - direct).max() <= 6


@pytest.mark.parametrize("spacing", [1, 2, 4, 5, 8])
def test_colours_of_a_small_jpeg_are_those_around_the_pixel(spacing: int) -> None:
    picture = smooth_picture(7)
    u, v = np.meshgrid(np.arange(4, 60, spacing), np.arange(4, 44, spacing))
    pixels = np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)
    found = colours_at(image_of(picture, jpeg_of(picture)), pixels, spacing).astype(int)
    width = max(f for f in (1, 2, 4, 8) if f <= spacing)
    for (x, y), colour in zip(pixels.astype(int), found, strict=True):
        x0, y0 = x // width * width, y // width * width
        mean = picture[y0 : y0 + width, x0 : x0 + width].reshape(-1, 3).mean(axis=0)
        assert np.abs(colour - mean).max() <= 8


def test_a_damaged_jpeg_is_left_to_the_reader_that_can_tell() -> None:
    picture = smooth_picture(1)
    broken = image_of(picture, b"\xff\xd8\xff nothing of the kind")
    assert np.array_equal(grey_picture(broken), cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))
    assert np.array_equal(colours_at(broken, np.array([[5.0, 6.0]]), 4)[0], picture[6, 5])


@settings(max_examples=20)
@given(seed=st.integers(0, 1000), count=st.integers(1, 400))
def test_voxels_hold_the_means_of_their_points(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    points = random.uniform(-0.5, 0.5, (count, 3))
    colours = random.integers(0, 256, (count, 3)).astype(np.uint8)
    normals = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (count, 1))
    voxels = VoxelMap(0.2)
    for part in np.array_split(np.arange(count), 3):
        voxels.add(points[part], colours[part], normals[part])
    cloud = voxels.to_cloud()
    cells, of = np.unique(np.floor(points / 0.2).astype(int), axis=0, return_inverse=True)
    of = of.ravel()
    assert len(cloud.points) == len(cells)
    for k in range(len(cells)):  # both in ascending order of x, y, z
        assert np.allclose(cloud.points[k], points[of == k].mean(axis=0), atol=0.2 / 500)
        assert cloud.colours is not None
        assert np.abs(cloud.colours[k] - colours[of == k].mean(axis=0)).max() <= 0.51


def test_many_voxels_are_all_kept() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(60)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    points = np.asarray((grid + 0.5) * 0.1, np.float64)
    zeros = np.zeros((len(points), 3))
    voxels = VoxelMap(0.1)
    voxels.add(points, zeros.astype(np.uint8), zeros.astype(np.float32))
    voxels.add(points, zeros.astype(np.uint8), zeros.astype(np.float32))
    assert np.allclose(voxels.to_cloud(2).points, points, atol=0.1 / 500)


@pytest.mark.parametrize(("length", "width", "sound"), [(None, 64, 1), (90, 64, 0), (None, 32, 0)])
def test_a_jpeg_is_tried_at_an_eighth_of_its_size(
    length: int | None, width: int, sound: bool
) -> None:
    """Cut within its tables, or of another width than the camera's, it is no image."""
    whole: list[int] = []
    data = jpeg_of(np.asarray(cv2.resize(smooth_picture(2), (width, 48)), np.uint8))[:length]

    def pixels() -> NDArray[np.generic]:
        whole.append(1)
        return encoded_pixels(data, "rgb8")

    image = image_of(smooth_picture(2), data)
    assert image.colour is not None
    guard = ImageGuard()
    seen = replace(image, colour=replace(image.colour, width=width, pixels=pixels))
    found = guard.sound(guard.guarded(seen))
    assert (found is not None, guard.failures, len(whole)) == (sound, not sound, not sound)


@pytest.mark.parametrize("shape", [(240, 320), (301, 417)])
def test_features_of_a_picture_upside_down_lie_where_they_did(shape: tuple[int, int]) -> None:
    """What shifts features of a scale to one side shows twice: the pyramid has whole pixels."""
    height, width = shape
    random = np.random.default_rng(5)
    coarse = random.integers(0, 256, (shape[0] // 6, shape[1] // 6)).astype(np.uint8)
    grey = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    camera = CameraModel(width, height, K, "", np.zeros(0), np.eye(4))
    found = []
    for pixels in (grey, np.ascontiguousarray(grey[::-1, ::-1])):
        message = ImageMessage(0, "camera", "mono8", width, height, lambda p=pixels: p)
        found.append(extract_features(RgbdImage(camera, message, None), Config()))
    there, turned = found
    back = np.array([width - 1, height - 1]) - turned.pixels
    compared = 0
    for octave in range(8):
        a, b = there.pixels[there.octaves == octave], back[turned.octaves == octave]
        if len(a) < 10 or len(b) < 10:
            continue
        apart = a[:, None] - b[None]
        nearest = np.linalg.norm(apart, axis=2).argmin(axis=1)
        offset = apart[np.arange(len(a)), nearest]
        close = offset[np.linalg.norm(offset, axis=1) < 1.2**octave]
        if len(close) >= 10:
            assert np.abs(np.median(close, axis=0)).max() < 0.05
            compared += 1
    assert compared >= 4
