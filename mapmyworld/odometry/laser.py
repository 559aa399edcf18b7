"""Laser odometry: each scan aligned with a local submap, recorded motion as a doubted prior."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry import between_planar, compose_planar, matrix_to_planar
from mapmyworld.kernels.scan_alignment import invert3
from mapmyworld.odometry.laser_stretches import WeakStretches, is_weak, plane_variances
from mapmyworld.odometry.laser_trust import OdometryTrust
from mapmyworld.registration.scan_matching import (
    COARSE,
    FINE,
    Match,
    PreparedScan,
    ScanSet,
    match_scan,
    prepare_scan,
    scan_set,
)
from mapmyworld.registration.scan_search import search_pose
from mapmyworld.types import Frame

_BACK = (1, 3, 8)  # how many keyscans back the targets of a match lie
_CLEARLY = 0.05  # by which one match must be better to be preferred over a nearer one
_DOUBT_FROM = 6.0  # squared sigmas between odometry and match from which neither is sure
_STILL = 0.03  # of a keyscan's distance: less is no motion
_FEWEST = 12  # points of a scan below which it is not matched
_WEAK_PRIOR = np.diag([0.04, 0.04, 0.04])  # 5 m and 5 rad: keeps a corridor solvable


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """What the tracker says of one frame."""

    pose: NDArray[np.float64]
    """(3,) tracked_from_base."""
    information: NDArray[np.float64]
    """(3, 3) of the motion since the previous frame, in this frame's base."""
    verdict: str
    """"first", "matched", "odometry ignored", "searched", "odometry only" or "lost"."""
    overlap: float
    """Share of the scan that the local submap explains."""
    weakness: float
    """Standard deviation, metres, of the match in its weakest direction."""


@dataclass(frozen=True, slots=True, eq=False)
class _Keyscan:
    scan: PreparedScan
    pose: NDArray[np.float64]


