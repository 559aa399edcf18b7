"""Where the robot may have gone, given what its wheels recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.planar import wrap_angle


@dataclass(frozen=True, slots=True)
class MotionNoise:
    """How much odometry errs (alpha_1 to alpha_4 of the book, as standard deviations)."""

    turn_by_turn: float = 0.1  # rad per rad
    turn_by_distance: float = 0.1  # rad per m
    distance_by_distance: float = 0.1  # m per m
    distance_by_turn: float = 0.05  # m per rad


def sample_motion_model(
    u: NDArray[np.float64],
    x: NDArray[np.float64],
    noise: MotionNoise,
    random: np.random.Generator,
) -> NDArray[np.float64]:
    """x_t (P, 3) after a recorded motion u (3,) from x_{t-1} (P, 3).

    Thrun, Burgard, Fox 2005, table 5.6: a rotation, a translation and a second rotation, each with
    Gaussian noise whose variance grows with what was done.
    """
    rot_1, trans, rot_2 = rotations_and_translation(u)
    # Lines 5 to 7 of the table.
    variance_rot_1, variance_trans, variance_rot_2 = motion_variances(u, noise)
    first = rot_1 - random.normal(0.0, np.sqrt(variance_rot_1), len(x))
    distance = trans - random.normal(0.0, np.sqrt(variance_trans), len(x))
    second = rot_2 - random.normal(0.0, np.sqrt(variance_rot_2), len(x))
    # Lines 8 to 10.
    heading = x[:, 2] + first
    return np.stack(
        [
            x[:, 0] + distance * np.cos(heading),
            x[:, 1] + distance * np.sin(heading),
            wrap_angle(heading + second),
        ],
        axis=-1,
    )


def rotations_and_translation(u: NDArray[np.float64]) -> tuple[float, float, float]:
    """First turn, way and second turn of a motion u (3,) = x, y, yaw in the frame of its start.

    A motion backwards is a way backwards and not two half turns (an addition to the book), and
    one on the spot is all second turn.
    """
    trans = float(np.hypot(u[0], u[1]))
    if trans < 1e-9:
        return 0.0, 0.0, float(wrap_angle(u[2]))
    rot_1 = float(np.arctan2(u[1], u[0]))
    if abs(rot_1) > np.pi / 2.0:
        rot_1, trans = float(wrap_angle(rot_1 + np.pi)), -trans
    return rot_1, trans, float(wrap_angle(u[2] - rot_1))


def motion_variances(u: NDArray[np.float64], noise: MotionNoise) -> tuple[float, float, float]:
    """Variances of first turn, way and second turn of u (3,) (ibid., lines 5 to 7)."""
    rot_1, trans, rot_2 = rotations_and_translation(u)
    by_distance = (noise.turn_by_distance * trans) ** 2
    variance_trans = (noise.distance_by_distance * trans) ** 2
    variance_trans += noise.distance_by_turn**2 * (rot_1**2 + rot_2**2)
    return (
        (noise.turn_by_turn * rot_1) ** 2 + by_distance,
        variance_trans,
        (noise.turn_by_turn * rot_2) ** 2 + by_distance,
    )
