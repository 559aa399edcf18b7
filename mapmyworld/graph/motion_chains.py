"""Chains of nodes that only motion ties to others: left out of the graph, they follow afterwards.

The motions along such a chain are composed to one, which loses nothing but the linearisation
(Lu and Milios 1997).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.rigid import between, invert, se3_adjoint
from mapmyworld.graph.frame_poses import pose_every_frame
from mapmyworld.graph.graph_verdicts import faults_of
from mapmyworld.parallel import batches
from mapmyworld.types import Constraint, ConstraintKind, Judged, Node, Poses, TrackedFrames

_BLOCK = 256  # chains that are composed together: what that takes does not grow with the log


def are_motions(constraints: Sequence[Judged], known: set[int]) -> list[bool]:
    """Which constraints are motions between known nodes that can be used."""
    motions = [c.accepted and c.kind == ConstraintKind.NEIGHBOUR for c in constraints]
    faults = iter(faults_of([c for c, own in zip(constraints, motions, strict=True) if own], known))
    return [own and not next(faults) for own in motions]


def kept_nodes(
    nodes: Sequence[Node], motions: Sequence[Constraint], closures: Sequence[Constraint]
) -> NDArray[np.bool_]:
    """(N,) the first node of each session, ends of closures, of losses and of motions that nothing
    measured, up to the first scan that fits again, and where no one motion goes on.
    """
    ids = np.array([node.id for node in nodes], np.int64)
    tied = [i for c in closures for i in (c.from_id, c.to_id)]
    blind = {c.to_id for c in motions if c.is_unobserved and not c.is_tracking_loss}
    alone = [c.interrupts_tracking or bool({c.from_id, c.to_id} & blind) for c in motions]
    tied += [i for c, own in zip(motions, alone, strict=True) if own for i in (c.from_id, c.to_id)]
    arrivals = np.array([c.to_id for c in motions], np.int64)
    departures = np.array([c.from_id for c in motions], np.int64)
    through = np.ones(len(ids), np.bool_)
    for ends in (arrivals, departures):
        once, counts = np.unique(ends, return_counts=True)
        through &= np.isin(ids, once[counts == 1])
    sessions = np.array([node.session for node in nodes])
    opens = np.diff(sessions, prepend=sessions[0] - 1) != 0
    backwards = np.concatenate([arrivals, departures])[np.tile(arrivals <= departures, 2)]
    return np.asarray(opens | ~through | np.isin(ids, tied) | np.isin(ids, backwards))


def composed_motions(motions: Sequence[Judged], kept: set[int]) -> list[Judged]:
    """One motion from each kept node to the next, with the uncertainty of all those between."""
    onward = {c.from_id: c for c in motions}
    starts = (c for c in motions if c.from_id in kept)
    return [
        composed
        for some in batches(starts, _BLOCK)
        for composed in _composed([_chain(start, onward, kept) for start in some])
    ]


def _chain(start: Judged, onward: Mapping[int, Judged], kept: set[int]) -> list[Judged]:
    """The motions from a kept node to the next one."""
    links = [start]
    while links[-1].to_id not in kept:
        links.append(onward[links[-1].to_id])
    return links


def _composed(chains: Sequence[Sequence[Judged]]) -> list[Judged]:
    order = [link for chain in chains for link in chain]
    firsts = np.cumsum([0, *(len(chain) for chain in chains)])[:-1].tolist()
    first = np.array(firsts)
    last = np.append(first[1:], len(order)) - 1
    reached = _reached(order, first)
    chain = np.repeat(np.arange(len(first)), last - first + 1)
    carried = se3_adjoint(between(reached[last][chain], reached))
    spread = np.linalg.inv(np.stack([c.information for c in order]))
    summed = np.add.reduceat(carried @ spread @ np.swapaxes(carried, 1, 2), first, axis=0)
    information = np.linalg.inv(summed)
    return [
        replace(order[a], to_id=order[b].to_id, i_from_j=reached[b], information=known)
        for a, b, known in zip(firsts, last.tolist(), information, strict=True)
    ]


def _reached(order: Sequence[Constraint], first: Index) -> Array:
    """(K, 4, 4) where each motion ends, seen from where its chain begins."""
    begins = set(first.tolist())
    reached = np.empty((len(order), 4, 4))
    for k, link in enumerate(order):
        reached[k] = link.i_from_j if k in begins else reached[k - 1] @ link.i_from_j
    return reached


def followed(nodes: Sequence[Node], kept: NDArray[np.bool_], solved: Poses) -> Poses:
    """All nodes: those left out share what solving moved those `kept` (N,) before and after."""
    ids = np.array([node.id for node in nodes], np.int64)
    before = np.flatnonzero(kept)[np.cumsum(kept) - 1]
    tracked = np.stack([node.tracked_from_base for node in nodes])
    moments = TrackedFrames(
        np.array([node.stamp_ns for node in nodes], np.int64),
        ids[before],
        invert(tracked[before]) @ tracked,
        kept,
    )
    held = [nodes[k] for k in np.flatnonzero(kept).tolist()]
    poses = pose_every_frame(held, solved, moments)
    others = solved.ids < 0
    return Poses(
        np.concatenate([ids, solved.ids[others]]),
        np.concatenate([poses, solved.map_from_node[others]]),
    )
