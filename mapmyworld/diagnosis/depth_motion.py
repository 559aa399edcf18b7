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
from mapmyworld.registration.features import extract_features
from mapmyworld.registration.image_pairs import register_images
from mapmyworld.registration.views import View, make_view
from mapmyworld.sensing.sound_images import ImageGuard
from mapmyworld.types import Frame, RgbdImage

_PAIRS = 16  # of images that are compared, spread over the drive
_LEAST_PAIRS = 5
_NEAREST, _FARTHEST = 0.15, 0.8  # m between the images of a pair
_TURN = 0.2  # rad between them, at most
_MIDDLE = 2.0  # m, what the middle depth of an image is taken for: features have depth in no unit
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
    suggestion = f"{unit_suggestion(scale)}, unless the odometry's distances are wrong"
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
    """The way (3,) from a's camera to b's in a's frame, in the unit of their depth.

    None where the images do not fit, or points lie too far off to have moved in the image.
    """
    assert a.depth is not None
    depth = np.asarray(a.depth.pixels(), np.float32)
    seen = depth[np.isfinite(depth) & (depth > 0.0)]
    if not len(seen):
        return None
    unit = float(np.median(seen)) / _MIDDLE
    pair = register_images(_view(a, unit, config), _view(b, unit, config), config)
    way = pair.registration.a_from_b[:3, 3]
    parallax = float(np.linalg.norm(way) * b.camera.intrinsics[0, 0]) / _MIDDLE
    return np.asarray(way * unit) if pair.fits and parallax > _PARALLAX else None


def _view(image: RgbdImage, unit: float, config: Config) -> View:
    """Features on the camera itself, of depth divided by a unit."""
    camera = replace(image.camera, base_from_camera=np.eye(4))
    alone = replace(in_scale(image, unit), camera=camera)
    return make_view(extract_features(alone, config, _FEATURES), camera, config)


def in_scale(image: RgbdImage, scale: float) -> RgbdImage:
    """The image with its depth in metres, where it is `scale` times that."""
    if image.depth is None:
        return image
    metres = np.asarray(image.depth.pixels(), np.float32) / np.float32(scale)
    return replace(image, depth=replace(image.depth, pixels=lambda: metres))
