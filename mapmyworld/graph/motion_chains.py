"""Chains of nodes that only motion ties to others: left out of the graph, they follow afterwards.

The motions along such a chain are composed to one, which loses nothing but the linearisation
(Lu and Milios 1997). What its ends are off them is shared out by their covariances.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.rigid import between, invert, se3_adjoint, se3_exp, se3_log, transported
from mapmyworld.graph.graph_verdicts import faults_of
from mapmyworld.parallel import batches
from mapmyworld.types import Constraint, ConstraintKind, Judged, Node, Poses

_BLOCK = 256  # chains that are composed together: what that takes does not grow with the log


def are_motions(constraints: Sequence[Judged], known: set[int]) -> list[bool]:
    """Which constraints are motions between known nodes that can be used."""
    motions = [c.accepted and c.kind == ConstraintKind.NEIGHBOUR for c in constraints]
    faults = iter(faults_of([c for c, own in zip(constraints, motions, strict=True) if own], known))
    return [own and not next(faults) for own in motions]


def kept_nodes(
    nodes: Sequence[Node], motions: Sequence[Constraint], closures: Sequence[Constraint]
) -> NDArray[np.bool_]:
    """(N,) the first node of each session, ends of closures and where tracking was interrupted, and
    where no one motion goes on.
    """
    ids = np.array([node.id for node in nodes], np.int64)
    tied = [i for c in closures for i in (c.from_id, c.to_id)]
    tied += [i for c in motions if c.interrupts_tracking for i in (c.from_id, c.to_id)]
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
    return [composed for chains in _chains(motions, kept) for composed in chains.composed()]


def shared_out(
    motions: Sequence[Judged], kept: NDArray[np.bool_], ids: Index, solved: Poses
) -> Poses:
    """The poses of all nodes `ids` (N,), and of landmarks, where those `kept` (N,) were solved.

    What solving moved the end of a chain by is shared out along its motions by their covariances.
    """
    rows, count = np.flatnonzero(kept), int(kept.sum())
    poses, spread = np.empty((len(ids), 4, 4)), np.empty((len(ids), 6, 6))
    poses[rows] = solved.map_from_node[:count]
    if solved.covariances is not None:
        spread[rows] = solved.covariances[:count]
    for chains in _chains(motions, set(ids[kept].tolist())):
        starts, ends, here = (ids.searchsorted(some) for some in chains.ids)
        inner = np.flatnonzero(~kept[here])
        poses[here[inner]] = chains.between_ends(poses[starts], poses[ends])[inner]
        if solved.covariances is not None:
            spread[here[inner]] = chains.covariances(spread[starts], spread[ends])[inner]
    landmarks = slice(count, None)
    every = np.concatenate([ids, solved.ids[landmarks]])
    poses = np.concatenate([poses, solved.map_from_node[landmarks]])
    if solved.covariances is None:
        return Poses(every, poses)
    return Poses(every, poses, np.concatenate([spread, solved.covariances[landmarks]]))


@dataclass(frozen=True, slots=True, eq=False)
class _Chains:
    """Motions of some chains, one chain after the other."""

    order: list[Judged]
    first: Index
    """(K,) row of each chain's first motion."""
    last: Index
    """(K,) row of each chain's last motion."""
    reached: Array
    """(M, 4, 4) where each motion ends, seen from where its chain begins."""
    spread: Array
    """(M, 6, 6) covariance of all motions of the chain up to each one, at the chain's end."""

    @staticmethod
    def of(chains: Sequence[Sequence[Judged]]) -> _Chains:
        order = [link for chain in chains for link in chain]
        ends = np.cumsum([len(chain) for chain in chains])
        first, last = np.append(0, ends[:-1]), ends - 1
        rows = [np.flatnonzero(last - first >= step) for step in range(1, max(map(len, chains)))]
        onward = [first[chain] + step for step, chain in enumerate(rows, 1)]
        reached = np.stack([link.i_from_j for link in order])
        for here in onward:
            reached[here] = reached[here - 1] @ reached[here]
        own = np.linalg.inv(np.stack([link.information for link in order]))
        spread = transported(
            se3_adjoint(between(reached[np.repeat(last, ends - first)], reached)), own
        )
        for here in onward:
            spread[here] += spread[here - 1]
        return _Chains(order, first, last, reached, spread)

    @property
    def ids(self) -> tuple[list[int], list[int], list[int]]:
        """Nodes at which chains begin (K,), and end (K,), and at which motions end (M,)."""
        arrivals = [link.to_id for link in self.order]
        starts = [self.order[k].from_id for k in self.first.tolist()]
        return starts, [arrivals[k] for k in self.last.tolist()], arrivals

    @property
    def chain(self) -> Index:
        """(M,) the chain of each motion."""
        return np.repeat(np.arange(len(self.first)), self.last - self.first + 1)

    @property
    def share(self) -> Array:
        """(M, 6, 6) of a chain's error, that of the motions up to each: its expectation, given the
        sum of normally distributed errors.
        """
        return np.asarray(self.spread @ np.linalg.inv(self.spread[self.last])[self.chain])

    def composed(self) -> list[Judged]:
        """One motion for each chain."""
        known = np.linalg.inv(self.spread[self.last])
        ends = zip(self.first.tolist(), self.last.tolist(), known, strict=True)
        return [
            replace(
                self.order[a], to_id=self.order[b].to_id, i_from_j=self.reached[b], information=one
            )
            for a, b, one in ends
        ]

    def between_ends(self, starts: Array, ends: Array) -> Array:
        """Poses (M, 4, 4) where motions end, by those (K, 4, 4) of both ends of each chain."""
        chain, whole = self.chain, self.reached[self.last]
        off = se3_log(between(whole, between(starts, ends)))
        moved = se3_exp(np.einsum("mij,mj->mi", self.share, off[chain]))
        return np.asarray((starts @ whole)[chain] @ moved @ between(whole[chain], self.reached))

    def covariances(self, starts: Array, ends: Array) -> Array:
        """Those (M, 6, 6) of the poses between, by those (K, 6, 6) of both ends.

        A Brownian bridge; how the ends err together is not known, and errs on the safe side.
        """
        chain, whole, share = self.chain, self.reached[self.last], self.share
        rest = np.eye(6) - share
        both = rest @ transported(se3_adjoint(invert(whole)), starts)[chain] + share @ ends[chain]
        own = self.spread - share @ self.spread
        at_end = 0.5 * (both + np.swapaxes(both, 1, 2)) + own
        return transported(se3_adjoint(between(self.reached, whole[chain])), at_end)


def _chains(motions: Sequence[Judged], kept: set[int]) -> Iterator[_Chains]:
    """The chains that begin at each kept node, some of them together."""
    onward = {c.from_id: c for c in motions}
    starts = (c for c in motions if c.from_id in kept)
    for some in batches(starts, _BLOCK):
        yield _Chains.of([_chain(start, onward, kept) for start in some])


def _chain(start: Judged, onward: Mapping[int, Judged], kept: set[int]) -> list[Judged]:
    """The motions from a kept node to the next one."""
    links = [start]
    while links[-1].to_id not in kept:
        links.append(onward[links[-1].to_id])
    return links
