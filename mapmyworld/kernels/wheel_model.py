"""What a log shows of its own odometry: noise, and the systematic errors of wheels and mount.

Of the errors of wheels (Borenstein and Feng, "UMBmark", 1995) three grow with the drive: a wrong
scale, and a heading that errs with the distance (unequal wheels) and with the rotation (a wrong
wheelbase). A laser that is not where the log says moves otherwise than the wheels: by a lever arm
where the robot turns, and askew where it drives (Censi, Franchi, Marchionni and Oriolo,
"Simultaneous calibration of odometry and sensor parameters for mobile robots", 2013). Scan matching
shows them: what a match adds to the odometry since the last keyframe is an innovation, and each is
one sample. The model is an array (56,) that kernels read and write, of these parts.
"""

from __future__ import annotations

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.kernels.compiling import inner_jit, jit
from mapmyworld.kernels.laser_motion import between_poses, wrapped

NOISE = slice(0, 2)
"""Of position [m^2 per m] and heading [rad^2 per rad]: see `random_variances`."""
SYSTEMATIC = slice(2, 8)
"""Scale [m per m]; laser turned [rad], ahead and aside [m] of where the log says; heading by
distance [rad per m] and by rotation [rad per rad]."""
MOUNT = slice(3, 6)
"""Those of the laser."""
POSE = slice(8, 11)
"""By odometry, from that of the last keyframe."""
KEYFRAME = slice(11, 14)
"""Pose of that keyframe."""
TRAVELLED = slice(14, 16)
"""Since that keyframe: path [m], rotation [rad], both without sign."""
CERTAINTY = slice(16, 52)
"""Covariance (6, 6) of the systematic errors."""
LAST = slice(52, 56)
"""The last innovation's position [m], the mean product of two that follow each other, as noise of
position (what a match errs by ends one and begins the next, and makes it negative), and the weight
that the first noise of position still has."""

FIRST_NOISE = 0.01  # m^2 per m and rad^2 per rad, of wheels nobody calibrated
FIRST_SIGMAS = (0.03, 0.01, 0.02, 0.02, 0.015, 0.03)  # of the systematic errors of the same
ERRORS = len(FIRST_SIGMAS)
_FLOOR = 0.005  # m, and half as many rad, that any recorded motion may be off by
METRES_PER_RADIAN, RADIANS_PER_METRE = 0.04, 0.09  # as noise of position and of heading counts
MEMORY = 0.95  # weight of the past in running means of how the robot moves
_LARGEST = 0.25  # noise, in its units, that one innovation may teach
OUTLIER = 16.0  # NIS from which an innovation is a fault, and teaches nothing systematic
_SHOWS = 9.0  # squared sigmas of a straight way from which a matched rotation was one
MOVES = 0.01  # m and rad from which a robot moves, and not only its measurements


def new_wheels() -> Array:
    """A model (56,) of wheels about which nothing is known yet."""
    wheels = np.zeros(LAST.stop)
    wheels[NOISE], wheels[CERTAINTY] = FIRST_NOISE, np.diag(np.square(FIRST_SIGMAS)).ravel()
    wheels[LAST][3] = 1.0
    return wheels


@jit
def error_jacobians(motions: Array, turned: Array) -> Array:
    """(E, 3, 6) by what each systematic error changes motions (E, 3) that turned so (E,) far."""
    found = np.zeros((len(motions), 3, ERRORS))
    for k in range(len(motions)):
        x, y, yaw, rows = motions[k, 0], motions[k, 1], turned[k], found[k]
        c, s = np.cos(yaw) - 1.0, np.sin(yaw)
        rows[0, 0], rows[0, 1], rows[0, 2], rows[0, 3] = x, y, c, -s
        rows[1, 0], rows[1, 1], rows[1, 2], rows[1, 3] = y, -x, s, c
        rows[2, 4], rows[2, 5] = x, yaw
    return found


@jit
def reckon(wheels: Array, step: Array) -> None:
    """One more recorded step (3,) in the model (56,), its systematic errors corrected."""
    errors, pose, travelled = wheels[SYSTEMATIC], wheels[POSE], wheels[TRAVELLED]
    yaw = step[2] + errors[4] * step[0] + errors[5] * step[2]
    rows = error_jacobians(step.reshape(1, 3), np.array([yaw]))[0]
    x, y = step[0], step[1]
    for k in range(4):
        x += rows[0, k] * errors[k]
        y += rows[1, k] * errors[k]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    pose[0] += c * x - s * y
    pose[1] += s * x + c * y
    pose[2] = wrapped(pose[2] + yaw)
    travelled[0] += np.hypot(step[0], step[1])
    travelled[1] += abs(step[2])


def lengthen(wheels: Array, step: Array, way: Array) -> None:
    """A recorded step (3,) of the model (56,) was such a way (2,), m and rad, or its own length."""
    taken = np.array([np.hypot(step[0], step[1]), abs(step[2])])
    wheels[TRAVELLED] += np.maximum(way - taken, 0.0)


@jit
def anchor(wheels: Array, pose: Array) -> None:
    """Odometry of the model (56,) counts anew from a pose (3,)."""
    here, keyframe, travelled = wheels[POSE], wheels[KEYFRAME], wheels[TRAVELLED]
    for i in range(3):
        here[i] = keyframe[i] = pose[i]
    travelled[0] = travelled[1] = 0.0


