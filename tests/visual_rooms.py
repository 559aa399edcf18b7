"""A box-shaped room with pictures on its walls, ray cast in numpy: colour and depth, exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.rigid import make_transform
from mapmyworld.types import CameraModel, ImageMessage, RgbdImage

Array = NDArray[np.float64]
WIDTH, HEIGHT, FOCAL = 320, 240, 260.0
# Optical axes (z forward, x right, y down) of a camera that looks along the base's x axis.
LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class Room:
    """A box of `size` (3,) metres with its corner at the origin; walls repeat every `period`."""

    size: tuple[float, float, float] = (6.0, 5.0, 2.5)
    period: float = 1e9  # m after which the pictures on the walls repeat
    seed: int = 0

    def camera(self, height: float = 1.2) -> CameraModel:
        k = np.array([[FOCAL, 0, WIDTH / 2 - 0.5], [0, FOCAL, HEIGHT / 2 - 0.5], [0, 0, 1.0]])
        mount = make_transform(LEVEL, np.array([0.0, 0.0, height]))
        return CameraModel(WIDTH, HEIGHT, k, "", np.zeros(0), mount)

    def image(self, map_from_base: Array, stamp_ns: int = 0, height: float = 1.2) -> RgbdImage:
        """What a camera on the base sees, level and looking along the base's x axis."""
        camera = self.camera(height)
        grey, depth = self.look(map_from_base @ camera.base_from_camera)
        rgb = np.repeat(grey[..., None], 3, axis=2)
        size = (WIDTH, HEIGHT)
        colour = ImageMessage(stamp_ns, "camera", "rgb8", *size, lambda: rgb)
        deep = ImageMessage(stamp_ns, "camera", "32FC1", *size, lambda: depth)
        return RgbdImage(camera, colour, deep)

    def look(self, map_from_camera: Array) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Grey levels and depths (H, W), by where each pixel's ray leaves the box."""
        u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
        local = np.stack([(u - WIDTH / 2 + 0.5) / FOCAL, (v - HEIGHT / 2 + 0.5) / FOCAL], axis=-1)
        rays = np.concatenate([local, np.ones((*u.shape, 1))], axis=-1) @ map_from_camera[:3, :3].T
        start = map_from_camera[:3, 3]
        with np.errstate(divide="ignore"):
            to_wall = np.where(rays > 0, np.array(self.size) - start, -start) / rays
        axis = np.argmin(to_wall, axis=-1)
        depth = np.min(to_wall, axis=-1)
        hit = start + rays * depth[..., None]
        side = np.take_along_axis(rays, axis[..., None], axis=-1)[..., 0] > 0
        grey = np.zeros(u.shape)
        for wall in range(6):
            mine = (axis == wall // 2) & (side == bool(wall % 2))
            across = np.delete(hit[mine], wall // 2, axis=1)
            grey[mine] = self._paint(wall, across)
        return grey.astype(np.uint8), depth.astype(np.float32)

    def _paint(self, wall: int, across: Array) -> Array:
        """Bilinear noise of two grain sizes at points (N, 2) of a wall."""
        total = np.full(len(across), 128.0)
        repeated = across.copy()
        repeated[:, 0] %= self.period
        for grain, contrast in ((0.05, 70.0), (0.2, 50.0)):
            values = np.random.default_rng([self.seed, wall, int(grain * 1000)]).uniform(
                -1, 1, (200, 200)
            )
            cells = repeated / grain
            low = np.floor(cells).astype(int)
            part = cells - low
            corners = [
                values[(low[:, 0] + a) % 200, (low[:, 1] + b) % 200]
                * (part[:, 0] if a else 1 - part[:, 0])
                * (part[:, 1] if b else 1 - part[:, 1])
                for a in (0, 1)
                for b in (0, 1)
            ]
            total += contrast * sum(corners)
        return np.clip(total, 0, 255)


def planar_pose(x: float, y: float, yaw: float) -> Array:
    cos, sin = np.cos(yaw), np.sin(yaw)
    rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return make_transform(rotation, np.array([x, y, 0.0]))


def circle(
    centre: Sequence[float], radius: float, count: int, laps: float, phase: float = 0.0
) -> list[Array]:
    """Poses on a circle, looking outwards along the motion turned by a quarter to the right."""
    angles = phase + np.linspace(0.0, 2.0 * np.pi * laps, count)
    return [
        planar_pose(centre[0] + radius * np.cos(a), centre[1] + radius * np.sin(a), a)
        for a in angles
    ]
