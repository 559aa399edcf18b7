"""What a Kinect makes of a simulated scene: both shutters roll, depth comes from its own camera.

Two cameras and a projector: the colour image is taken row by row through a bent lens while the
hand moves on; depth is measured by triangulation in steps of an eighth of a pixel (Khoshelham and
Elberink, "Accuracy and resolution of Kinect depth data", 2012), is missing where the projector
casts a shadow, and is laid over the colour image by its own, slightly wrong calibration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.rigid import transform_points
from mapmyworld.registration.camera_model import pixels_of_points
from mapmyworld.simulation.robot_settings import SimulationSettings
from mapmyworld.simulation.simulated_camera import Renderer
from mapmyworld.simulation.world import Scene
from mapmyworld.types import CameraModel

Array = NDArray[np.float64]
Motion = Callable[[float], Array]  # s -> world_from_optical (4, 4) of the colour camera
SIZE = (640, 480)
COLOUR = np.array([[517.3, 0.0, 318.6], [0.0, 516.5, 255.3], [0.0, 0.0, 1.0]])
BENT = np.array([0.2624, -0.9531, -0.0054, 0.0026, 1.1633])
_CAMERA = CameraModel(*SIZE, COLOUR, "plumb_bob", BENT, np.eye(4))
_DEPTH = np.array([[580.0, 0.0, 319.5], [0.0, 580.0, 239.5], [0.0, 0.0, 1.0]])
_READOUT = 0.026  # s from the first row to the last
_ASIDE = 0.025  # m from the colour camera to the one for depth
_BASELINE = 0.075  # m from there to the projector
_STEP = 0.125  # pixels of disparity


@dataclass(frozen=True)
class Faults:
    """How far this Kinect is from a perfect one."""

    exposure: float = 0.012  # s
    image_noise: float = 3.0  # grey values, standard deviation
    disparity_noise: float = 0.06  # pixels, standard deviation, alike within a few pixels
    misplaced: tuple[float, float] = (0.8, -0.6)  # pixels of colour by which depth lies beside it
    depth_scale: float = 1.005


class Kinect:
    """A scene made ready for recordings."""

    def __init__(self, scene: Scene, faults: Faults) -> None:
        self._renderer = Renderer(scene, SimulationSettings())
        self._faults = faults
        self._colour_rays = _rays(COLOUR, BENT)
        self._depth_rays = _rays(_DEPTH, np.zeros(5))
        self._share = np.repeat(np.arange(SIZE[1], dtype=np.float32) / SIZE[1], SIZE[0])
        self._away = np.eye(4)
        self._away[0, 3] = -_ASIDE

    def colour(
        self, motion: Motion, time: float, gain: float, random: np.random.Generator
    ) -> NDArray[np.uint8]:
        """The picture (H, W, 3) whose middle row is exposed around that time."""
        sharp = self._cast(motion, time, np.eye(4), self._colour_rays)[0]
        picture = _smeared(sharp, motion, time, self._faults.exposure) * gain
        picture = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 0.6)
        picture += self._faults.image_noise * random.standard_normal(picture.shape, np.float32)
        return np.asarray(np.clip(np.rint(picture), 0, 255), np.uint8)

    def depth(self, motion: Motion, time: float, random: np.random.Generator) -> Array:
        """Metres (H, W), 0 = none, registered to the colour image."""
        _, z, slant = self._cast(motion, time, self._away, self._depth_rays)
        good = np.isfinite(z) & (z > 0.5) & (z < 9.0) & (slant > 0.2)
        disparity = np.where(good, _DEPTH[0, 0] * _BASELINE / np.where(good, z, 1.0), 0.0)
        good &= ~_shadowed(disparity)
        noise = cv2.GaussianBlur(random.standard_normal(z.shape), (0, 0), 2.0)
        disparity += noise / noise.std() * self._faults.disparity_noise
        disparity = np.rint(disparity / _STEP) * _STEP
        far = np.where(good, _DEPTH[0, 0] * _BASELINE / np.maximum(disparity, 1.0), 0.0)
        return self._registered(far * self._faults.depth_scale)

    def _registered(self, z: Array) -> Array:
        found = z.ravel() > 0
        points = self._depth_rays[found] * z.ravel()[found, None]
        points = transform_points(self._away, points)
        pixels = pixels_of_points(_CAMERA, points)
        cells = np.rint(pixels + self._faults.misplaced).astype(np.int64)
        inside = ((cells >= 0) & (cells < SIZE)).all(axis=1)
        cells, depth = cells[inside], points[inside, 2]
        order = np.argsort(-depth, kind="stable")  # the nearest is written last
        out = np.zeros(SIZE[::-1])
        out[cells[order, 1], cells[order, 0]] = depth[order]
        return out

    def _cast(
        self, motion: Motion, time: float, mount: Array, rays: NDArray[np.float32]
    ) -> tuple[NDArray[np.uint8], Array, Array]:
        """Colours, depths and slants while the rows are read, the first one first."""
        first, last = (motion(time + k * _READOUT) @ mount for k in (-0.5, 0.5))
        share = self._share[:, None]  # so short a turn is straight enough
        ways = rays @ first[:3, :3].T.astype(np.float32)
        ways += share * (rays @ (last - first)[:3, :3].T.astype(np.float32))
        places = (first[:3, 3] + share * (last - first)[:3, 3]).astype(np.float32)
        view = self._renderer.cast(places, ways, SIZE[::-1])
        return view.colour, view.depth.astype(np.float64), view.slant.astype(np.float64)


def _smeared(
    picture: NDArray[np.uint8], motion: Motion, time: float, exposure: float
) -> NDArray[np.float32]:
    """The picture blurred by how the camera turns while it is exposed."""
    first, last = (motion(time + k * exposure)[:3, :3] for k in (-0.5, 0.5))
    moved = COLOUR @ first.T @ last @ np.linalg.inv(COLOUR)
    total = np.zeros(picture.shape, np.float32)
    shares = np.linspace(-0.5, 0.5, 5)
    for share in shares:
        total += cv2.warpPerspective(
            picture, np.eye(3) + share * (moved - np.eye(3)), SIZE, borderMode=cv2.BORDER_REPLICATE
        )
    return np.asarray(total / len(shares))


def _rays(matrix: Array, bent: Array) -> NDArray[np.float32]:
    """Directions (H * W, 3) of the pixels, length one along the axis."""
    u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2).astype(np.float64)
    flat = cv2.undistortPoints(pixels, matrix, bent, None, None, None)[:, 0]
    return np.concatenate([flat, np.ones((len(flat), 1))], axis=1).astype(np.float32)


def _shadowed(disparity: Array) -> NDArray[np.bool_]:
    """Pixels (H, W) that something nearer hides from the projector."""
    place = np.arange(disparity.shape[1]) - disparity
    return np.asarray(place < np.maximum.accumulate(place, axis=1) - 1.0)
