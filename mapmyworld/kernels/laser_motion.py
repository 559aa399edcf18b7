"""Small formulas of laser odometry, on plain arrays, for the tracker and its kernel alike."""

from __future__ import annotations

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.kernels.compiling import inner_jit, jit
from mapmyworld.kernels.planar_algebra import invert3, relative

FAINT = 1e-3  # information that keeps an open direction finite
_RATIO = 12.0  # sigma along the weakest direction over sigma along the strongest
_LEAST_SHARE = 0.01  # of a match's covariance that every step adds
STEP_VARIANCE = 1e-8  # m^2 and rad^2, at least, of any step
_FREEDOM = 4.0  # degrees of freedom of Student's t, which errors with outliers follow
_NORMAL = (1.663, 2.596)  # mean squared normal errors of two and three unknowns, by its weights


@inner_jit
def wrapped(angle: float) -> float:
    """The same angle in (-pi, pi]."""
    return float(np.pi - (np.pi - angle) % (2.0 * np.pi))


@inner_jit
def between_poses(a: Array, b: Array) -> Array:
    """`a_from_b` (3,) of two poses (3,) of the plane, its yaw wrapped."""
    result: Array = relative(a, b)
    result[2] = wrapped(result[2])
    return result


@jit
def robust_ratio(squared: float, unknowns: int) -> float:
    """What one error of a pose shows of its variance, over that: 1 in the mean of normal errors.

    The error is `squared`, in sigmas, of two or three `unknowns`. It counts as the likelihood of
    Student's t has it (Lange, Little and Taylor, "Robust statistical modeling using the t
    distribution", JASA 1989), so that an outlier shows no more than a few good ones.
    """
    return float((_FREEDOM + unknowns) / (_FREEDOM + squared) * squared / _NORMAL[unknowns - 2])


@jit
def motion_variances(step: Array, share: float, floor: float) -> Array:
    """Variances (3,), m^2 and rad^2, of a `step` (3,), x, y, yaw: a share of it, and a floor."""
    distance, angle = np.hypot(step[0], step[1]), abs(step[2])
    along = share * distance + 0.2 * share * angle
    turn = share * angle + 0.3 * share * distance
    position = floor * floor + along * along
    return np.array([position, position, 0.25 * floor * floor + turn * turn])


@jit
def innovation(predicted: Array, pose: Array, information: Array, variances: Array) -> Array:
    """(7,): the match less the prediction, the match's own variances, and their NIS.

    The match is at `pose`, the prediction is `predicted`, (3,) both. The prior's pull on the match
    is undone, as far as the match knows anything. `information` (3, 3) is the match's own,
    `variances` (3,) are the prediction's; the NIS (normalised innovation squared) has three
    degrees of freedom.
    """
    error = between_poses(predicted, pose)
    known = information.copy()
    for i in range(3):
        known[i, i] += FAINT / variances[i]
    own = invert3(known)
    total = own.copy()
    x, y, yaw = error[0] / variances[0], error[1] / variances[1], error[2] / variances[2]
    result = np.zeros(7)
    for i in range(3):
        error[i] += own[i, 0] * x + own[i, 1] * y + own[i, 2] * yaw
        total[i, i] += variances[i]
        result[i], result[3 + i] = error[i], own[i, i]
    weights = invert3(total)
    for i in range(3):
        for j in range(3):
            result[6] += error[i] * weights[i, j] * error[j]
    return result


@jit
def is_degenerate(information: Array) -> bool:
    """Whether a match (3, 3) knows one direction of the plane far worse than the other."""
    known = information.copy()
    for i in range(3):
        known[i, i] += FAINT
    covariance = invert3(known)
    xx, xy, yy = covariance[0, 0], covariance[0, 1], covariance[1, 1]
    half, root = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)  # variances are half -+ root
    return bool(half + root > _RATIO * _RATIO * max(half - root, 1e-12))


@jit
def step_covariance(
    step: Array, information: Array, variances: Array, grown: Array, keyframe_distance: float,
    keyframe_angle: float,
) -> Array:  # fmt: skip
    """Covariance (3, 3) of a matched `step` (3,): errors add up from keyframe to keyframe only.

    By the match's `information` (3, 3) and the prediction's `variances` (3,), of which this step
    has added those `grown` (3,): a direction that the match leaves open rests on the prediction,
    whose errors add up step by step.
    """
    moved = max(np.hypot(step[0], step[1]) / keyframe_distance, abs(step[2]) / keyframe_angle)
    share = min(max(moved, _LEAST_SHARE), 1.0)
    total = information.copy()
    for i in range(3):
        total[i, i] += 1.0 / variances[i] + FAINT
    covariance: Array = invert3(total)
    half = 0.5 * np.arctan2(2.0 * covariance[0, 1], covariance[0, 0] - covariance[1, 1])
    along, missing = np.array([np.cos(half), np.sin(half), 0.0]), 0.0  # where least is known
    if is_degenerate(information):
        for i in range(2):
            missing += along[i] * along[i] * grown[i]
            for j in range(2):
                missing -= share * along[i] * covariance[i, j] * along[j]
        missing = max(missing, 0.0)
    for i in range(3):
        for j in range(3):
            covariance[i, j] = share * covariance[i, j] + along[i] * along[j] * missing
        covariance[i, i] += STEP_VARIANCE
    return covariance
