"""Where a place lies, seen from another, before their scans are compared: by the graph."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapmyworld.backend.connected_components import components
from mapmyworld.backend.information import NotPositiveDefiniteError
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import between_planar, planar_to_matrix
from mapmyworld.graph.constraint_system import stated_system
from mapmyworld.graph.covariance import relative_covariances
from mapmyworld.places.doubted_odometry import in_doubt
from mapmyworld.places.laser_candidates import SLACK
from mapmyworld.places.laser_nodes import LaserNodes
from mapmyworld.places.path_drift import SIGMAS


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
    """Of every pair of nodes, as the constraints that their poses are solved by know it.

    Odometry in doubt counts as the nodes' `drift` has it. Where nothing connects them, the drift
    along the path. Solved poses may be off by a third of
    the slack in any case, in sigmas.
    """
    if not pairs:
        return []
    tails, heads = np.array(pairs, np.int64).T
    spreads = np.zeros((len(pairs), 3, 3))
    for k, (a, b) in enumerate(pairs):
        metres, radians = np.add(SLACK, nodes.drift.reach(a, b))
        spreads[k] = np.diag(np.square(np.array([metres, metres, min(radians, np.pi)]) / SIGMAS))
    known, own = _graph_covariances(nodes, tails, heads)
    spreads[known] = own + np.diag(np.square([SLACK[0], *SLACK])) / SIGMAS**2
    poses = between_planar(nodes.poses[tails], nodes.poses[heads])
    each = zip(pairs, poses, spreads, strict=True)
    return [DriftPrior(*pair, pose, spread) for pair, pose, spread in each]


def _graph_covariances(
    nodes: LaserNodes, tails: Index, heads: Index
) -> tuple[NDArray[np.bool_], Array]:
    """Which pairs (P,) of nodes the graph connects, and covariances (K, 3, 3) of these."""
    ids, count = set(nodes.ids.tolist()), len(nodes.ids)
    between = [c for c in nodes.stated if c.from_id in ids and c.to_id in ids]
    if nodes.drift.is_without_faults:
        between = [in_doubt(c, False) if c.is_doubted else c for c in between]
    stated = stated_system(nodes.ids, planar_to_matrix(nodes.poses), between, True)
    system, linked = stated.system, stated.system.tails < count
    part = components(count, system.tails[linked], system.heads[linked])
    known = np.asarray(part[tails] == part[heads])
    if known.any():
        try:
            found = relative_covariances(system, stated.start, tails[known], heads[known])
            return known, found
        except NotPositiveDefiniteError:
            pass
    return np.zeros(len(tails), np.bool_), np.zeros((0, 3, 3))
