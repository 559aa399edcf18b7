"""Pose graphs from constraints, and their canonical form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import information_to_planar, matrix_to_planar
from mapmyworld.types import TRUSTED, Judged
from mapmyworld.types.pose_graph import Edges, PoseGraph, Priors, no_sightings


def graph_from_constraints(
    ids: Sequence[int] | Index,
    map_from_node: Array,
    constraints: Sequence[Judged],
    planar: bool,
) -> PoseGraph:
    """The graph of nodes `ids` (N,) at these poses (N, 4, 4), and of accepted constraints of them.

    A constraint with a landmark (negative id) is one with a node of that id; a prior (`to_id ==
    from_id`) becomes a prior. Constraints with unknown nodes are left out.
    """
    order = np.argsort(np.asarray(ids, np.int64), kind="stable")
    known = np.asarray(ids, np.int64)[order]
    poses = np.asarray(map_from_node, np.float64).reshape(-1, 4, 4)[order]
    used = [c for c in constraints if c.accepted]
    ends = np.array([(c.from_id, c.to_id) for c in used], np.int64).reshape(-1, 2)
    inside = np.asarray(np.isin(ends, known).all(axis=1))
    used, ends = [c for c, keep in zip(used, inside.tolist(), strict=True) if keep], ends[inside]
    measured = np.array([c.i_from_j for c in used], np.float64).reshape(-1, 4, 4)
    information = np.array([c.information for c in used], np.float64).reshape(-1, 6, 6)
    odometry = np.array([c.kind in TRUSTED for c in used], np.bool_)
    if planar:
        poses, measured = matrix_to_planar(poses), matrix_to_planar(measured)
        information = information_to_planar(information)
    prior = ends[:, 0] == ends[:, 1]
    every = Edges(ends[:, 0], ends[:, 1], measured, information, odometry)
    return PoseGraph(
        planar,
        known,
        poses,
        every.chosen(~prior),
        landmarks=np.zeros((0, 2 if planar else 3)),
        sightings=no_sightings(planar),
        priors=Priors(ends[prior, 0], measured[prior], information[prior]),
    )


def canonical_order(edges: Edges) -> Index:
    """Positions (E,) that sort edges by their nodes, then by what they measure.

    Sums over sorted edges do not depend on the order in which a file or a matcher gave them.
    """
    order = np.lexsort((edges.to_ids, edges.from_ids))
    tails, heads = edges.from_ids[order], edges.to_ids[order]
    if ((tails[1:] == tails[:-1]) & (heads[1:] == heads[:-1])).any():
        flat = edges.i_from_j.reshape(len(edges), -1).T
        order = np.lexsort((*flat, edges.to_ids, edges.from_ids))
    return order
