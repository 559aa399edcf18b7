"""Places that other visits contradict: there a finished map fell apart.

Neither residuals nor weights show it: a path that went wrong contradicts nothing before a loop is
closed, and of particles that are all wrong one is the best. But where a path meets itself two
visits saw the same surfaces, and in a map that fell apart one saw through what the other took for a
wall. So it is where things were moved meanwhile: a place is misplaced where all other visits taken
together contradict it, or where it rather lies elsewhere among them. What they report of each
other's points is the evidence that recognition decides by.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import bdtrc

from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import between_planar
from mapmyworld.odometry.tracking_losses import named_moments
from mapmyworld.places.laser_nodes import LaserNodes
from mapmyworld.places.laser_submaps import submap_of
from mapmyworld.places.whole_map import WholeMap, map_of_scans
from mapmyworld.registration.place_evidence import Place
from mapmyworld.registration.submaps import MARGIN
from mapmyworld.types import Node

_LENGTH = 5.0  # m of path that make a place: no tracking drifts much in so little
_AWAY = 15.0  # m of path between two visits of a place
_NEAR = 8.0  # m between the middles of places that share surfaces
_AT_ONCE = 32  # places that are held in memory
_CHANCE = 0.01  # of evidence beyond `MARGIN` against a pose that is right; and of a false alarm


@dataclass(frozen=True, slots=True)
class Misplaced:
    """Places compared in a finished map."""

    compared: int
    """Those of which other visits know enough."""
    rows: tuple[int, ...]
    """Of these, nodes in the middle of misplaced ones."""

    @property
    def fell_apart(self) -> bool:
        """Whether more places are misplaced than by chance where all are right."""
        return bool(bdtrc(len(self.rows) - 1, self.compared, _CHANCE) < _CHANCE)

    def named(self, nodes: Sequence[Node]) -> str:
        """How many they are, and when the robot was there, given the nodes by row."""
        when = named_moments(
            [nodes[row].stamp_ns for row in self.rows], min(node.stamp_ns for node in nodes)
        )
        return (
            f"{len(self.rows)} of {self.compared} places do not go with what was seen there at "
            f"another time, after {when}"
        )


def misplaced_places(nodes: LaserNodes) -> Misplaced:
    """What visits of the same places report of each other, with the nodes at their solved poses.

    Nodes that see nothing are left out, and visits of components that nothing joins not compared.
    """
    seeing = np.flatnonzero(nodes.sees)
    if not len(seeing):
        return Misplaced(0, ())
    steps = np.hypot(*np.diff(nodes.poses[seeing, :2], axis=0).T)
    travelled = np.concatenate([[0.0], np.cumsum(steps)])
    begins = np.flatnonzero(np.diff(np.floor(travelled / _LENGTH))) + 1
    visits = np.split(seeing, begins)
    middles = np.array([visit[len(visit) // 2] for visit in visits])
    travelled = travelled[np.searchsorted(seeing, middles)]
    known, doubted = set[int](), set[int]()

    @functools.lru_cache(_AT_ONCE)
    def place(k: int) -> Place:
        return Place.of(submap_of(nodes, visits[k], middles[k]))

    for i in range(len(visits)):
        for j in _other_visits(nodes, middles, travelled, i, _NEAR):
            if j < i:
                continue
            i_from_j = between_planar(*nodes.poses[middles[[i, j]]])
            found = place(i).agreement_with(place(j), i_from_j)
            if found.hits + found.contradictions > MARGIN:
                known |= {i, j}
                doubted |= {i, j} if found.evidence < -MARGIN else set()
    rows = []
    for k in sorted(doubted):
        others = _other_visits(nodes, middles, travelled, k, 2.0 * _NEAR)
        seen = np.concatenate([visits[i] for i in others])
        if _is_misplaced(place(k), map_of_scans(submap_of(nodes, seen, middles[k]))):
            rows.append(int(middles[k]))
    return Misplaced(len(known), tuple(rows))


def _other_visits(
    nodes: LaserNodes, middles: Index, travelled: Array, k: int, radius: float
) -> list[int]:
    """Numbers of the visits nearer than `radius` m to visit `k`, at another time.

    `middles` (V,) are rows of nodes, `travelled` (V,) the metres of path up to them.
    """
    apart = np.hypot(*(nodes.poses[middles, :2] - nodes.poses[middles[k], :2]).T)
    is_known = nodes.session[middles] == nodes.session[middles[k]]
    later = np.abs(travelled - travelled[k]) > _AWAY
    return np.flatnonzero((apart < radius) & later & is_known).tolist()


def _is_misplaced(place: Place, others: WholeMap) -> bool:
    """Whether what others saw, in the frame of the place, contradicts it or has it elsewhere."""
    here = others.judge(place, np.zeros(3))
    if here.evidence < -MARGIN:
        return True
    return here.log_odds < 0.0 and others.is_elsewhere(place, np.zeros(3)) is True
