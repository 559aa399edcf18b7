"""Depth against laser: by which scale, or which shift and turn of a mount, they come to agree."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.diagnosis.finding import Finding
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import invert, transform_points
from mapmyworld.registration.camera_model import depth_at, pixels_of_points, rays_of_pixels
from mapmyworld.types import Frame, RgbdImage

DEPTH_SCALE = "depth scale"
_LEAST_POINTS = 200
_SCALE_OFF = 0.05  # share by which depth and laser may differ before it is worth a word
_APART = 0.1  # m by which laser and depth may be apart after their scale is taken out
_SHIFTED = 0.05  # m by which a mount may be wrong before it is worth a word
_TURNED = 2.0  # deg
_OTHER_UNIT = 1.5  # factor of the scale beyond which mounts are no matter yet
_GAP = 0.2  # m between neighbouring laser points of one wall
_ROUNDS = 10  # of correcting and looking up the depth again
_NOISE = 0.03  # m of difference from which a point weighs less
_SIMPLER = 1.35  # by which a model may leave more apart and be preferred to a richer one
_WEAK = 0.01  # share of the strongest direction's information below which one is left alone
_ARM = 2.0  # m, by which turns and scales are counted as distances
_SCALE, _MOUNT, _BOTH = (0,), (1, 2, 3), (0, 1, 2, 3)


@dataclass(frozen=True, slots=True)
class Agreement:
    """The change of depth's scale and of the laser's mount that makes both agree."""

    scale: float
    shift: Array
    """(2,) m, ahead and to the left."""
    turn: float
    """rad, to the left."""
    apart: float
    """m between laser and depth along the walls' normals then, median."""


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """One image and the scan beside it, on the base."""

    image: RgbdImage
    depth: NDArray[np.float32]
    points: Array
    """Of the laser (N, 2)."""
    normals: Array
    """Of the walls at them (N, 2)."""
    height: float


def mount_findings(
    chosen: Sequence[tuple[Frame, RgbdImage]], base_from_lidar: Array, *, aligned: bool
) -> Iterator[Finding]:
    """The scale of depth against the laser, and what then remains between them.

    `base_from_lidar` is (4, 4). `aligned`: depth lies on its colour image. Where it does not, no
    mount is to blame yet.
    """
    seen = [_seen(frame, image, base_from_lidar) for frame, image in chosen if frame.scan]
    pairs = list[Array]()  # distances along the camera's axis: by the laser, and by depth
    for one in seen:
        local, looked_up = _looked_up(one, one.points)
        known = np.isfinite(looked_up)
        pairs.append(np.column_stack([local[known, 2], looked_up[known]]))
    both = np.concatenate([np.zeros((0, 2)), *pairs])
    if len(both) < _LEAST_POINTS:
        return
    scale = float(np.median(both[:, 1] / both[:, 0]))
    apart = float(np.median(np.abs(both[:, 1] / scale - both[:, 0])))
    found = None
    if 1.0 / _OTHER_UNIT < scale < _OTHER_UNIT:
        found = simplest_agreement(seen, base_from_lidar[:2, 3])
        scale = found.scale
    count = f"{len(both)} points of {len(pairs)} images"
    good = abs(scale - 1.0) < _SCALE_OFF
    text = f"depth is {scale:.3f} of the laser's ({count})"
    yield Finding(DEPTH_SCALE, scale, "", good, text, unit_suggestion(scale))
    yield _mounts(found if aligned else None, apart, count)


def _mounts(found: Agreement | None, apart: float, count: str) -> Finding:
    text = f"depth and laser are {apart:.3f} m apart (median, {count})"
    suggestion = "check the mounts of laser and camera: sensing.scan_mount, camera_mount"
    good = apart < _APART
    if found is not None and (
        np.hypot(*found.shift) > _SHIFTED or abs(found.turn) > np.radians(_TURNED)
    ):
        good = False
        moved = f"({found.shift[0]:+.2f}, {found.shift[1]:+.2f}) m ahead and left"
        text += (
            f"; {found.apart:.3f} m with the laser moved by {moved} and turned by "
            f"{np.degrees(found.turn):+.1f} deg, or the camera the other way"
        )
    return Finding("scan against depth", apart, "m", good, text, suggestion)


def unit_suggestion(scale: float) -> str:
    """What to do about depth that is so many times what it should be."""
    for factor, unit, near in (
        (1000.0, "millimetres recorded as metres", 1.25),
        (0.001, "metres as millimetres", 1.25),
        (5.0, "1/5000 m, as TUM's folders have it, recorded as millimetres", 1.06),
    ):
        if 1.0 / near < scale / factor < near:
            return f"depth is in another unit ({unit}): record 16UC1 in mm or 32FC1 in m"
    return f"correct the driver's depth scale by a factor of {1.0 / scale:.3f}"


