"""An image's features made ready for matching and for estimating poses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import invert, transform_points
from mapmyworld.kernels.image_matching import match_all, match_projected
from mapmyworld.registration.camera_model import rays_of_pixels
from mapmyworld.types import CameraModel, Features

SEARCH_RADIUS = 30.0
"""Pixels around the prediction in which a point is looked for; edge of the cells of features."""
_BITS = 64  # of 256 in which matching features may differ
_RATIO = 0.8  # best distance to second best, at most
_PIXEL_SIGMA = 1.0  # pixels, standard deviation of a feature at the finest scale
ORB_PATCH = 31.0
"""Pixels, diameter of an ORB feature at the finest scale."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One image's features, rectified, as a camera at depth 1 would see them."""

    camera: CameraModel
    features: Features
    pixels: NDArray[np.float32]
    """(N, 2) in the rectified image of the same intrinsics."""
    seen: Array
    """(N, 3): x, y at depth 1 and inverse depth in 1/m, NaN without depth."""
    sigmas: Array
    """(N, 3) as in `Sightings`."""
    words: NDArray[np.uint64]
    """(N, 4) descriptors as 256 bits."""
    starts: NDArray[np.int32]
    """(C + 1,) where the features of each cell of the image begin in `members`."""
    members: NDArray[np.int32]
    """(N,) features, cell by cell."""
    columns: int
    """Cells in a row of the image."""

    def __len__(self) -> int:
        return len(self.pixels)

    def camera_points(self) -> Array:
        """Points (N, 3) in the camera's frame, NaN without depth."""
        with np.errstate(divide="ignore"):
            z = 1.0 / self.seen[:, 2:]
        return np.concatenate([self.seen[:, :2] * z, z], axis=1)


def make_view(features: Features, camera: CameraModel, config: Config) -> View:
    """The view that `features` of an image of `camera` give."""
    rays = rays_of_pixels(camera, features.pixels)
    focal = np.diag(camera.intrinsics)[:2]
    pixels = rays * focal + camera.intrinsics[:2, 2]
    z = transform_points(invert(camera.base_from_camera), features.points)[:, 2]
    seen = np.concatenate([rays, (1.0 / z)[:, None]], axis=1)
    sigmas = np.empty((len(rays), 3))
    sigmas[:, 0] = pixel_sigmas(features) / focal[0]
    sigmas[:, 1] = config.visual.depth_sigma
    sigmas[:, 2] = config.visual.inlier_sigmas * config.visual.depth_sigma
    columns = int(np.ceil(camera.width / SEARCH_RADIUS))
    starts, members = _sorted_into_cells(
        pixels, columns, int(np.ceil(camera.height / SEARCH_RADIUS))
    )
    return View(
        camera,
        features,
        pixels.astype(np.float32),
        seen,
        sigmas,
        binary_words(features),
        starts,
        members,
        columns,
    )


def pixel_sigmas(features: Features) -> Array:
    """(N,) standard deviations of where features lie, pixels."""
    return _PIXEL_SIGMA * scales(features)


def scales(features: Features) -> Array:
    """(N,) how much coarser than the finest scale each feature was found."""
    if features.descriptors.dtype == np.uint8:
        return np.asarray(np.maximum(features.sizes / ORB_PATCH, 1.0), np.float64)
    return np.asarray(np.maximum(features.sizes / 4.0, 1.0), np.float64)


def binary_words(features: Features) -> NDArray[np.uint64]:
    """(N, 4) descriptors as 256 bits in integers.

    Real-valued ones become the signs of random projections, whose Hamming distance grows with
    the angle between descriptors (Charikar, "Similarity estimation techniques", 2002).
    """
    descriptors = features.descriptors
    if descriptors.dtype != np.uint8:
        roots = np.sqrt(np.maximum(descriptors, 0.0))
        centred = roots - roots.mean(axis=1, keepdims=True)
        descriptors = np.packbits(centred @ _projections(descriptors.shape[1]) > 0, axis=1)
    writable = np.require(descriptors, requirements=("C", "W"))  # or kernels are compiled twice
    return writable.view(np.uint64).reshape(-1, 4)


@lru_cache(maxsize=2)
def _projections(width: int) -> NDArray[np.float32]:
    return np.random.default_rng(1).standard_normal((width, 256)).astype(np.float32)


def match_around(
    view: View,
    camera_points: Array,
    words: NDArray[np.uint64],
    radius: float | NDArray[np.floating],
) -> NDArray[np.int32]:
    """(P,) for each point (P, 3) in the camera's frame the feature seen near it, -1 for none.

    Points have `words` (P, 4); `radius` in pixels, one for all or (P,), as of `match_projected`.
    """
    k = view.camera.intrinsics
    z = camera_points[:, 2]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        projected = camera_points[:, :2] / z[:, None] * np.diag(k)[:2] + k[:2, 2]
        pixels = np.nan_to_num(projected).astype(np.float32)
    radii = np.broadcast_to(np.asarray(radius, np.float32), (len(projected),))
    margin = 20.0
    size = np.array([view.camera.width, view.camera.height])
    ahead = (z > 0.05) & ((projected > -margin) & (projected < size + margin)).all(axis=1)
    matches: NDArray[np.int32] = match_projected(
        pixels,
        np.where(ahead, radii, np.float32(0.0)).astype(np.float32),
        words,
        view.pixels,
        view.words,
        SEARCH_RADIUS,
        view.starts,
        view.members,
        view.columns,
        _BITS,
        _RATIO,
    )
    return matches


def match_views(a: View, b: View) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(M,) features of a and (M,) of b that are each other's best, wherever they lie."""
    matches = match_all(a.words, b.words, _BITS, _RATIO)
    found = np.flatnonzero(matches >= 0)
    return found, matches[found].astype(np.int64)


def _sorted_into_cells(
    pixels: Array, columns: int, rows: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Starts (cells + 1,) and members (N,) of the features sorted by cell, row after row."""
    cells = np.clip(np.floor(pixels / SEARCH_RADIUS).astype(np.int64), 0, [columns - 1, rows - 1])
    keys = cells[:, 1] * columns + cells[:, 0]
    members = np.argsort(keys, kind="stable").astype(np.int32)
    starts = np.searchsorted(keys[members], np.arange(columns * rows + 1)).astype(np.int32)
    return starts, members
