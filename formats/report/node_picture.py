"""A node's image small enough for a page that is mailed."""

from __future__ import annotations

import cv2
import numpy as np

from formats.picture_files import encoded_file
from formats.report.contents import NodePicture
from mapmyworld.types import ImageMessage

_QUALITY = 70  # of the JPEG


def node_picture(image: ImageMessage, width: int) -> NodePicture:
    """The image at most `width` pixels across, as JPEG."""
    pixels = _decoded(image, width)
    full = image.width or pixels.shape[1]
    height = max(1, round(pixels.shape[0] * width / pixels.shape[1]))
    if pixels.shape[1] > width:
        pixels = np.asarray(cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA))
    data = encoded_file(".jpg", pixels, cv2.IMWRITE_JPEG_QUALITY, _QUALITY)
    return NodePicture(data, pixels.shape[1], pixels.shape[0], pixels.shape[1] / full)


def _decoded(image: ImageMessage, width: int) -> np.ndarray:
    """Blue first, as OpenCV writes it; a JPEG of twice the width or more is decoded at half."""
    if image.encoded is not None and image.width >= 2 * width:
        data = np.frombuffer(image.encoded, np.uint8)
        half = cv2.imdecode(data, cv2.IMREAD_REDUCED_COLOR_2)
        if half is not None:
            return np.asarray(half)
    pixels = np.asarray(image.pixels(), np.uint8)
    return pixels if pixels.ndim == 2 else np.ascontiguousarray(pixels[:, :, ::-1])
