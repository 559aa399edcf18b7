"""How a robot goes on, as a log without odometry shows it: from scan to scan about as before.

White acceleration: steps change by so much, and each is as certain as its match and the one before
make it. The model is an array (6,) that kernels read and write:

  0-2    variances of the last step, in x, y, yaw of the robot
  3-5    variances of what steps change by
"""

from __future__ import annotations

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.kernels.compiling import inner_jit, jit
from mapmyworld.kernels.laser_motion import FAINT, motion_variances
from mapmyworld.kernels.planar_algebra import invert3
from mapmyworld.kernels.wheel_model import MOVES

_MEMORY = 0.98  # weight of the past in the running mean of changes


@jit
def any_step(step: Array) -> Array:
    """Variances (3,) where a robot may not go on by this `step` (3,): 5 cm, and all its length."""
    return motion_variances(step, 1.0, 0.05)


def new_steps() -> Array:
    """A model (6,) of a robot that nothing is known of yet."""
    return np.tile(any_step(np.zeros(3)), 2)


@jit
def next_variances(steps: Array) -> Array:
    """Variances (3,) of the next step by the model (6,)."""
    return steps[:3] + steps[3:]


@jit
def learn_change(steps: Array, moved: Array, last: Array) -> None:
    """Lets the model (6,) learn how much a step (3,) differs from the `last` (3,), if one moves."""
    if max(np.abs(moved).max(), np.abs(last).max()) > MOVES:
        for i in range(3):
            change = moved[i] - last[i]
            steps[3 + i] = _MEMORY * steps[3 + i] + (1.0 - _MEMORY) * change * change


@inner_jit
def learn_step(
    steps: Array, moved: Array, last: Array, information: Array, variances: Array, weak: bool
) -> None:
    """Lets the model (6,) learn from a step (3,) by a match's `information` (3, 3).

    How certain it is, with the prediction's `variances` (3,), and how much it differs from the
    `last` (3,), but where a direction is left open: there it rests on the prediction.
    """
    known = information.copy()
    for i in range(3):
        known[i, i] += 1.0 / variances[i] + FAINT
    own = invert3(known)
    for i in range(3):
        steps[i] = own[i, i]
    if not weak:
        learn_change(steps, moved, last)