def _seen(frame: Frame, image: RgbdImage, base_from_lidar: Array) -> _Seen:
    assert frame.scan is not None
    assert image.depth is not None
    points = np.asarray(frame.scan.points, np.float64)
    ahead = np.roll(points, -1, axis=0) - points
    behind = points - np.roll(points, 1, axis=0)
    along = ahead + behind
    length = np.linalg.norm(along, axis=1, keepdims=True)
    gaps = np.maximum(np.linalg.norm(ahead, axis=1), np.linalg.norm(behind, axis=1))
    normals = np.column_stack([-along[:, 1], along[:, 0]]) / np.maximum(length, 1e-9)
    normals[gaps > _GAP] = np.nan
    depth = np.asarray(image.depth.pixels(), np.float32)
    return _Seen(image, depth, points, normals, float(base_from_lidar[2, 3]))


def _looked_up(seen: _Seen, points: Array) -> tuple[Array, Array]:
    """Points (N, 3) in the camera's frame, and the depths (N,) where they are seen."""
    solid = np.column_stack([points, np.full(len(points), seen.height)])
    local = np.asarray(transform_points(invert(seen.image.camera.base_from_camera), solid))
    found = depth_at(seen.image, seen.depth, pixels_of_points(seen.image.camera, local))
    found[local[:, 2] <= 0.3] = np.nan
    return local, found


def simplest_agreement(seen: Sequence[_Seen], lidar: Array) -> Agreement:
    """Nothing, a scale, a mount, or both: the simplest that leaves about as little apart.

    `lidar` (2,) is where it stands on the base.
    """
    tried = [_agreement(seen, lidar, free) for free in ((), _SCALE, _MOUNT, _BOTH)]
    least = max(min(one.apart for one in tried), 0.3 * _NOISE)
    return next(one for one in tried if one.apart <= _SIMPLER * least)


def _agreement(seen: Sequence[_Seen], lidar: Array, free: tuple[int, ...]) -> Agreement:
    """The change, of those parameters of scale, x, y and turn that are free.

    By least squares that far points hardly draw, with the weights of Geman and McClure (1987), and
    without the directions of which little is known.
    """
    total = np.array([1.0, 0.0, 0.0, 0.0])
    for _ in range(_ROUNDS if free else 0):
        rows, apart = _equations(seen, lidar, total)
        if len(apart) < _LEAST_POINTS:
            break
        width = max(_NOISE, 1.5 * float(np.median(np.abs(apart))))
        roots = 1.0 / (1.0 + (apart / width) ** 2)  # of the weights
        weighed, step = rows[:, list(free)] * roots[:, None], np.zeros(4)
        step[list(free)] = np.linalg.lstsq(weighed, apart * roots, rcond=np.sqrt(_WEAK))[0]
        step[[0, 3]] /= _ARM
        total[0] *= 1.0 + step[0]
        total[1:] += step[1:]
    _, apart = _equations(seen, lidar, total)
    left = float(np.median(np.abs(apart))) if len(apart) else np.inf
    return Agreement(float(total[0]), total[1:3], float(total[3]), left)


def _equations(seen: Sequence[_Seen], lidar: Array, change: Array) -> tuple[Array, Array]:
    """How depth and laser part along the walls' normals (N,), by each parameter (N, 4)."""
    turn = np.array(
        [[np.cos(change[3]), -np.sin(change[3])], [np.sin(change[3]), np.cos(change[3])]]
    )
    rows, apart = list[Array](), list[Array]()
    for one in seen:
        arms = (one.points - lidar) @ turn.T
        points, normals = arms + lidar + change[1:3], one.normals @ turn.T
        local, found = _looked_up(one, points)
        known = np.isfinite(found) & np.isfinite(normals[:, 0])
        rays = rays_of_pixels(one.image.camera, pixels_of_points(one.image.camera, local[known]))
        deep = np.column_stack([rays, np.ones(len(rays))]) * (found[known] / change[0])[:, None]
        surface = np.asarray(transform_points(one.image.camera.base_from_camera, deep))[:, :2]
        eye = one.image.camera.base_from_camera[:2, 3]
        n, arm = normals[known], arms[known]
        rows.append(
            np.column_stack(
                [
                    ((points[known] - eye) * n).sum(axis=1) / _ARM,
                    n,
                    (n[:, 1] * arm[:, 0] - n[:, 0] * arm[:, 1]) / _ARM,
                ]
            )
        )
        apart.append(((surface - points[known]) * n).sum(axis=1))
    return np.concatenate([np.zeros((0, 4)), *rows]), np.concatenate([np.zeros(0), *apart])
