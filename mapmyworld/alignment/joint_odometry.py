"""Odometry in the joint alignment: calibrated by the path, with the noise that it shows of it.

Between two scans goes what the wheels recorded, not what was tracked: tracking compared the same
points as pairs of scans do. Its calibration stays while scans are aligned. Learnt again from
poses that it holds itself, it would yield to whatever all pairs have in common, round by round.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mapmyworld.alignment.joint_system import Edges
from mapmyworld.backend.block_matrix import diagonals
from mapmyworld.geometry import Array, Index
from mapmyworld.kernels.laser_motion import is_degenerate
from mapmyworld.odometry.motion_calibration import CalibratedMotions
from mapmyworld.types import Node


def calibrated_odometry(
    nodes: Sequence[Node], chosen: Index, tracked: Edges, matched: NDArray[np.bool_]
) -> tuple[Edges, Array]:
    """Edges (E,) of the odometry between `chosen` nodes (S,), in place of the `tracked` motions
    (E,), and the information (E, 3, 3) by which covariances count them.

    It is calibrated, and its noise learnt, by what it misses these motions. Along walls they are
    its own, and show too little. There it may err by more than its noise: no less than the motions
    that it was part of. As a weight that would be too little, for pairs err alike along walls.
    Tracked motions stay where there is no odometry, or it is at fault, or the robot stood; and if
    not `matched` (E,): they are odometry then, and tracking knows of stalls.
    """
    tails, heads, found, information = tracked
    is_open = np.array([is_degenerate(one) for one in information], np.bool_)
    ends = chosen[tails], chosen[heads]
    motions = CalibratedMotions(nodes, ends, found, matched, is_open)
    use, noise = motions.trusted[:, None], motions.variances()
    least = np.maximum(noise, np.linalg.inv(information).diagonal(0, 1, 2))

    def known(variances: Array) -> Array:
        return np.where(use[:, None], diagonals(1.0 / variances), information)

    measured = np.where(use, motions.measured(), found)
    return (tails, heads, measured, known(noise)), known(least)
