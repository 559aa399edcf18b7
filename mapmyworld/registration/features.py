"""Local features of an image, spread over it, with their 3D points from depth."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.rigid import transform_points
from mapmyworld.registration.camera_model import depth_at, rays_of_pixels
from mapmyworld.registration.image_levels import grey_picture
from mapmyworld.types import Features, RgbdImage

_SURPLUS = 3  # times the wanted number is detected, so that there is something to choose from


def extract_features(image: RgbdImage, config: Config, most: int | None = None) -> Features:
    """The features of a colour image, points in the base frame.

    At most `visual.feature_count`, or the best-spread `most` of them.
    """
    assert image.colour is not None
    grey = grey_picture(image)
    found = _detect(grey, config, most or config.visual.feature_count)
    if image.depth is None:
        return found
    return replace(found, points=_points_from_depth(image, found.pixels, config))


def _points_from_depth(
    image: RgbdImage, pixels: NDArray[np.float32], config: Config
) -> NDArray[np.float32]:
    """Points (N, 3) in the base frame of pixels (N, 2), NaN without usable depth."""
    assert image.depth is not None
    depth = np.asarray(image.depth.pixels(), np.float32)
    z = depth_at(image, depth, pixels)
    z[~((z > config.visual.depth_min) & (z < config.visual.depth_max))] = np.nan
    rays = rays_of_pixels(image.camera, pixels)
    points = np.concatenate([rays, np.ones((len(rays), 1))], axis=1) * z[:, None]
    return transform_points(image.camera.base_from_camera, points).astype(np.float32)


def _detect(grey: NDArray[np.uint8], config: Config, most: int) -> Features:
    settings = config.visual
    orb = cv2.ORB_create(
        settings.feature_count * _SURPLUS, edgeThreshold=19, fastThreshold=settings.fast_threshold
    )
    orb.setNLevels(min(orb.getNLevels(), _most_levels(grey, orb.getScaleFactor())))
    return _described(orb, grey, orb.detect(grey), most)


def _most_levels(grey: NDArray[np.uint8], factor: float) -> int:
    """Scales of an image, each smaller by a factor, the smallest of which still has pixels."""
    return 1 + int(math.log(max(1, min(grey.shape))) / math.log(factor))


def _described(
    orb: cv2.ORB, grey: NDArray[np.uint8], found: list[cv2.KeyPoint], wanted: int
) -> Features:
    """The best-spread `wanted` of the found keypoints, with descriptors (N, 32), without depth."""
    pixels = np.asarray(cv2.KeyPoint_convert(found), np.float32).reshape(-1, 2)
    responses = np.fromiter((k.response for k in found), np.float32, len(found))
    chosen = spread(pixels, responses, grey.shape[1], grey.shape[0], wanted)
    kept, descriptors = orb.compute(grey, [found[i] for i in chosen])
    if descriptors is None or len(kept) == 0:
        kept, descriptors = [], np.zeros((0, 32), np.uint8)
    rows = np.array([(k.size, k.angle, k.response, k.octave & 0xFF) for k in kept], np.float32)
    sizes, angles, strengths, octaves = np.ascontiguousarray(rows.reshape(-1, 4).T)
    return Features(
        _centred(kept, sizes.astype(np.float64) / orb.getPatchSize(), grey.shape),
        np.full((len(kept), 3), np.nan, np.float32),
        np.ascontiguousarray(descriptors, np.uint8),
        sizes,
        angles,
        strengths,
        octaves.astype(np.int32),
    )


def _centred(
    kept: list[cv2.KeyPoint],
    scales: NDArray[np.float64],
    shape: tuple[int, ...],
) -> NDArray[np.float32]:
    """Positions (N, 2) with pixel centres at whole numbers, in an image of (height, width).

    `scales` (N,): how much smaller than that the image is in which each was found.

    OpenCV's ORB multiplies the position found in a smaller image by the nominal scale. But that
    image has a whole number of pixels, and its first one has its centre half a wide pixel from the
    edge: features shift by up to 1.3 pixels, at each scale to another side.
    """
    pixels = np.asarray(cv2.KeyPoint_convert(kept), np.float32).reshape(-1, 2)
    nominal = np.maximum(scales, 1.0)[:, None]
    size = np.array([shape[1], shape[0]])
    scale = size / np.rint(size / nominal)
    return np.asarray((pixels / nominal + 0.5) * scale - 0.5, np.float32)


def spread(
    pixels: NDArray[np.float32],
    responses: NDArray[np.float32],
    width: int,
    height: int,
    wanted: int,
) -> NDArray[np.int64]:
    """(K,) indices of at most `wanted` keypoints so that every part of the image has its share.

    They are at `pixels` (N, 2), as strong as their `responses` (N,). The image is cut in square
    cells, one for each that is wanted; the strongest of each cell come first, then the second
    strongest of each, and so on.
    Deterministic: ties keep the order in which they were found.
    """
    if len(pixels) <= wanted:
        return np.arange(len(pixels))
    size = math.sqrt(width * height / wanted)
    cells = np.floor(pixels / size).astype(np.int64) @ np.array([1, width])
    order = np.lexsort((np.arange(len(pixels)), -responses, cells))
    sorted_cells = cells[order]
    first = np.searchsorted(sorted_cells, sorted_cells)
    rank = np.arange(len(order)) - first
    best = np.lexsort((np.arange(len(order)), -responses[order], rank))[:wanted]
    return np.sort(order[best])
