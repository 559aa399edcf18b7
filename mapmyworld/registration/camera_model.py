"""Between pixels and rays: rectification and back-projection by the camera's own model."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.types import CameraModel, RgbdImage


def rays_of_pixels(camera: CameraModel, pixels: NDArray[np.floating]) -> Array:
    """Normalised image coordinates (N, 2), at depth 1 and free of distortion, of pixels (N, 2)."""
    pixels = np.ascontiguousarray(pixels, np.float64).reshape(-1, 2)
    k = camera.intrinsics
    if len(pixels) == 0 or not is_distorted(camera):
        return np.asarray((pixels - k[:2, 2]) / [k[0, 0], k[1, 1]])
    model, distortion = opencv_model(camera)
    rays = model.undistortPoints(pixels[:, None], k, distortion)
    return np.asarray(rays, np.float64).reshape(-1, 2)


def pixels_of_points(camera: CameraModel, points: NDArray[np.floating]) -> Array:
    """Pixels (N, 2) in the image as recorded, of points (N, 3) in the camera's frame.

    Points at or behind the camera's plane give NaN.
    """
    pixels = np.full((len(points), 2), np.nan)
    before = np.asarray(points)[:, 2] > 1e-6
    if not before.any():
        return pixels
    plain: Array = np.asarray(points, np.float64)[before]
    rays, still = plain / plain[:, 2:], np.zeros(3)
    k = np.asarray(camera.intrinsics, np.float64)
    if not is_distorted(camera):
        pixels[before] = rays[:, :2] * [k[0, 0], k[1, 1]] + k[:2, 2]
    else:
        model, distortion = opencv_model(camera)
        bent, _ = model.projectPoints(rays[:, None], still, still, k, distortion)
        pixels[before] = bent[:, 0]
    return pixels


def depth_grid_points(image: RgbdImage, stride: int) -> tuple[Array, NDArray[np.float32]]:
    """Pixels (H, W, 2) on a lattice and their depths (H, W) in metres, 0 where there is none.

    `stride` counts pixels of the full image; a smaller depth image is never oversampled.
    """
    assert image.depth is not None
    depth = np.asarray(image.depth.pixels(), np.float32)
    factor = image.camera.width / depth.shape[1]
    step = max(1, min(round(stride / factor), *depth.shape))  # a point of every image at least
    rows, columns = (
        np.arange(step // 2, depth.shape[0], step),
        np.arange(step // 2, depth.shape[1], step),
    )
    u, v = np.meshgrid((columns + 0.5) * factor - 0.5, (rows + 0.5) * factor - 0.5)
    return np.stack([u, v], axis=-1), np.ascontiguousarray(depth[rows[:, None], columns])


def grid_rays(camera: CameraModel, pixels: Array) -> NDArray[np.float32]:
    """Rays (H, W, 2) of a lattice of pixels (H, W, 2), at depth 1 and free of distortion.

    Remembered, since every view asks again.
    """
    key = camera.intrinsics.tobytes(), camera.distortion_model, camera.distortion.tobytes()
    return _grid_rays(key, pixels.tobytes(), pixels.shape)


@lru_cache(maxsize=8)
def _grid_rays(
    key: tuple[bytes, str, bytes], pixels: bytes, shape: tuple[int, ...]
) -> NDArray[np.float32]:
    intrinsics = np.frombuffer(key[0]).reshape(3, 3)
    camera = CameraModel(0, 0, intrinsics, key[1], np.frombuffer(key[2]), np.eye(4))
    rays = rays_of_pixels(camera, np.frombuffer(pixels).reshape(-1, 2)).astype(np.float32)
    return rays.reshape(shape)


def depth_at(image: RgbdImage, depth: NDArray[np.float32], pixels: NDArray[np.floating]) -> Array:
    """Depths (N,) in m at pixels (N, 2) of the full image, NaN where `depth` (H, W) has none."""
    factor = image.camera.width / depth.shape[1]
    cells = np.round((pixels + 0.5) / factor - 0.5)
    inside = ((cells >= 0) & (cells < depth.shape[::-1])).all(axis=1)
    columns, rows = cells[inside].astype(np.int64).T
    found = np.full(len(cells), np.nan)
    found[inside] = depth[rows, columns]
    found[~(found > 0)] = np.nan
    return found


def opencv_model(camera: CameraModel) -> tuple[Any, Array]:
    """OpenCV's functions for the distortion of a camera, and their coefficients (D,)."""
    if camera.distortion_model == "equidistant":
        return cv2.fisheye, camera.distortion[:4]
    return cv2, camera.distortion


def is_distorted(camera: CameraModel) -> bool:
    """Whether straight lines are bent in its images."""
    return camera.distortion_model != "" and bool(np.any(camera.distortion))
