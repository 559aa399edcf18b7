"""Constraints between nodes as a least-squares system."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.backend.connected_components import held_nodes, positions
from mapmyworld.backend.system import System, number_free
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import information_to_planar, matrix_to_planar
from mapmyworld.types import TRUSTED, Judged


@dataclass(frozen=True, slots=True, eq=False)
class StatedSystem:
    """What constraints state of nodes; the map's own frame is one more node, the last."""

    system: System
    start: Array
    """(N + 1, 3 or 4, 4) poses, that of the map's frame last."""
    trusted: NDArray[np.bool_]
    """(E,) edges that nobody questions."""
    anchors: Index
    """(A,) the map's frame, and the first node of every component that no prior ties to it."""


def stated_system(
    known: Index, guess: Array, constraints: Sequence[Judged], planar: bool
) -> StatedSystem:
    """The system of usable constraints between nodes `known` (N,), ids, at `guess` (N, 4, 4).

    The guess is map_from_node. A prior is an edge from the map's frame to its node.
    """
    world = len(known)
    start = np.concatenate([guess, np.eye(4)[None]])
    measured = np.array([c.i_from_j for c in constraints]).reshape(-1, 4, 4)
    information = np.array([c.information for c in constraints]).reshape(-1, 6, 6)
    if planar:
        start, measured = matrix_to_planar(start), matrix_to_planar(measured)
        information = information_to_planar(information)
    by_id = np.argsort(known, kind="stable")
    ends = np.array([(c.from_id, c.to_id) for c in constraints], np.int64).reshape(-1, 2)
    places = by_id[positions(known[by_id], ends.ravel())].reshape(-1, 2)
    tails = np.where(ends[:, 0] == ends[:, 1], world, places[:, 0])
    # Motion, and what a person stated or judged.
    trusted = np.array([c.kind in TRUSTED or c.is_by_hand for c in constraints], np.bool_)
    heads = np.ascontiguousarray(places[:, 1])  # or a kernel is compiled twice
    stays = held_nodes(world + 1, tails, heads, np.array([world]))
    system = System(planar, tails, heads, measured, information, number_free(stays))
    return StatedSystem(system, start, trusted, np.flatnonzero(stays))
