"""Which places may be the same, given where their nodes are thought to be."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mapmyworld.config import Config
from mapmyworld.geometry import Index
from mapmyworld.geometry.planar import between_planar, compose_planar, matrix_to_planar
from mapmyworld.parallel import batches
from mapmyworld.places.laser_nodes import LaserNodes, calm_spots
from mapmyworld.registration.submaps import MARGIN
from mapmyworld.types import Judged, ScanMatch, Why

Pairs = list[tuple[int, int]]
FIRST_WINDOW = 15.0
"""Metres to each side, at most, of a search from poses that have drifted."""
EVERYWHERE = np.inf
"""As far as the drift may reach: then places all over that are looked at, each by itself."""
MOST = 128
"""Of these places, so that time grows as the path does."""
SLACK = 1.0, 0.2
"""Metres and radians by which solved poses may be off in any case."""
NEAR = 3.0
"""Metres between two places that see the same."""
_TOGETHER = 64  # places whose drift from all earlier ones is held at once


def candidate_pairs(nodes: LaserNodes, config: Config, *, optimised: bool, first: int = 0) -> Pairs:
    """(earlier, later) indices of visits that may be of the same place, the later from `first`.

    Both of one session: nothing is known of how others lie.
    """
    places = config.places
    spacing = places.laser_spacing if optimised else places.laser_far_spacing
    spots = calm_spots(nodes, spacing)
    tree = cKDTree(nodes.poses[spots, :2])
    widest = NEAR + (0.0 if optimised else FIRST_WINDOW)
    later = spots[spots >= first]
    close = tree.query_ball_point(nodes.poses[later, :2], widest, return_sorted=True)
    heads = np.repeat(later, [len(some) for some in close])
    near = np.concatenate([np.zeros(0, np.int64), *(np.array(some, np.int64) for some in close)])
    tails = spots[near]
    earlier = nodes.path[heads] - nodes.path[tails] > 2.0 * places.laser_submap
    earlier &= nodes.session[tails] == nodes.session[heads]
    near, tails, heads = near[earlier], tails[earlier], heads[earlier]
    apart = np.hypot(*(nodes.poses[tails, :2] - nodes.poses[heads, :2]).T)
    drift = 0.0 if optimised else nodes.drift.reach(tails, heads)[:, 0]
    within = apart < NEAR + np.minimum(drift, FIRST_WINDOW)
    near, heads, apart = near[within], heads[within], apart[within]
    pairs, most = Pairs(), places.laser_revisits
    for head in np.unique(heads).tolist():
        mine = heads == head
        best = _nearest_of_revisits(near[mine], apart[mine], most)
        pairs += [(int(spots[k]), head) for k in best]
    return pairs


def lost_pairs(nodes: LaserNodes, config: Config) -> list[tuple[int, int]]:
    """(earlier, later) indices of places of a session that drift may have moved apart, however far.

    The nearest place of an earlier visit need not be the true one when poses are metres off:
    so every place within reach of the drift is compared, or of many some all over that reach.
    """
    size = config.places.laser_submap
    earlier, later = calm_spots(nodes, size), calm_spots(nodes, 2.0 * size)
    every = np.union1d(earlier, later)
    metres, radians = nodes.drift.reach(np.zeros_like(every), every).T
    pairs: list[tuple[int, int]] = []
    for some in batches(later.tolist(), _TOGETHER):
        tails, heads = (ends.ravel() for ends in np.meshgrid(earlier, some))
        apart = np.hypot(*(nodes.poses[tails, :2] - nodes.poses[heads, :2]).T)
        # Each may lie off from the first node, and the one's heading swings the other: no farther.
        a, b = np.searchsorted(every, tails), np.searchsorted(every, heads)
        most = metres[a] + metres[b] + radians[a] * apart
        asked = (most > NEAR) & (apart < size + most) & (tails < heads)
        asked &= nodes.session[tails] == nodes.session[heads]
        tails, heads, apart = tails[asked], heads[asked], apart[asked]
        drift = nodes.drift.reach(tails, heads)[:, 0]
        worth = (drift > NEAR) & (apart < size + drift)
        tails, heads = tails[worth], heads[worth]
        for head in np.unique(heads).tolist():
            near = tails[heads == head]
            pairs += [(int(k), head) for k in near[:: math.ceil(len(near) / MOST)]]
    return pairs


def pairs_about(nodes: LaserNodes, closures: Sequence[Judged], config: Config) -> Pairs:
    """(earlier, later) indices of visits of one place if one of some `closures` is right.

    Of those with too little evidence, but more than chance has: what a place shows depends on where
    it was seen from. So their neighbours are compared as well, up to half a submap along the path.
    """
    size, row = config.places.laser_submap, {int(i): k for k, i in enumerate(nodes.ids)}
    spots = calm_spots(nodes, config.places.laser_far_spacing)
    pairs: set[tuple[int, int]] = set()
    for closure in closures:
        verdict, a, b = closure.verdicts[-1], row[closure.from_id], row[closure.to_id]
        likely = verdict.why is Why.LITTLE_EVIDENCE
        if not likely or verdict.numbers["evidence"] < verdict.numbers["limit"] - MARGIN:
            continue
        way = np.abs(nodes.path[spots, None] - nodes.path[[a, b]])
        earlier, later = spots[way[:, 0] <= 2.0 * size], spots[way[:, 1] <= size]
        seen_from_b = between_planar(nodes.poses[b], nodes.poses[later])
        here = compose_planar(matrix_to_planar(closure.i_from_j), seen_from_b)
        there = between_planar(nodes.poses[a], nodes.poses[earlier])
        apart, nearest = cKDTree(there[:, :2]).query(here[:, :2])
        near = (apart < NEAR) & (earlier[nearest] < later)
        pairs |= set(zip(earlier[nearest[near]].tolist(), later[near].tolist(), strict=True))
    return sorted(pairs)


def _nearest_of_revisits(near: Index, apart: NDArray[np.float64], most: int) -> list[int]:
    """Of each visit, a run of neighbouring spots, the nearest one; of so many visits at most."""
    if len(near) == 0:
        return []
    runs = np.cumsum(np.diff(near, prepend=near[0]) > 2)
    order = np.lexsort((apart, runs))
    best = order[np.diff(runs[order], prepend=-1) != 0]
    chosen = np.argsort(apart[best], kind="stable")[:most]
    return sorted(near[best[chosen]].tolist())


def untied(nodes: LaserNodes, pairs: Pairs, closures: Sequence[Judged], config: Config) -> Pairs:
    """The pairs whose places no accepted closure by laser joins already, or nearly so."""
    row = {int(i): k for k, i in enumerate(nodes.ids)}
    tied = [c for c in closures if c.accepted and isinstance(c.source, ScanMatch)]
    if not tied or not pairs:
        return pairs
    ends = np.array([sorted((row[c.from_id], row[c.to_id])) for c in tied])
    tree = cKDTree(nodes.path[ends])
    apart, _ = tree.query(nodes.path[np.array(pairs)], p=np.inf)
    free = apart > config.places.laser_spacing
    return [pair for pair, is_free in zip(pairs, free.tolist(), strict=True) if is_free]
