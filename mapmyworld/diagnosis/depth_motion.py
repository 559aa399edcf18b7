"""Depth against the odometry's distances: how far the camera moved, in the unit of its depth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from mapmyworld.config import Config
from mapmyworld.diagnosis.depth_on_laser import DEPTH_SCALE, unit_suggestion
from mapmyworld.diagnosis.finding import Finding
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between, invert
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.parallel import in_threads
from mapmyworld.registration.camera_model import depth_at, pose_of_rays
from mapmyworld.registration.camera_pose import Sightings, inliers, refine_pose
from mapmyworld.registration.features import extract_features
from mapmyworld.registration.views import View, make_view, match_views
from mapmyworld.sensing.sound_images import ImageGuard
from mapmyworld.types import Frame, RgbdImage

_PAIRS = 16  # of images that are compared, spread over the drive
_LEAST_PAIRS = 5
_NEAREST, _FARTHEST = 0.15, 0.8  # m between the images of a pair
_TURN = 0.2  # rad between them, at most
_LEAST_MATCHES = 30
_PIXELS = 2.0  # by which a match may miss when a pose is looked for
_SIGMAS = 3.0  # by which it may miss of the refined one
_ROUNDS = 300
_REFINED = 3
_PARALLAX = 8.0  # pixels by which a point at the middle depth must have moved
_FEATURES = 400  # of an image
_SCALE_OFF = 0.15  # share that is worth a word: wheels and images are rougher than a laser
_UNCERTAIN = 0.05  # share, standard deviation of the scale, beyond which nothing is said


def depth_motion_findings(
    pairs: Sequence[tuple[Frame, Frame]], config: Config
) -> Iterator[Finding]:
    """The scale of depth by which images see the robot move as far as its odometry indicates.

    Depth in a smaller unit makes the motion that explains two images longer by as much.
    """
    found = in_threads(lambda pair: _ratio(*pair, config), pairs, 0)
    ratios = np.array([ratio for ratio in found if ratio is not None])
    if len(ratios) < _LEAST_PAIRS:
        return
    scale = float(np.median(ratios))
    spread = float(np.median(np.abs(ratios - scale)))  # of a normal law 0.674 sigma, and the
    if 1.86 * spread / np.sqrt(len(ratios)) > _UNCERTAIN * scale:  # median's is 1.253 of the mean's
        return
    good = abs(scale - 1.0) < _SCALE_OFF
    text = (
        f"depth measures {scale:.3f} of the distance that odometry reports "
        f"({len(ratios)} pairs of images)"
    )
    suggestion = (
        "" if good else f"{unit_suggestion(scale)}, unless the odometry's distances are wrong"
    )
    yield Finding(DEPTH_SCALE, scale, "", good, text, suggestion)


def pairs_along_the_path(odom_from_base: Sequence[Array | None]) -> list[tuple[int, int]]:
    """Poses (4, 4) between which the robot drove a little and hardly turned, over all the drive."""
    known = [(i, pose) for i, pose in enumerate(odom_from_base) if pose is not None]
    found, k = list[tuple[int, int]](), 0
    for i, (first, before) in enumerate(known):
        k = max(k, i + 1)
        while k < len(known) and _distance(before, known[k][1]) < _NEAREST:
            k += 1
        if k < len(known) and _is_fit(before, known[k][1]):
            found.append((first, known[k][0]))
    chosen = np.unique(np.linspace(0, len(found) - 1, min(_PAIRS, len(found))).astype(int))
    return [found[i] for i in chosen]


def _distance(before: Array, now: Array) -> float:
    return float(np.linalg.norm(between(before, now)[:3, 3]))


def _is_fit(before: Array, now: Array) -> bool:
    return (
        _distance(before, now) < _FARTHEST and float(rotation_angle(between(before, now))) < _TURN
    )


def _ratio(before: Frame, now: Frame, config: Config) -> float | None:
    """Of the way that images see, by depth, to that of the odometry; None where nothing fits."""
    assert before.odom_from_base is not None
    assert now.odom_from_base is not None
    guard = ImageGuard()
    a, b = (guard.sound(guard.guarded(frame.images[0])) for frame in (before, now))
    if a is None or b is None or a.depth is None or a.colour is None or b.colour is None:
        return None
    motion = _camera_motion(a, b, config)
    if motion is None:
        return None
    moved = between(before.odom_from_base, now.odom_from_base)
    expected = (invert(a.camera.base_from_camera) @ moved @ b.camera.base_from_camera)[:3, 3]
    return float(motion @ expected / (expected @ expected))


def _camera_motion(a: RgbdImage, b: RgbdImage, config: Config) -> Array | None:
    """The way (3,) from a's camera to b's in a's frame, in the unit of a's depth.

    None where too few matches fit, or points lie too far off to have moved in the image.
    """
    sightings, unit = _sightings(a, b, config)
    if len(sightings) < _LEAST_MATCHES:
        return None
    focal = float(b.camera.intrinsics[0, 0])
    pose = _refined(sightings, _PIXELS / focal)
    if pose is None or float(np.linalg.norm(pose[:3, 3])) * focal < _PARALLAX:
        return None
    return np.asarray(pose[:3, 3] * unit)


def _sightings(a: RgbdImage, b: RgbdImage, config: Config) -> tuple[Sightings, float]:
    """What b saw of a's points by rays alone, and the middle depth, as unit of the points.

    The depth of b has the same unit as that of a, and would indicate nothing about it.
    """
    assert a.depth is not None
    mine, theirs = (_view(image, config) for image in (a, b))
    first, second = match_views(mine, theirs)
    pixels = mine.features.pixels[first]
    depth = depth_at(a, np.asarray(a.depth.pixels(), np.float32), pixels)
    known = np.isfinite(depth)
    unit = float(np.median(depth[known])) if known.any() else 1.0
    rays = np.column_stack([mine.seen[first[known], :2], np.ones(int(known.sum()))])
    points = rays * (depth[known] / unit)[:, None]
    chosen = second[known]
    return Sightings(points, theirs.seen[chosen], theirs.sigmas[chosen]), unit


def _view(image: RgbdImage, config: Config) -> View:
    """Features without depth."""
    flat = replace(image, depth=None)
    return make_view(extract_features(flat, config, _FEATURES), image.camera, config)


def _refined(sightings: Sightings, limit: float) -> Array | None:
    """a_from_b (4, 4) of most sightings; None where too few agree."""
    pose = pose_of_rays(sightings.points, sightings.seen[:, :2], limit, _ROUNDS)
    for _ in range(_REFINED):
        if pose is None:
            return None
        agreed = inliers(pose, sightings, _SIGMAS)
        if np.count_nonzero(agreed) < _LEAST_MATCHES:
            return None
        pose, _ = refine_pose(pose, sightings.select(agreed))
    return pose