@jit
def reckoned_variances(wheels: Array) -> Array:
    """Variances (3,), m^2 and rad^2, of the odometry of a model (56,) since the last keyframe.

    Noise adds up step by step, and its variance with the path; what is systematic errs by the same
    in every step, and its sigma grows with the path.
    """
    variances = random_variances(wheels[NOISE], wheels[TRAVELLED])
    moved = between_poses(wheels[KEYFRAME], wheels[POSE])
    rows, known = _jacobian_of(moved, moved[2]), wheels[CERTAINTY].reshape(ERRORS, ERRORS)
    for axis in range(3):
        for i in range(ERRORS):
            for j in range(ERRORS):
                variances[axis] += rows[axis, i] * known[i, j] * rows[axis, j]
    return variances


@inner_jit
def _jacobian_of(moved: Array, turned: float) -> Array:
    """(3, 6) of a motion (3,), in the frame of an end that was `turned` so far (rad)."""
    rows: Array = error_jacobians(moved.reshape(1, 3), moved[2:])[0]
    c, s = np.cos(turned), np.sin(turned)
    for k in range(ERRORS):
        x, y = rows[0, k], rows[1, k]
        rows[0, k], rows[1, k] = c * x + s * y, c * y - s * x
    return rows


@jit
def random_variances(noise: Array, travelled: Array) -> Array:
    """Variances (3,), m^2 and rad^2, of `noise` (2,) over a way (2,): path, m, and rotation, rad.

    Position counts a radian as some metres, and heading a metre as some radians.
    """
    path, rotation = travelled[0], travelled[1]
    position = noise[0] * (path + METRES_PER_RADIAN * rotation) + _FLOOR * _FLOOR
    heading = noise[1] * (rotation + RADIANS_PER_METRE * path) + 0.25 * _FLOOR * _FLOOR
    return np.array([position, position, heading])


@jit
def learn(wheels: Array, found: Array, is_open: bool) -> None:
    """Lets a model (56,) learn from one innovation (7,).

    All of it counts as the odometry's: what the match errs by makes its prior no more certain.
    Where the match `is_open` along walls, positions show nothing: they are the odometry's own, and
    what the match has there is the noise of its normals. Straight on it shows no error by rotation:
    what was recorded there is noise, all of it an error, and so is what was matched.
    """
    if wheels[TRAVELLED].max() < MOVES:
        return
    once = random_variances(np.ones(2), wheels[TRAVELLED])
    weight = min(1.0, OUTLIER / max(found[6], 1e-9))  # a fault: as the largest that is none
    if found[6] < OUTLIER:
        _learn_systematic(wheels, found, is_open)
    last = wheels[LAST]
    if not is_open:
        squares = 0.5 * (found[0] * found[0] + found[1] * found[1])
        products = found[0] * last[0] + found[1] * last[1]
        _learn_mean(wheels, 0, squares / once[0] * weight)
        _learn_mean(last, 2, products / once[0] * weight)
        last[3] *= MEMORY
    last[0], last[1] = found[0], found[1]
    if is_open:
        last[0] = last[1] = 0.0
    _learn_mean(wheels, 1, found[2] * found[2] / once[2] * weight)


@inner_jit
def _learn_mean(means: Array, k: int, sample: float) -> None:
    means[k] = MEMORY * means[k] + (1.0 - MEMORY) * max(-_LARGEST, min(sample, _LARGEST))


@inner_jit
def _learn_systematic(wheels: Array, found: Array, is_open: bool) -> None:
    """A Kalman filter: the innovation's axes, one after the other.

    Linearised about the likeliest motion, with noise of as long a way, for its errors are in no
    innovation (Fuller, "Measurement error models", 1987, 1.4): the recorded one's would make the
    scale smaller, the matched one's larger.
    """
    noise, known = wheels[NOISE], wheels[CERTAINTY].reshape(ERRORS, ERRORS)
    recorded, way = between_poses(wheels[KEYFRAME], wheels[POSE]), wheels[TRAVELLED].copy()
    matched, c, s = recorded.copy(), np.cos(recorded[2]), np.sin(recorded[2])
    share = max(0.0, min(1.0 + wheels[LAST][2] / noise[0], 1.0))  # of an innovation, the wheels'
    matched[0] += share * (c * found[0] - s * found[1])
    matched[1] += share * (s * found[0] + c * found[1])
    matched[2] += found[2]
    rows = _jacobian_of(matched, recorded[2])
    way[0] += np.hypot(matched[0], matched[1]) - np.hypot(recorded[0], recorded[1])
    way[1] += abs(matched[2]) - abs(recorded[2])
    random = random_variances(noise, np.maximum(way, 0.0))
    straight = random_variances(noise, np.array([wheels[TRAVELLED][0], 0.0]))
    if matched[2] * matched[2] <= _SHOWS * (straight[2] + found[5]):
        rows[2, 5] = 0.0
    change = np.zeros(ERRORS)
    for axis in range(2 if is_open else 0, 3):
        missed, variance, pull = found[axis], random[axis] + found[3 + axis], np.zeros(ERRORS)
        for i in range(ERRORS):
            for j in range(ERRORS):
                pull[i] += known[i, j] * rows[axis, j]
        for i in range(ERRORS):
            missed -= rows[axis, i] * change[i]
            variance += rows[axis, i] * pull[i]
        for i in range(ERRORS):
            change[i] += pull[i] / variance * missed
            for j in range(ERRORS):
                known[i, j] -= pull[i] * pull[j] / variance
    errors = wheels[SYSTEMATIC]
    for i in range(ERRORS):
        errors[i] += change[i]
