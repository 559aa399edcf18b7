"""Depth of a node that keeps the right image of a stereo pair in its place."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import MapError

_BLOCK = 5  # pixels a side of what is compared
_SPAN = 16  # the widest disparity searched is a multiple of this
_SHARE = 0.15  # of the image's width: the widest disparity, for things near the camera
_SMOOTH, _JUMP = 8 * _BLOCK * _BLOCK, 32 * _BLOCK * _BLOCK  # prices of small and large steps
_FRACTION = 16.0  # parts of a pixel in which disparities are reported


def depth_from_pair(
    left: NDArray[np.uint8], right: NDArray[np.uint8], range_times_pixels: float, what: str
) -> NDArray[np.float32]:
    """Metres (H, W) at the pixels of a rectified left image, 0 where nothing matches.

    `left`, `right` are colour (H, W, 3) or grey (H, W). `range_times_pixels`: focal length [pixel]
    times baseline [m]. The disparity is found by semi-global matching (Hirschmueller 2008), as
    OpenCV has it. Raises `MapError` where the images differ in size.
    """
    if left.shape[:2] != right.shape[:2]:
        raise MapError(f"{what}: left and right image differ in size")
    pair = [image if image.ndim == 2 else _grey(image) for image in (left, right)]
    span = _SPAN * max(1, round(_SHARE * left.shape[1] / _SPAN))
    matcher = cv2.StereoSGBM.create(
        numDisparities=span,
        blockSize=_BLOCK,
        P1=_SMOOTH,
        P2=_JUMP,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=2,
    )
    disparity = matcher.compute(pair[0], pair[1]).astype(np.float32) / _FRACTION
    seen = disparity > 0.5
    depth = np.zeros(disparity.shape, np.float32)
    depth[seen] = range_times_pixels / disparity[seen]
    return depth


def _grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
