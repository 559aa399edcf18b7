"""The local submap: some scans of the last few metres, against which the next one is matched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import transform_points_planar
from mapmyworld.kernels.scan_tracking import (
    chosen_keyframes,
    is_new,
    learn_matching,
    remember_scan,
)
from mapmyworld.registration.place_evidence import Place
from mapmyworld.registration.scan_matching import (
    FINE,
    Match,
    PreparedScan,
    ScanSet,
    match_scan,
    scan_set,
)
from mapmyworld.registration.submaps import Submap, submap_points

Ring = tuple[NDArray[np.float32], Index, Array, Array, Index, Index]
"""Rows, counts, origins, poses, newest and places of keyframes."""
_BACK = np.array([1, 3, 8])  # how many keyframes back the targets of a match lie
_SECTORS = 360  # about the laser, in each of which the nearest surface hides the others
_MARGIN, _SHARE = 0.2, 0.03  # m, and of the range, by which a point may miss its surface


class Keyframes:
    """A ring of scans at their poses, in arrays that a kernel reads and writes."""

    def __init__(self, config: Config) -> None:
        self._odometry, self._matching = config.odometry, config.registration
        slots = int(_BACK[-1])  # the farthest target is the oldest scan
        self._rows = np.zeros((slots, 0, 6), np.float32)
        self._counts = np.zeros(slots, np.int64)
        self._origins, self._poses = np.zeros((slots, 2)), np.zeros((slots, 3))
        self._newest = np.zeros(2, np.int64)  # its slot, and how many scans there are

    @property
    def count(self) -> int:
        """How many scans there are."""
        return int(self._newest[1])

    @property
    def ring(self) -> Ring:
        """Rows (K, P, 6), counts (K,), origins (K, 2), poses (K, 3), newest (2,) and places (B,).

        Arguments of `track_scans`.
        """
        return self._rows, self._counts, self._origins, self._poses, self._newest, _BACK

    def make_room(self, points: int) -> None:
        """Lets every slot hold a scan of so many points."""
        missing = points - self._rows.shape[1]
        if missing > 0:
            self._rows = np.pad(self._rows, ((0, 0), (0, missing), (0, 0)))

    def forget(self) -> None:
        """Begins a new submap."""
        self._newest[1] = 0

    def remember(self, scan: PreparedScan, pose: Array, overlap: float) -> bool:
        """Lets a scan join at its pose (3,), where it says something new; whether it did."""
        return remember_scan(
            scan.rows, scan.origin, pose, overlap,
            self._odometry.keyframe_distance, self._odometry.keyframe_angle, *self.ring[:-1],
        )  # fmt: skip

    def match(
        self,
        scan: PreparedScan,
        guess: Array,
        information: Array,
        max_distances: Array,
        settings: Array,
    ) -> Match:
        """Aligns a scan with the submap, from a `guess` (3,) known to `information` (3, 3).

        `max_distances` (R,) as of `align`; `settings` (7,) are those of `track_scans`, of which
        the variance factor is learnt.
        """
        return self.matches(scan, [guess], information, max_distances, settings)[0]

    def matches(
        self,
        scan: PreparedScan,
        guesses: Sequence[Array],
        information: Array,
        max_distances: Array,
        settings: Array,
    ) -> list[Match]:
        """The same from each of some `guesses` (3,).

        `information` (3, 3), `max_distances` (R,) and `settings` (7,) as of `match`.
        """
        targets, poses = self.targets()
        config = replace(self._matching, correlation=float(settings[2]))
        return [
            match_scan(
                scan, targets, poses, guess, config,
                prior_information=information, max_distances=max_distances,
            )
            for guess in guesses
        ]  # fmt: skip

    def is_new(self, match: Match, settings: Array) -> bool:
        """Whether a scan matched so is about to join; `settings` (7,) as of `track_scans`."""
        ring = self.ring
        return bool(is_new(match.pose, match.overlap, settings[5], settings[6], ring[3], ring[4]))

    def learn_matching(self, scan: PreparedScan, match: Match, settings: Array) -> None:
        """Lets the variance factor learn from a scan that is about to join.

        `settings` (7,) as of `track_scans`; the correlation among them changes.
        """
        learn_matching(
            scan.rows, 0, len(scan.rows), *self.ring[:4], self._chosen(), match.pose, FINE, settings
        )

    def independent_points(self, scan: PreparedScan, settings: Array) -> float:
        """How many points of a scan err by themselves; `settings` (7,) as of `track_scans`."""
        return len(scan.rows) / max(float(settings[2]), self._matching.correlation)

    def place(self) -> Place:
        """What the submap's scans saw together."""
        return Place.of(Submap.of(*self.targets()))

    def share_seen_through(self, scan: PreparedScan, pose: Array) -> float:
        """Share of a scan's points that, from a pose (3,), lie beyond the submap's surfaces."""
        return share_seen_through(scan, *self.targets(), pose)

    def targets(self) -> tuple[ScanSet, Array]:
        """The scans that are matched against, and their poses (S, 3)."""
        which = self._chosen()
        scans = [PreparedScan(self._rows[k, : self._counts[k]], self._origins[k]) for k in which]
        return scan_set(scans), self._poses[which]

    def _chosen(self) -> NDArray[np.int64]:
        return np.asarray(chosen_keyframes(_BACK, self._newest, len(self._counts)))


def share_seen_through(scan: PreparedScan, targets: ScanSet, poses: Array, pose: Array) -> float:
    """Share of a scan's points that, from a pose (3,), lie beyond surfaces of the targets.

    Of those that lie at or beyond one: what comes from nearer may be somebody in the way, and
    about the rest the targets, at `poses` (S, 3), indicate nothing.
    """
    origin = transform_points_planar(pose, scan.origin[None])
    surfaces = submap_points(targets, poses)
    known, sector = _polar(surfaces - origin)
    nearest = np.full(_SECTORS, np.inf)
    np.minimum.at(nearest, sector, known)
    away, sector = _polar(transform_points_planar(pose, scan.rows[:, :2]) - origin)
    behind, margin = away - nearest[sector], _MARGIN + _SHARE * away
    beyond = int(np.count_nonzero(behind > margin))
    met = int(np.count_nonzero(np.abs(behind) <= margin))
    return beyond / max(beyond + met, 1)


def _polar(points: Array) -> tuple[Array, NDArray[np.int64]]:
    """Distances (N,) of points (N, 2), and the sectors they lie in."""
    turn = np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi) + 0.5
    return np.hypot(points[:, 0], points[:, 1]), (turn * _SECTORS).astype(np.int64) % _SECTORS