class LaserTracker:
    """Follows the robot from scan to scan in bounded memory."""

    def __init__(self, config: Config) -> None:
        self._odometry, self._matching = config.odometry, config.registration
        self._trust = OdometryTrust(config.odometry)
        self._stretches = WeakStretches()
        self._keyscans: deque[_Keyscan] = deque(maxlen=config.odometry.keyscans)
        self._targets: ScanSet | None = None
        self._target_poses = np.zeros((0, 3))
        self._pose = np.zeros(3)
        self._step = np.zeros(3)
        self._last: Frame | None = None
        self.verdicts: Counter[str] = Counter()

    def track(self, frame: Frame) -> Tracked:
        """The robot's pose at a frame, from its scan, its odometry and the scans before."""
        scan = None if frame.scan is None else prepare_scan(frame.scan, self._matching)
        if self._last is None:
            tracked = Tracked(self._pose, np.diag([1e6, 1e6, 1e6]), "first", 1.0, 0.0)
        else:
            tracked = self._follow(frame, scan)
        self._step = between_planar(self._pose, tracked.pose)
        self._pose, self._last = tracked.pose, frame
        if scan is not None and len(scan.rows) >= _FEWEST:
            self._remember(scan, tracked)
        self.verdicts[tracked.verdict] += 1
        return tracked

    def notes(self) -> tuple[str, ...]:
        """What was noticed on the way: how far odometry can be trusted, where tracking failed."""
        found = [*self._trust.notes(), *self._stretches.notes()]
        for verdict, text in _NOTES.items():
            if self.verdicts[verdict]:
                found.append(f"{self.verdicts[verdict]} scans {text}")
        return tuple(found)

    def _follow(self, frame: Frame, scan: PreparedScan | None) -> Tracked:
        recorded = self._recorded_step(frame)
        # Without odometry the robot is expected to go on as it did.
        step = self._step if recorded is None else recorded
        predicted = compose_planar(self._pose, step)
        covariance = self._trust.covariance(step, recorded is not None)
        if scan is None or len(scan.rows) < _FEWEST or self._targets is None:
            verdict = "lost" if recorded is None else "odometry only"
            return Tracked(predicted, invert3(covariance), verdict, 0.0, 10.0)
        information = invert3(covariance)
        match = self._match(scan, predicted, predicted, information, FINE)
        surprise = self._trust.surprise(predicted, match, covariance)
        verdict = "matched"
        doubtful = match.overlap < self._odometry.least_overlap
        if surprise > self._odometry.contradiction**2 or doubtful:
            match, verdict = self._look_again(scan, predicted, match)
            if verdict == "odometry ignored" and recorded is None:
                verdict = "matched"
            surprise = self._trust.surprise(predicted, match, covariance)
        if verdict == "lost" and recorded is not None:
            return Tracked(predicted, information, "odometry only", match.overlap, 10.0)
        if recorded is not None:
            moved = between_planar(self._pose, match.pose)
            self._trust.learn(recorded, moved, surprise)
        moved = between_planar(self._pose, match.pose)
        self._stretches.add(frame.stamp_ns, float(np.hypot(*moved[:2])), match.information)
        doubt = np.zeros((3, 3))
        if surprise > _DOUBT_FROM and recorded is not None:
            # A door that swings past looks like a turn: either may be right.
            doubt = np.diag(between_planar(predicted, match.pose) ** 2)
        return self._tracked(match, covariance, verdict, doubt)

    def _recorded_step(self, frame: Frame) -> NDArray[np.float64] | None:
        assert self._last is not None
        before, now = self._last.odom_from_base, frame.odom_from_base
        if before is None or now is None:
            return None
        return between_planar(matrix_to_planar(before), matrix_to_planar(now))

    def _match(
        self,
        scan: PreparedScan,
        guess: NDArray[np.float64],
        prior: NDArray[np.float64],
        information: NDArray[np.float64],
        reaches: NDArray[np.float64],
    ) -> Match:
        assert self._targets is not None
        which = np.arange(len(self._targets), dtype=np.int64)
        return match_scan(
            scan, self._targets, which, self._target_poses, guess, self._matching,
            prior=prior, prior_information=information, reaches=reaches,
        )  # fmt: skip

    def _look_again(
        self, scan: PreparedScan, predicted: NDArray[np.float64], first: Match
    ) -> tuple[Match, str]:
        """The best of several starts that owe nothing to the odometry; at last a wide search."""
        assert self._targets is not None
        starts = [first.pose, compose_planar(self._pose, self._step), self._pose, predicted]
        tried = [self._match(scan, s, s, _WEAK_PRIOR, COARSE) for s in starts]
        best = max(tried, key=_quality)
        if best.overlap >= self._odometry.least_overlap:
            if first.overlap >= self._odometry.least_overlap and (
                _quality(tried[0]) >= _quality(best) - _CLEARLY
            ):
                return tried[0], "matched"
            return best, "odometry ignored"
        found = search_pose(
            scan, self._targets, self._target_poses, self._pose,
            self._odometry.search_distance, self._odometry.search_angle,
        )  # fmt: skip
        if found is not None:
            again = self._match(scan, found.pose, found.pose, _WEAK_PRIOR, COARSE)
            if _quality(again) > _quality(best) + 0.02:
                best = again
        good = best.overlap >= 0.6 * self._odometry.least_overlap
        return best, "searched" if good else "lost"

    def _tracked(
        self,
        match: Match,
        covariance: NDArray[np.float64],
        verdict: str,
        doubt: NDArray[np.float64],
    ) -> Tracked:
        """The match as motion: errors add up from keyscan to keyscan, not from scan to scan."""
        step = between_planar(self._pose, match.pose)
        moved = max(
            np.hypot(step[0], step[1]) / self._odometry.keyscan_distance,
            abs(step[2]) / self._odometry.keyscan_angle,
        )
        share = min(max(moved, 0.01), 1.0)
        if moved > _STILL and is_weak(match.information):
            share = 1.0  # the open direction rests on odometry, whose errors add up step by step
        total = match.information + invert3(covariance)
        motion = share * invert3(total) + np.diag([1e-8, 1e-8, 1e-8]) + doubt
        weakest = float(np.sqrt(plane_variances(match.information)[1]))
        return Tracked(match.pose, invert3(motion), verdict, match.overlap, weakest)

    def _remember(self, scan: PreparedScan, tracked: Tracked) -> None:
        if tracked.verdict in ("lost", "odometry only"):
            self._keyscans.clear()  # the old submap no longer says where the robot is
        elif self._keyscans:
            step = between_planar(self._keyscans[-1].pose, tracked.pose)
            near = np.hypot(step[0], step[1]) < self._odometry.keyscan_distance
            if near and abs(step[2]) < self._odometry.keyscan_angle and tracked.overlap > 0.75:
                return
        self._keyscans.append(_Keyscan(scan, tracked.pose))
        chosen = [self._keyscans[-back] for back in _BACK if back <= len(self._keyscans)]
        self._targets = scan_set([keyscan.scan for keyscan in chosen])
        self._target_poses = np.array([keyscan.pose for keyscan in chosen])


def _quality(match: Match) -> float:
    """Overlap, less what the points miss their lines by (0.1 m costs a whole overlap)."""
    return match.overlap - 10.0 * match.residual


_NOTES = {
    "odometry ignored": "contradicted the odometry and were placed without it",
    "searched": "were found again only by a wide search",
    "odometry only": "could not be matched; their motion is the odometry's",
    "lost": "could not be matched and have no odometry: the robot is taken to go on as before",
}
