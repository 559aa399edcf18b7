"""What a real depth camera makes of a perfect image: noise, holes, blur, wandering exposure."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.simulation.robot_settings import CameraSettings

_EXPOSURE_PERIOD = 9.0  # s in which brightness wanders up and down


def exposure_at(
    times: NDArray[np.float64], settings: CameraSettings, random: np.random.Generator
) -> NDArray[np.float64]:
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
