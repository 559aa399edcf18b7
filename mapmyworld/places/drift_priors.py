"""Where a place lies, seen from another, before their scans are compared: by the graph."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar
from mapmyworld.places.laser_candidates import SLACK
from mapmyworld.places.laser_nodes import LaserNodes
from mapmyworld.places.node_drift import SIGMAS


class DriftPrior(NamedTuple):
    """Where the later node of a pair lies, seen from the earlier one: a normal distribution."""

    earlier: int
    later: int
    pose: Array
    """(3,) earlier_from_later."""
    covariance: Array
    """(3, 3) of a perturbation in that pose's own frame."""

    def log(self, pose: Array) -> float:
        """Log density, in nats, of a `pose` (3,), less that where it is largest."""
        drift = between_planar(self.pose, pose)
        return -0.5 * float(drift @ np.linalg.solve(self.covariance, drift))

    def window(self, widest: float) -> tuple[float, float]:
        """Metres, `widest` at most, and radians to each side in which a pose is looked for."""
        metres = SIGMAS * float(np.sqrt(np.linalg.eigvalsh(self.covariance[:2, :2])[-1]))
        radians = SIGMAS * float(np.sqrt(self.covariance[2, 2]))
        return min(metres, widest), min(radians, np.pi)


def drift_priors(nodes: LaserNodes, pairs: Sequence[tuple[int, int]]) -> list[DriftPrior]:
    """Of every pair of nodes, as the constraints that hold the nodes know it.

    Solved poses may be off by a third of the slack in any case, in sigmas.
    """
    tails, heads = np.array(pairs, np.int64).reshape(-1, 2).T
    spreads = nodes.drift.covariances(tails, heads)
    spreads += np.diag(np.square([SLACK[0], *SLACK])) / SIGMAS**2
    poses = between_planar(nodes.poses[tails], nodes.poses[heads])
    each = zip(pairs, poses, spreads, strict=True)
    return [DriftPrior(*pair, pose, spread) for pair, pose, spread in each]
