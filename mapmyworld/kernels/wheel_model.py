"""What a log shows of its own odometry: noise, and the systematic errors of wheels.

Of the errors of wheels (Borenstein and Feng, "UMBmark", 1995) three grow with the drive: a wrong
scale, and a heading that errs with the distance (unequal wheels) and with the rotation (a wrong
wheelbase). Scan matching shows them: what a match adds to the odometry since the last keyframe
is an innovation, and each is one sample. The model is an array (15,) that kernels read and write:

  0-1    noise of position [m^2 per m] and heading [rad^2 per rad]: see `random_variances`
  2-4    scale [m per m], heading by distance [rad per m], heading by rotation [rad per rad]
  5-7    variances of these three
  8-10   pose by odometry, from that of the last keyframe
  11-14  since that keyframe: path [m], rotation [rad], both without sign, then with it
"""

from __future__ import annotations

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.kernels.compiling import inner_jit, jit
from mapmyworld.kernels.laser_motion import wrapped

FIRST_NOISE = 0.01  # m^2 per m and rad^2 per rad, of wheels nobody calibrated
FIRST_SIGMAS = (0.03, 0.015, 0.03)  # m per m, rad per m, rad per rad, of the same
_FLOOR = 0.005  # m, and half as many rad, that any recorded motion may be off by
METRES_PER_RADIAN, RADIANS_PER_METRE = 0.04, 0.09  # as noise of position and of heading counts
MEMORY = 0.95  # weight of the past in running means of how the robot moves
_LARGEST = 0.25  # noise, in its units, that one innovation may teach
OUTLIER = 16.0  # NIS from which an innovation is a fault, and teaches nothing systematic
_SHOWS = 9.0  # squared sigmas of a straight way from which a matched rotation was one
MOVES = 0.01  # m and rad from which a robot moves, and not only its measurements


def new_wheels() -> Array:
    """A model (15,) of wheels about which nothing is known yet."""
    wheels = np.zeros(15)
    wheels[:2], wheels[5:8] = FIRST_NOISE, np.square(FIRST_SIGMAS)
    return wheels


@jit
def reckon(wheels: Array, step: Array) -> None:
    """One more recorded step (3,) in the model (15,), its systematic errors corrected."""
    forward, rotation = step[0], step[2]
    x, y = (1.0 + wheels[2]) * step[0], (1.0 + wheels[2]) * step[1]
    yaw = rotation + wheels[3] * forward + wheels[4] * rotation
    c, s = np.cos(wheels[10]), np.sin(wheels[10])
    wheels[8] += c * x - s * y
    wheels[9] += s * x + c * y
    wheels[10] = wrapped(wheels[10] + yaw)
    wheels[11] += np.hypot(x, y)
    wheels[12] += abs(yaw)
    wheels[13] += forward
    wheels[14] += rotation


def lengthen(wheels: Array, step: Array, way: Array) -> None:
    """A recorded step (3,) of the model (15,) was such a way (2,), m and rad, or its own length."""
    taken = np.array([np.hypot(step[0], step[1]), abs(step[2])])
    wheels[11:13] += np.maximum(way - taken, 0.0)


@jit
def anchor(wheels: Array, pose: Array) -> None:
    """Odometry of the model (15,) counts anew from a pose (3,)."""
    for i in range(3):
        wheels[8 + i] = pose[i]
    for i in range(11, 15):
        wheels[i] = 0.0


@jit
def reckoned_variances(wheels: Array) -> Array:
    """Variances (3,), m^2 and rad^2, of the odometry of a model (15,) since the last keyframe.

    Noise adds up step by step, and its variance with the path; what is systematic errs by the same
    in every step, and its sigma grows with the path.
    """
    variances = random_variances(wheels[:2], wheels[11], wheels[12])
    along, turned = wheels[13] * wheels[13], wheels[14] * wheels[14]
    variances[:2] += wheels[5] * along
    variances[2] += wheels[6] * along + wheels[7] * turned
    return variances


@jit
def random_variances(noise: Array, path: float, rotation: float) -> Array:
    """Variances (3,), m^2 and rad^2, of `noise` (2,) over a path, m, and rotation, rad.

    Position counts a radian as some metres, and heading a metre as some radians.
    """
    position = noise[0] * (path + METRES_PER_RADIAN * rotation) + _FLOOR * _FLOOR
    heading = noise[1] * (rotation + RADIANS_PER_METRE * path) + 0.25 * _FLOOR * _FLOOR
    return np.array([position, position, heading])


@jit
def learn(wheels: Array, found: Array, variances: Array, is_open: bool) -> None:
    """Lets a model (15,) learn from one innovation (7,) of a prediction of these variances (3,).

    All of it counts as the odometry's: what the match errs by makes its prior no more certain.
    Where the match `is_open` along walls, it shows no scale: what it has there is the noise of its
    normals. Straight on it shows no error by rotation: what was recorded there is noise, all of it
    an error, and so is what was matched.
    """
    if wheels[11] < MOVES and wheels[12] < MOVES:
        return
    once = random_variances(np.ones(2), wheels[11], wheels[12])
    weight = min(1.0, OUTLIER / max(found[6], 1e-9))  # a fault: as the largest that is none
    _learn_noise(wheels, 0, 0.5 * (found[0] * found[0] + found[1] * found[1]) / once[0] * weight)
    _learn_noise(wheels, 1, found[2] * found[2] / once[2] * weight)
    if found[6] < OUTLIER:
        if not is_open:
            _learn_systematic(wheels, 0, found, variances, 0, wheels[13])
        _learn_systematic(wheels, 1, found, variances, 2, wheels[13])
        rotation = wheels[14] + found[2]
        straight = random_variances(wheels[:2], wheels[11], 0.0)
        if rotation * rotation > _SHOWS * (straight[2] + found[5]):
            _learn_systematic(wheels, 2, found, variances, 2, rotation)


@inner_jit
def _learn_noise(wheels: Array, k: int, sample: float) -> None:
    wheels[k] = MEMORY * wheels[k] + (1.0 - MEMORY) * min(sample, _LARGEST)


@inner_jit
def _learn_systematic(
    wheels: Array, k: int, found: Array, variances: Array, axis: int, by: float
) -> None:
    """A scalar Kalman filter: the innovation of this axis grows `by` so much a unit of error."""
    variance = wheels[5 + k]
    gain = variance * by / (variances[axis] + found[3 + axis] + by * by * variance)
    wheels[2 + k] += gain * found[axis]
    wheels[5 + k] *= 1.0 - gain * by
