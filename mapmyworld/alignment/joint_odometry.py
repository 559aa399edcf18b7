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
from mapmyworld.backend.system import System, with_edges
from mapmyworld.geometry import Index
from mapmyworld.kernels.laser_motion import is_degenerate
from mapmyworld.odometry.motion_calibration import CalibratedMotions
from mapmyworld.types import Node


def with_odometry(
    system: System, nodes: Sequence[Node], chosen: Index, tracked: Edges, matched: NDArray[np.bool_]
) -> System:
    """The system with the odometry between `chosen` nodes (S,), its first ones, behind its edges.

    It is calibrated, and its noise learnt, by what it misses the `tracked` motions (E,). Along
    walls these are its own, and show no scale: there headings alone calibrate it. They count where
    there is no odometry, or it is at fault, or the robot stood; and if not `matched` (E,): they are
    odometry then, and tracking knows of stalls.
    """
    tails, heads, found, information = tracked
    is_open = np.array([is_degenerate(one) for one in information], np.bool_)
    ends = chosen[tails], chosen[heads]
    motions = CalibratedMotions(nodes, ends, found, matched, is_open)
    rows, others = np.flatnonzero(motions.trusted), np.flatnonzero(~motions.trusted)
    known, measured = diagonals(1.0 / motions.variances()[rows]), motions.measured()[rows]
    system = with_edges(system, tails[rows], heads[rows], measured, known)
    given = found[others], information[others]
    return with_edges(system, tails[others], heads[others], *given)
