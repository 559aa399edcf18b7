"""Two images aligned: matches, the motion between them, and how far it can be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.rigid import invert, se3_adjoint, transform_points
from mapmyworld.registration.camera_pose import (
    LEAST_SHARE,
    Sightings,
    errors,
    inliers,
    ransac_pose,
    refine_pose,
)
from mapmyworld.registration.views import (
    SEARCH_RADIUS,
    View,
    match_around,
    match_views,
    pixel_sigmas,
)
from mapmyworld.types import Judge, Registration, Verdict, Why

_LARGEST_TRANSLATION = 0.065  # m, no closure is less certain: three sigma are 0.2 m
_LARGEST_ROTATION = 0.006  # rad, no closure is less certain: three sigma are a degree
_UNKNOWNS = 6.0  # of a pose
_CORRELATED = 2.0  # features of one image err alike: each is worth half of what it seems
# What no residual shows: shutter, colour and depth at different moments, calibration (rad, m).
_FLOOR = np.array([0.002, 0.002, 0.002, 0.003, 0.003, 0.003])


@dataclass(frozen=True, slots=True, eq=False)
class ImagePair:
    """A registration of b's image in a's, with what was compared to get it."""

    registration: Registration
    """a_from_b of the bases; information rotation first."""
    features_a: Index
    """(M,) matched features of a."""
    features_b: Index
    """(M,) their partners in b."""
    agreed: NDArray[np.bool_]
    """(M,) whether a match agrees with the motion."""
    fits: bool
    """Whether enough matches agree, however uncertain the motion that they agree on."""
    sigma_rotation: float
    """rad, the largest axis."""
    sigma_translation: float
    """m, the largest axis."""


def register_images(a: View, b: View, config: Config, *, guess: Array | None = None) -> ImagePair:
    """The motion between two images by PnP: points of a, from depth, as b sees them.

    With a `guess` (4, 4) of a_from_b (of the bases) matches are sought around its projection only,
    else over the whole image. The verdict names the limit that was missed.
    """
    settings = config.visual
    points = transform_points(a.camera.base_from_camera, a.camera_points())
    if guess is None:
        mine, theirs = match_views(a, b)
    else:
        mine, theirs = match_by_pose(a, b, points, guess, SEARCH_RADIUS)
    deep = np.isfinite(points[mine, 2])
    mine, theirs = mine[deep], theirs[deep]
    sightings = Sightings(points[mine], b.seen[theirs], b.sigmas[theirs])
    enough = settings.closure_inliers // 2
    pose, found = ransac_pose(sightings, settings.inlier_sigmas, enough)
    if found < enough:
        return _failed(mine, theirs, _few(found, len(mine), config))
    first = found / len(mine)
    base = pose @ invert(b.camera.base_from_camera)
    more = match_by_pose(a, b, points, base, settings.inlier_sigmas * pixel_sigmas(a.features))
    if len(more[0]) >= found:
        mine, theirs = more
        sightings = Sightings(points[mine], b.seen[theirs], b.sigmas[theirs])
    pose, information = refine_pose(pose, sightings)
    agreed = inliers(pose, sightings, settings.inlier_sigmas)
    if np.count_nonzero(agreed) >= enough:
        pose, information = refine_pose(pose, sightings.chosen(agreed))
        agreed = inliers(pose, sightings, settings.inlier_sigmas)
    return _judged(b, (mine, theirs, agreed), pose, information, sightings, first, config)


def match_by_pose(
    a: View, b: View, points: Array, a_from_b: Array, radius: float | Array
) -> tuple[Index, Index]:
    """Features of a with depth, and partners in b near where the motion expects them, (M,) both.

    `points` (N, 3) of a's features are in a's base frame, `a_from_b` (4, 4) is of the bases and
    `radius` in pixels, one for all or (N,).
    """
    deep = np.flatnonzero(np.isfinite(points[:, 2]))
    local = transform_points(invert(a_from_b @ b.camera.base_from_camera), points[deep])
    radii = np.broadcast_to(radius, len(points))[deep]
    matches = match_around(b, local, a.words[deep], radii)
    found = np.flatnonzero(matches >= 0)
    return deep[found], matches[found].astype(np.int64)


def _judged(
    b: View,
    matched: tuple[Index, Index, NDArray[np.bool_]],
    pose: Array,
    information: Array,
    sightings: Sightings,
    share: float,
    config: Config,
) -> ImagePair:
    settings = config.visual
    mine, theirs, agreed = matched
    count = int(np.count_nonzero(agreed))
    squared = errors(pose, sightings)[agreed, 0]
    left = float(squared.sum()) + _UNKNOWNS  # what the pose took out of them
    scale = left / (2.0 * count) if count else np.inf  # the variance factor
    camera_from_base = invert(b.camera.base_from_camera)
    adjoint = se3_adjoint(camera_from_base)  # a base's tangent, seen in the camera
    information = adjoint.T @ information @ adjoint / (scale * _CORRELATED)
    covariance = np.linalg.inv(information + 1e-9 * np.eye(6)) + np.diag(_FLOOR**2)
    information = np.linalg.inv(covariance)
    sigmas = [
        float(np.sqrt(np.linalg.eigvalsh(covariance[k : k + 3, k : k + 3])[-1])) for k in (0, 3)
    ]
    agreement = {"inliers": count, "sigmas": settings.inlier_sigmas}
    shortfall = _shortfall(count, len(mine), share, config)
    fits = Verdict(Judge.CAMERA, True, Why.IMAGES_AGREE, agreement)
    focal = float(b.camera.intrinsics[0, 0])
    residual = (
        float(np.sqrt(np.mean(squared * (sightings.sigmas[agreed, 0] * focal) ** 2)))
        if count
        else np.inf
    )
    registration = Registration(
        pose @ camera_from_base,
        information,
        shortfall or _uncertainty(sigmas) or fits,
        count,
        share,
        residual,
    )
    return ImagePair(registration, mine, theirs, agreed, shortfall is None, *sigmas)


def _shortfall(count: int, matches: int, share: float, config: Config) -> Verdict | None:
    """None when enough matches agree, else the first limit that is missed, with its value."""
    settings = config.visual
    if count < settings.closure_inliers:
        return _few(count, matches, config)
    if share < LEAST_SHARE:
        numbers = {"share": share, "limit": LEAST_SHARE}
        return Verdict(Judge.CAMERA, False, Why.LOW_SHARE, numbers)
    return None


def _few(inliers: int, matches: int, config: Config) -> Verdict:
    numbers = {"inliers": inliers, "matches": matches, "limit": config.visual.closure_inliers}
    return Verdict(Judge.CAMERA, False, Why.FEW_INLIERS, numbers)


def _uncertainty(sigmas: list[float]) -> Verdict | None:
    """None when the motion is certain enough, else the limit that is missed, with its value."""
    if sigmas[1] > _LARGEST_TRANSLATION:
        numbers = {"sigma": sigmas[1], "limit": _LARGEST_TRANSLATION}
        return Verdict(Judge.CAMERA, False, Why.UNCERTAIN_TRANSLATION, numbers)
    if sigmas[0] > _LARGEST_ROTATION:
        numbers = {"sigma": sigmas[0], "limit": _LARGEST_ROTATION}
        return Verdict(Judge.CAMERA, False, Why.UNCERTAIN_ROTATION, numbers)
    return None


def _failed(mine: Index, theirs: Index, verdict: Verdict) -> ImagePair:
    nothing = Registration(np.eye(4), 1e-6 * np.eye(6), verdict)  # indicates nothing
    return ImagePair(nothing, mine, theirs, np.zeros(len(mine), np.bool_), False, np.inf, np.inf)
