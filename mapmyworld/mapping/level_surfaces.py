"""Which way is up, and where the floor is, for a camera that somebody carries.

A robot's tf indicates both; a hand's camera may begin at any tilt and height.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import transform_points
from mapmyworld.geometry.rotations import so3_exp
from mapmyworld.mapping.cloud_map import VIEW_ANGLE, organised_surface
from mapmyworld.types import RgbdImage
from mapmyworld.types.rows import Rows

_STRIDE = 12  # pixels between the points looked at: a Kinect's steps of depth tilt nearer ones
_NEAR = 3.5  # m up to which normals are worth looking at
_SAME = np.radians(6.0)  # between the normals of level surfaces, at most
_SINGLE = 0.03  # weight of the pictures' upper edges beside their lower ones, where none turned
_BACK = 0.5  # weight of the pictures' backs beside their upper edges: one looks down more than up
_BY_HAND = np.radians(60.0)  # that the pictures may be tilted on the whole
_BY_FORCE = np.radians(8.0)  # that surfaces may be off what an accelerometer indicates
_CANDIDATES = 400  # directions tried
_VOTES = 20_000  # normals that choose among them
_LEVEL_VOTES = 3  # of a level surface; three kinds of walls at right angles would be alike else
_SQUARE = 0.5  # sine between two walls that indicate together what is up
_ENOUGH = 0.1  # share of all normals that distinguish up from the next best; 0.06 of round things
_LAYER = 0.05  # m of height that points of one level surface share
_FLOOR = 0.04  # share of the points facing up that the floor must have


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces(Rows):
    """Points on what cameras saw, in one frame."""

    points: Array
    """(N, 3) m."""
    normals: Array
    """(N, 3) unit, towards the camera."""


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """How a map is turned and lifted so that z is up and 0 at the floor."""

    level_from_map: Array
    """(4, 4)."""
    reason: str


def surfaces_of(image: RgbdImage, map_from_base: Array, config: Config) -> Surfaces:
    """The surfaces near an image's camera, in the frame of `map_from_base` (4, 4)."""
    _, depth, local, normals, slant = organised_surface(image, _STRIDE)
    good = (depth > config.visual.depth_min) & (depth < _NEAR)
    good &= slant > np.cos(np.radians(VIEW_ANGLE))
    map_from_camera = map_from_base @ image.camera.base_from_camera
    turned = normals[good].astype(np.float64) @ map_from_camera[:3, :3].T
    return Surfaces(transform_points(map_from_camera, local[good]), turned)


def joined(parts: Iterable[Surfaces]) -> Surfaces:
    """All surfaces together; the frame is theirs."""
    return Surfaces(np.zeros((0, 3)), np.zeros((0, 3))).followed_by(*parts)


def find_level(seen: Surfaces, held: Array, force: Array | None) -> Level:
    """The level of a map: by surfaces, else by an accelerometer, else as the pictures were held.

    `held` (3,): see `up_as_held`. `force` (3,): the specific force, see `GravityDirection`.
    """
    hint, reach, by = (held, _BY_HAND, "the camera's mean attitude (no level surface seen)")
    if force is not None:
        hint, reach, by = force / np.linalg.norm(force), _BY_FORCE, "the accelerometer"
    up = _up_of_surfaces(seen.normals, hint, reach)
    up, by = (hint, by) if up is None else (up, "level surfaces")
    heights = (seen.points @ up)[seen.normals @ up > np.cos(2.0 * _SAME)]
    height = _floor_height(heights)
    if height is None:
        return Level(_level_from_map(up, 0.0), f"gravity estimated from {by}; no floor seen")
    return Level(_level_from_map(up, -height), f"gravity estimated from {by}; z is 0 at the floor")


def up_as_held(map_from_camera: Array) -> Array:
    """Where up is (3,) if the pictures of cameras (N, 3, 3) were held upright, however far down
    they looked: square to their lower edges, towards their upper ones.

    A camera that was rolled to and fro has lower edges in all directions. What they have in common
    is believed only if it agrees with where the upper edges and the backs of the pictures point.
    """
    edges, upper = map_from_camera[:, :, 0], -map_from_camera[:, :, 1].mean(axis=0)
    moments = edges.T @ edges / len(edges) - _SINGLE * np.outer(upper, upper)
    up = np.linalg.eigh(moments)[1][:, 0]
    roughly = upper - _BACK * map_from_camera[:, :, 2].mean(axis=0)
    roughly /= np.linalg.norm(roughly)
    up = up * np.sign(up @ roughly)
    return np.asarray(up if up @ roughly > np.cos(_BY_HAND) else roughly)


def _up_of_surfaces(normals: Array, hint: Array, reach: float) -> Array | None:
    """The direction (3,) near a hint (3,) that makes most surfaces level or upright.

    None where surfaces leave it open. The best candidate is refined to the direction that is
    nearest to the level ones' normals and farthest from the upright ones'.
    """
    candidates = _candidates(normals)
    candidates = candidates * np.sign(candidates @ hint)[:, None]
    candidates = candidates[candidates @ hint > np.cos(reach)]
    if not len(candidates):
        return None
    voting = normals[:: max(1, len(normals) // _VOTES)]
    up = max(candidates, key=lambda c: _votes(voting @ c) * float(c @ hint))
    for _ in range(3):
        level, upright = _level_and_upright(normals @ up)
        moments = normals[upright].T @ normals[upright] - normals[level].T @ normals[level]
        spread, axes = np.linalg.eigh(moments / len(normals))
        up = axes[:, 0] * np.sign(axes[:, 0] @ up)
    is_clear = spread[1] - spread[0] > _ENOUGH
    return np.asarray(up) if is_clear and up @ hint > np.cos(reach) else None


def _candidates(normals: Array) -> Array:
    """Directions (N, 3) that may be up: normals of floors, and what two walls have in common."""
    some = normals[:: max(1, len(normals) // _CANDIDATES)]
    both = np.cross(some, np.roll(some, len(some) // 2 + 1, axis=0))
    lengths = np.linalg.norm(both, axis=1)
    wide = lengths > _SQUARE
    return np.concatenate([some, both[wide] / lengths[wide, None]])


def _votes(cosines: Array) -> int:
    level, upright = _level_and_upright(cosines)
    return int(_LEVEL_VOTES * np.count_nonzero(level) + np.count_nonzero(upright))


def _level_and_upright(cosines: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which surfaces are level and which upright, of the cosines (N,) of their normals with up."""
    size = np.abs(cosines)
    return size > np.cos(_SAME), size < np.sin(_SAME)


def _floor_height(heights: Array) -> float | None:
    """The lowest height at which a fair share of what faces up lies; None without any."""
    if not len(heights):
        return None
    steps = np.floor(heights / _LAYER).astype(np.int64)
    lowest = steps.min()
    counts = np.bincount(steps - lowest)
    pairs = counts + np.append(counts[1:], 0)  # a floor may lie on the border of two
    first = int(np.argmax(pairs >= _FLOOR * len(heights)))
    if pairs[first] < _FLOOR * len(heights):
        return None
    low = (lowest + first) * _LAYER
    return float(np.median(heights[(heights >= low) & (heights < low + 2.0 * _LAYER)]))


def _level_from_map(up: Array, lift: float) -> Array:
    """The least turn (4, 4) that brings `up` to z, and a lift in m."""
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    angle = np.arctan2(sine, float(up[2]))
    found = np.eye(4)
    found[:3, :3] = so3_exp(axis / sine * angle) if sine > 1e-12 else np.eye(3)
    found[2, 3] = lift
    return found
