"""Which scans are worth comparing, given where they are: neighbours in time and in space."""

from __future__ import annotations

import itertools
from collections import defaultdict

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mapmyworld.geometry.planar import wrap_angle
from mapmyworld.places.stored_scans import BLOCK

Index = NDArray[np.int64]
_IN_TIME = (1, 2, 4, 8)  # scans ahead that each scan is compared with
GAP = _IN_TIME[-1] + 1
"""Scans between two that are of different visits."""
_SAME_PLACE, _SAME_HEADING = 0.5, 0.5  # m and rad within which a place is visited again
_AROUND = tuple(itertools.product((-1, 0, 1), repeat=2))


def among_first_revisits(poses: NDArray[np.float64], revisits: int) -> NDArray[np.bool_]:
    """(N,) which of `poses` (N, 3) are among the first `revisits` of their place and heading.

    Their number grows with the area that was driven over, not with how often it was.
    """
    cells = np.floor(poses[:, :2] / _SAME_PLACE).astype(np.int64).tolist()
    taken: dict[tuple[int, int], list[int]] = defaultdict(list)
    first = np.zeros(len(poses), np.bool_)
    for k, (column, row) in enumerate(cells):
        around = np.array(sorted(i for c, r in _AROUND for i in taken[column + c, row + r]), int)
        around = around[around <= k - GAP]
        apart = np.hypot(*(poses[around, :2] - poses[k, :2]).T)
        turn = np.abs(wrap_angle(poses[around, 2] - poses[k, 2]))
        before = around[(apart < _SAME_PLACE) & (turn < _SAME_HEADING)]
        first[k] = np.count_nonzero(np.diff(before, prepend=-GAP - 1) > GAP) < revisits
        if first[k]:
            taken[column, row].append(k)
    return first


def neighbour_pairs(
    poses: NDArray[np.float64],
    radius: float,
    revisits: int,
    among: NDArray[np.bool_] | None = None,
) -> NDArray[np.int64]:
    """(P, 2) ascending pairs of scan indices: close in time, or of another pass nearby.

    Of each earlier or later pass within `radius` metres of `poses` (N, 3) the nearest scan is
    taken, `revisits` passes at most, so that the cost grows with the drive and not with its square.
    Other passes are looked for `among` (N,) these scans; all of them, if none are given.
    """
    count = len(poses)
    every = np.arange(count)
    found = [np.stack([every[:-ahead], every[ahead:]], axis=1) for ahead in _IN_TIME]
    asked = every if among is None else np.flatnonzero(among)
    tree = cKDTree(poses[asked, :2])
    for start in range(0, count, BLOCK):
        block = cKDTree(poses[start : start + BLOCK, :2])
        near = block.sparse_distance_matrix(tree, radius, output_type="ndarray")
        scans, others = near["i"] + start, asked[near["j"]]
        apart = np.abs(others - scans) >= GAP
        keys = np.sort(scans[apart] * count + others[apart])
        found.append(_nearest_of_revisits(poses, keys // count, keys % count, revisits))
    low, high = np.sort(np.concatenate(found), axis=1).T
    keys = np.unique(low * count + high)
    return np.stack([keys // count, keys % count], axis=1).astype(np.int64)


def _nearest_of_revisits(
    poses: NDArray[np.float64], scans: Index, others: Index, revisits: int
) -> Index:
    """The pairs (K, 2) kept of `scans` and `others`, which ascend scan by scan."""
    x, y, turn = (column[others] - column[scans] for column in np.ascontiguousarray(poses.T))
    cost = np.hypot(x, y) + np.abs(wrap_angle(turn))  # a radian as a metre
    anew = np.diff(scans, prepend=-1) != 0
    anew |= np.diff(others, prepend=0) > GAP
    best = _least_of_runs(cost, anew)
    best = best[np.lexsort((cost[best], scans[best]))]
    first = np.searchsorted(scans[best], scans[best], side="left")
    best = best[np.arange(len(best)) - first < revisits]
    return np.stack([scans[best], others[best]], axis=1)


def _least_of_runs(cost: NDArray[np.float64], anew: NDArray[np.bool_]) -> Index:
    """Where each run, begun anew where it says so, has its least cost; the first such place."""
    starts = np.flatnonzero(anew)
    if len(starts) == 0:
        return starts
    least = np.minimum.reduceat(cost, starts)
    places = np.flatnonzero(cost == np.repeat(least, np.diff(starts, append=len(cost))))
    run = np.searchsorted(starts, places, side="right")
    return np.asarray(places[np.diff(run, prepend=0) != 0])
