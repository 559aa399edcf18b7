"""How far nodes may have drifted apart: the graph's own covariance between them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mapmyworld.backend.connected_components import components
from mapmyworld.backend.information import NotPositiveDefiniteError
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.graph.constraint_system import stated_system
from mapmyworld.graph.covariance import RelativeCovariances
from mapmyworld.odometry.unobserved_motion import ANYWHERE
from mapmyworld.places.doubted_odometry import in_doubt
from mapmyworld.types import Judged

SIGMAS = 3.0  # of what is stated: as far as drift is searched


@dataclass(frozen=True, eq=False)
class NodeDrift:
    """What constraints leave open of how nodes lie to each other, by all ways between them."""

    ids: Index
    """(N,) of the nodes, ascending."""
    poses: Array
    """(N, 3) map_from_base, at which the constraints are linearised."""
    stated: tuple[Judged, ...] = ()
    """The accepted constraints."""
    faults: bool = False
    """Whether odometry in doubt may be a fault; else it counts as it was measured."""

    def covariances(self, tails: Index, heads: Index) -> Array:
        """(P, 3, 3) of where nodes `heads` (P,) lie, seen from nodes `tails` (P,).

        Each of a perturbation in the head's own frame. What no constraint connects may lie
        anywhere.
        """
        found = np.where((tails == heads)[:, None, None], 0.0, np.diag(ANYWHERE))
        known, part = self._graph
        linked = (part[tails] == part[heads]) & (tails != heads)
        if known is not None and linked.any():
            found[linked] = known.between(tails[linked], heads[linked])
        return found

    def reach(self, tails: Index, heads: Index) -> Array:
        """(P, 2) m and rad by which nodes `heads` (P,) may lie off, seen from `tails` (P,)."""
        found = self.covariances(tails, heads)
        metres = np.linalg.eigvalsh(found[:, :2, :2])[:, -1]
        return SIGMAS * np.sqrt(np.stack([metres, found[:, 2, 2]], axis=1))

    def within(self, sections: Iterable[tuple[int, Index]]) -> Array:
        """(3, 3) covariance by which nodes lie off from what sections of the path about them show,
        all added: of each section its middle and its nodes (K,).

        Any part of a section may be the one that shows it.
        """
        found = [self.covariances(np.full(len(nodes), k), nodes) for k, nodes in sections]
        x, y, yaw = np.sum([each.mean(axis=0).diagonal() for each in found], axis=0)
        return np.diag([0.5 * (x + y), 0.5 * (x + y), yaw])

    @cached_property
    def _graph(self) -> tuple[RelativeCovariances | None, Index]:
        """What is known where anything is, and the component (N,) that each node belongs to."""
        ids, count = set(self.ids.tolist()), len(self.ids)
        between = [c for c in self.stated if c.from_id in ids and c.to_id in ids]
        if not self.faults:
            between = [in_doubt(c, False) if c.is_doubted else c for c in between]
        stated = stated_system(self.ids, planar_to_matrix(self.poses), between, True)
        system, linked = stated.system, stated.system.tails < count
        part = components(count, system.tails[linked], system.heads[linked])
        try:
            return RelativeCovariances.of(system, stated.start), part
        except NotPositiveDefiniteError:
            return None, part
