"""What a real depth camera makes of a perfect image, and the image as a message."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.simulation.robot import OPTICAL
from mapmyworld.simulation.robot_settings import CameraSettings
from mapmyworld.types import ImageMessage

_EXPOSURE_PERIOD = 9.0  # s in which brightness wanders up and down
_PNG_EFFORT = 4  # of 9: smaller files take longer


def exposure_at(times: Array, settings: CameraSettings, random: np.random.Generator) -> Array:
    """Factors of brightness at the times in s, (N,) both."""
    phase = random.uniform(0.0, 2.0 * np.pi)
    wave = np.sin(2.0 * np.pi * times / _EXPOSURE_PERIOD + phase)
    return np.asarray(1.0 + settings.exposure_change * wave)


def disturb_colour(
    colour: NDArray[np.uint8], gain: float, settings: CameraSettings, random: np.random.Generator
) -> NDArray[np.uint8]:
    """The image blurred, brighter or darker, and noisy; (H, W, 3) both."""
    image = colour.astype(np.float32) * np.float32(gain)
    if settings.blur > 0.0:
        image = cv2.GaussianBlur(image, (0, 0), settings.blur)
    noise = random.standard_normal(image.shape, np.float32)
    image += noise * np.float32(settings.image_noise)
    return np.asarray(np.clip(np.rint(image), 0, 255), np.uint8)


def disturb_depth(
    depth: NDArray[np.float32],
    slant: NDArray[np.float32],
    settings: CameraSettings,
    random: np.random.Generator,
) -> NDArray[np.float32]:
    """Depth in metres with noise that grows with its square; 0 where it is missing.

    `depth`, `slant`, the cosine between ray and normal, and the result are (H, W) each. Missing
    are: out of range, surfaces seen at a grazing angle, and pixels on a depth edge (Khoshelham and
    Elberink, "Accuracy and resolution of Kinect depth data", Sensors 2012).
    """
    missing = (depth < settings.depth_min) | (depth > settings.depth_max)
    missing |= slant < np.cos(np.radians(settings.depth_grazing))
    finite = np.where(np.isfinite(depth), depth, 1e3).astype(np.float32)
    block = np.ones((3, 3), np.uint8)
    spread = cv2.dilate(finite, block) - cv2.erode(finite, block)
    # On a slanted plane neighbours differ as well: only jumps beyond that are edges.
    missing |= (spread > settings.depth_edge * finite) & (slant > 0.15)
    noise = random.standard_normal(depth.shape, np.float32) * settings.depth_noise
    measured = finite + noise * finite * finite
    return np.where(missing, 0.0, measured).astype(np.float32)


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
    return ImageMessage(stamp_ns, OPTICAL, "rgb8", width, height, lambda: colour, encoded)


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
    return ImageMessage(stamp_ns, OPTICAL, "16UC1", width, height, lambda: metres, encoded)
