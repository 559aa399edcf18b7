"""Images as messages, raw or compressed."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.simulation.robot import OPTICAL
from mapmyworld.simulation.robot_settings import CameraSettings
from mapmyworld.types import ImageMessage

_PNG_EFFORT = 4  # of 9: smaller files take longer


def colour_message(
    colour: NDArray[np.uint8], stamp_ns: int, settings: CameraSettings
) -> ImageMessage:
    """RGB pixels (H, W, 3) as a message, with the JPEG where images are compressed."""
    encoded = None
    if settings.compressed:
        bgr = cv2.cvtColor(colour, cv2.COLOR_RGB2BGR)
        quality = [cv2.IMWRITE_JPEG_QUALITY, settings.jpeg_quality]
        encoded = cv2.imencode(".jpg", bgr, quality)[1].tobytes()
    height, width = colour.shape[:2]
    return ImageMessage(stamp_ns, OPTICAL, "rgb8", width, height, _held(colour), encoded)


def depth_message(
    depth: NDArray[np.float32], stamp_ns: int, settings: CameraSettings
) -> ImageMessage:
    """Depth (H, W) in metres as millimetres, with the PNG where images are compressed."""
    millimetres = np.rint(depth * 1000.0).astype(np.uint16)
    encoded = None
    if settings.compressed:
        effort = [cv2.IMWRITE_PNG_COMPRESSION, _PNG_EFFORT]
        encoded = cv2.imencode(".png", millimetres, effort)[1].tobytes()
    height, width = depth.shape
    metres = millimetres.astype(np.float32) * np.float32(0.001)
    return ImageMessage(stamp_ns, OPTICAL, "16UC1", width, height, _held(metres), encoded)


def _held(pixels: NDArray[np.generic]) -> Callable[[], NDArray[np.generic]]:
    return lambda: pixels
