"""Which scans are worth comparing, given where they are: neighbours in time and in space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mapmyworld.alignment.joint_covariance import are_known_within
from mapmyworld.backend.system import System
from mapmyworld.config import OdometryConfig
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import wrap_angle
from mapmyworld.places.stored_scans import BLOCK
from mapmyworld.registration.scan_matching import FINE

_IN_TIME = (1, 2, 4, 8, 12)  # scans ahead that each scan is compared with
AHEAD = max(_IN_TIME)  # to the farthest of one visit
_GAP = 9  # scans between two that are of different visits
_SAME_PLACE, _SAME_HEADING = 0.5, 0.5  # m and rad within which a place is visited again


def among_first_revisits(places: Array, headings: Array, revisits: int) -> NDArray[np.bool_]:
    """(N,) which scans are among the first `revisits` of their place (N, D) and heading (N,).

    Their number grows with the area that was driven over, not with how often it was.
    """
    tree, first = cKDTree(places), np.zeros(len(places), np.bool_)
    for k, (place, heading) in enumerate(zip(places, headings, strict=True)):
        near = tree.query_ball_point(place, _SAME_PLACE, return_sorted=True)
        before = np.array([i for i in near if i <= k - _GAP and first[i]], np.int64)
        before = before[np.abs(wrap_angle(headings[before] - heading)) < _SAME_HEADING]
        first[k] = np.count_nonzero(np.diff(before, prepend=-_GAP - 1) > _GAP) < revisits
    return first


def field_of_view(bearings: NDArray[np.float32]) -> float:
    """Radians about a lidar in which it sees, given the bearings (P,) of its points.

    In whole sectors of 10 degrees, with the one at which the largest blind one begins.
    """
    seen = np.unique((np.degrees(bearings) // 10.0).astype(np.int64) % 36)
    blind = np.diff(seen, append=seen[:1] + 36).max(initial=1)
    return float(np.radians(10.0 * (37 - blind)))


class ComparedScans:
    """Which scans are compared: those of one visit, and of two where edges show how these lie."""

    def __init__(
        self, session: Index, held: NDArray[np.bool_], system: System, start: Array,
        field: float, settings: OdometryConfig,
    ) -> None:  # fmt: skip
        """Of scans that are in a `session` (S,) each, and of which those `held` (S,) stay.

        They are the first nodes of the `system`, whose nodes are at `start` (N, 3); the lidar sees
        a `field` (rad).
        """
        self._turn = 0.5 * field
        self._session, self._held, self._settings = session, held, settings
        self._system, self._start = system, start
        steps = np.diff(start[: len(held), :2], axis=0)
        self._path = np.append(0.0, np.cumsum(np.hypot(steps[:, 0], steps[:, 1])))
        self._known: dict[tuple[int, int], bool] = {}

    def pairs_at(self, poses: Array) -> Index:
        """(P, 2) of the scans, which are at the first of `poses` (N, 3)."""
        radius, held = self._settings.refine_radius, self._held
        pairs = neighbour_pairs(
            poses[: len(held)], radius, self._settings.refine_revisits, self._turn,
            among=held if held.any() else None,
        )  # fmt: skip
        together = self._session[pairs[:, 0]] == self._session[pairs[:, 1]]
        pairs = pairs[~held[pairs].all(axis=1) & together]
        # Whoever left the circle about a scan and came back drove across it.
        again = self._path[pairs[:, 1]] - self._path[pairs[:, 0]] >= 2.0 * radius
        again[again] = ~self._are_known(pairs[again])
        return np.asarray(pairs[~again])

    def _are_known(self, pairs: Index) -> NDArray[np.bool_]:
        asked = [(a, b) for a, b in pairs.tolist()]
        new = [pair for pair in asked if pair not in self._known]
        if new:
            found = are_known_within(self._system, self._start, np.array(new), FINE[0])
            self._known.update(zip(new, found.tolist(), strict=True))
        return np.array([self._known[pair] for pair in asked], np.bool_)


def neighbour_pairs(
    poses: NDArray[np.float64],
    radius: float,
    revisits: int,
    turn: float,
    among: NDArray[np.bool_] | None = None,
) -> NDArray[np.int64]:
    """(P, 2) ascending pairs of scan indices: close in time, or of another pass nearby.

    Of each earlier or later pass within `radius` metres of `poses` (N, 3) the nearest scan is
    taken, `revisits` passes at most, so that the cost grows with the drive and not with its square.
    It heads the same way, to within `turn` (rad): the other way a robot sees the other sides of
    jambs and pillars. Other passes are looked for `among` (N,) these scans; all of them, if none
    are given.
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
        apart = np.abs(others - scans) >= _GAP
        apart &= np.abs(wrap_angle(poses[others, 2] - poses[scans, 2])) <= turn
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
    anew |= np.diff(others, prepend=0) > _GAP
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
