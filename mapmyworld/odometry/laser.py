"""Laser odometry: each scan aligned with a local submap, recorded motion as a doubted prior."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import between_planar, compose_planar, matrix_to_planar
from mapmyworld.kernels.laser_motion import (
    leaves_open,
    motion_variances,
    step_covariance,
    surprise_of,
)
from mapmyworld.kernels.scan_tracking import learnt_scale, track_scans
from mapmyworld.odometry.keyscans import Keyscans
from mapmyworld.odometry.laser_breaks import Breaks, is_doubtful
from mapmyworld.odometry.laser_stretches import WeakStretches
from mapmyworld.odometry.laser_trust import OdometryFaults
from mapmyworld.registration.matchers import find_matcher
from mapmyworld.registration.point_to_line import point_to_line
from mapmyworld.registration.scan_matching import COARSE, FINE, Match, PreparedScan, prepare_scans
from mapmyworld.registration.scan_search import search_pose
from mapmyworld.types import Frame, Scan

Array = NDArray[np.float64]
_CLEARLY = 0.05  # by which one match must be better to be preferred over a nearer one
_POOR = 0.6  # of the least overlap, with which a match still tells where the robot is
_NEARLY = 0.8  # of it, with which a match is kept before a farther one that is not to be believed
_REFUTED = 0.5  # share of the points seen through surfaces from which nobody can have been there
_BORNE_OUT = 0.3  # share up to which somebody can
_DOUBT_FROM = 6.0  # squared sigmas between odometry and match from which neither is sure
_FEWEST = 12  # points of a scan below which it is not matched
_WEAK_PRIOR = np.diag([0.04, 0.04, 0.04])  # 5 m and 5 rad: keeps a corridor solvable
_FIRST = np.full(3, 1e-6)  # variances of the first pose, which is the origin
_EMPTY = Scan(np.zeros((0, 2), np.float32), np.zeros(3), np.zeros(0, np.float32), 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class LaserMotion:
    """What the laser says of one frame."""

    pose: Array
    """(3,) tracked_from_base."""
    covariance: Array
    """(3, 3) of the motion since the previous frame, in this frame's base."""
    verdict: str
    """"first", "matched", "odometry ignored", "searched", "odometry only" or "lost"."""
    overlap: float
    """Share of the scan that the local submap explains."""
    is_break: bool = False
    """Whether the scans before no longer say where the robot is."""

    @property
    def information(self) -> Array:
        """(3, 3), the covariance's inverse."""
        return np.asarray(np.linalg.inv(self.covariance))


class LaserTracker:
    """Follows the robot from scan to scan in bounded memory."""

    def __init__(self, config: Config) -> None:
        self._odometry, self._matching = config.odometry, config.registration
        self._faults = OdometryFaults()
        self._stretches = WeakStretches()
        self._breaks = Breaks()
        self._keyscans = Keyscans(config)
        self._state = np.zeros(7)  # pose, last step, scale of the odometry's variances
        self._state[6] = 1.0
        self._last_odometry: Array | None = None
        self._begun = False
        # The kernel that follows scans has its own matcher built in.
        self._in_kernel = find_matcher(config.registration.matcher) is point_to_line
        self.verdicts: Counter[str] = Counter()
        odometry, matching = config.odometry, config.registration
        self._settings = np.array([
            matching.residual_share, matching.range_sigma, matching.correlation,
            odometry.share_sigma, odometry.floor_sigma, odometry.contradiction**2,
            odometry.least_overlap, odometry.keyscan_distance, odometry.keyscan_angle, _DOUBT_FROM,
        ])  # fmt: skip

    def track(self, frame: Frame) -> LaserMotion:
        """The robot's pose at a frame, from its scan, its odometry and the scans before."""
        return self.track_all([frame])[0]

    def track_all(self, frames: Sequence[Frame]) -> list[LaserMotion]:
        """The same of some frames in a row, with the same result and faster."""
        scans = prepare_scans([frame.scan or _EMPTY for frame in frames], self._matching)
        recorded = self._recorded_steps(frames)
        self._keyscans.make_room(int(np.diff(scans.bounds).max(initial=0)))
        out, covariances = np.zeros((len(frames), 7)), np.zeros((len(frames), 3, 3))
        tracked: list[LaserMotion] = []
        while len(tracked) < len(frames):
            first = len(tracked)
            # Most scans need no second look: a kernel follows them, up to one that does.
            last = first
            if self._in_kernel:
                last = track_scans(
                    first, scans.rows, scans.bounds, scans.origins, recorded, *self._keyscans.ring,
                    self._state, FINE, self._settings, _FEWEST, out, covariances,
                )  # fmt: skip
            for k in range(first, last):
                tracked.append(LaserMotion(out[k, :3], covariances[k], "matched", float(out[k, 3])))
                self._stretches.add(frames[k].stamp_ns, float(out[k, 5]), weak=out[k, 6] > 0.0)
            if last > first:
                self._breaks.see_again(frames[last - 1].stamp_ns)
            self._faults.steps += int(np.isfinite(recorded[first:last, 0]).sum())
            if last < len(frames):
                step = None if np.isnan(recorded[last, 0]) else recorded[last]
                tracked.append(self._look_closely(frames[last], scans.one(last), step))
        self.verdicts.update(moment.verdict for moment in tracked)
        return tracked

    def notes(self) -> tuple[str, ...]:
        """What was noticed on the way: how far odometry can be trusted, where tracking failed."""
        found = [*self._faults.notes(), *self._stretches.notes(), *self._breaks.notes()]
        for verdict, text in _NOTES.items():
            if self.verdicts[verdict]:
                found.append(f"{self.verdicts[verdict]} scans {text}")
        return tuple(found)

    def losses(self) -> tuple[str, ...]:
        """Whether most scans told nothing, so that the path owes them next to nothing."""
        useless = self.verdicts["odometry only"] + self.verdicts["lost"]
        total = self.verdicts.total()
        if 2 * useless <= total:
            return ()
        return (
            f"{useless} of {total} scans fit nothing that was seen before: the path is not the "
            "laser's; see that its ranges are in metres, its angles in radians, and that it sees "
            "walls",
        )

    def _recorded_steps(self, frames: Sequence[Frame]) -> Array:
        """Odometry's motion (B, 3) from frame to frame, NaN where it is not known."""
        poses = [self._last_odometry, *(frame.odom_from_base for frame in frames)]
        self._last_odometry = poses[-1]
        unknown = np.full((4, 4), np.nan)
        planar = matrix_to_planar(np.stack([unknown if p is None else p for p in poses]))
        return np.ascontiguousarray(between_planar(planar[:-1], planar[1:]))

    def _look_closely(
        self, frame: Frame, scan: PreparedScan, recorded: Array | None
    ) -> LaserMotion:
        """One frame that needs more than a match: the first, an empty or a contradicting one."""
        if not self._begun:
            self._begun = True
            tracked = LaserMotion(np.zeros(3), np.diag(_FIRST), "first", 1.0)
        else:
            tracked = self._follow(frame, scan, recorded)
        self._state[3:6] = between_planar(self._state[:3], tracked.pose)
        self._state[:3] = tracked.pose
        placed = tracked.is_break or tracked.verdict != "odometry only"
        if len(scan.rows) >= _FEWEST and (placed or not self._keyscans.count):
            if tracked.is_break:
                self._keyscans.forget()  # the old submap no longer says where the robot is
                self._state[3:6] = 0.0
            self._breaks.see_again(frame.stamp_ns)
            self._keyscans.remember(scan, tracked.pose, tracked.overlap)
        return tracked

    def _follow(self, frame: Frame, scan: PreparedScan, recorded: Array | None) -> LaserMotion:
        # Without odometry the robot is expected to go on as it did.
        step = self._state[3:6] if recorded is None else recorded
        predicted = compose_planar(self._state[:3], step)
        reckoned = variances = self._variances(recorded, step)
        if len(scan.rows) < _FEWEST or not self._keyscans.count:
            verdict = "lost" if recorded is None else "odometry only"
            self._breaks.go_unseen(frame.stamp_ns, step)
            return LaserMotion(predicted, np.diag(variances), verdict, 0.0)
        if self._breaks.is_blind:
            variances = self._variances(recorded, self._breaks.since_seen(step))
        match, verdict = self._matched(scan, predicted, variances)
        if verdict == "odometry ignored" and recorded is None:
            verdict = "matched"
        apart = between_planar(predicted, match.pose)
        lately = self._breaks.fitted_lately(frame.stamp_ns)
        believed = verdict == "matched"
        if verdict not in ("matched", "lost"):
            surer = lately and self._is_surer(scan, match, predicted)
            believed = surer or not is_doubtful(match, apart)
        if not believed:
            if recorded is not None and lately:
                self._breaks.go_unseen(frame.stamp_ns, step)
                return LaserMotion(predicted, np.diag(reckoned), "odometry only", match.overlap)
            unknown, is_break = self._breaks.found(frame.stamp_ns, variances, apart, match.overlap)
            pose, said = (match.pose, "lost") if recorded is None else (predicted, "odometry only")
            return LaserMotion(pose, np.diag(unknown), said, match.overlap, is_break)
        return self._placed(frame.stamp_ns, recorded, predicted, variances, match, verdict)

    def _placed(
        self, stamp_ns: int, recorded: Array | None, predicted: Array, variances: Array,
        match: Match, verdict: str,
    ) -> LaserMotion:  # fmt: skip
        """What a match that is believed says of the motion, and of the odometry."""
        moved = between_planar(self._state[:3], match.pose)
        weak = leaves_open(match.information)
        self._stretches.add(stamp_ns, float(np.hypot(*moved[:2])), weak=weak)
        doubt = np.zeros(3)
        if recorded is not None:
            apart = between_planar(predicted, match.pose)
            surprise = surprise_of(predicted, match.pose, match.information, variances)
            self._learn(recorded, moved, surprise)
            if surprise > _DOUBT_FROM:
                # A door that swings past looks like a turn: either may be right.
                doubt = apart**2
        covariance = self._covariance(match, moved, variances, doubt)
        return LaserMotion(match.pose, covariance, verdict, match.overlap)

    def _is_surer(self, scan: PreparedScan, match: Match, predicted: Array) -> bool:
        """Whether from where the odometry leads one would see through walls, but not from there.

        Then the odometry is wrong, and nobody stands in the way.
        """
        at_odometry = self._keyscans.share_seen_through(scan, predicted)
        at_match = self._keyscans.share_seen_through(scan, match.pose)
        return at_odometry >= _REFUTED and at_match < _BORNE_OUT

    def _covariance(self, match: Match, moved: Array, variances: Array, doubt: Array) -> Array:
        return step_covariance(
            moved, match.information, variances, doubt,
            self._odometry.keyscan_distance, self._odometry.keyscan_angle,
        )  # fmt: skip

    def _variances(self, recorded: Array | None, step: Array) -> Array:
        """(3,) of a step; wide where nothing was recorded and inertia is all there is."""
        if recorded is None:
            return np.asarray(motion_variances(step, 1.0, 0.1, 1.0))
        share, floor = self._odometry.share_sigma, self._odometry.floor_sigma
        return np.asarray(motion_variances(step, share, floor, self._state[6]))

    def _learn(self, recorded: Array, moved: Array, surprise: float) -> None:
        self._faults.steps += 1
        self._state[6] = learnt_scale(self._state[6], recorded, moved, surprise)
        if surprise > self._odometry.contradiction**2:
            self._faults.add(recorded, moved)

    def _matched(self, scan: PreparedScan, predicted: Array, variances: Array) -> tuple[Match, str]:
        """The match near the prediction, or where that contradicts it, the best of several."""
        information = np.diag(1.0 / variances)
        first = self._keyscans.match(scan, predicted, information, FINE)
        surprise = surprise_of(predicted, first.pose, first.information, variances)
        good = first.overlap >= self._odometry.least_overlap
        if good and surprise <= self._odometry.contradiction**2:
            return first, "matched"
        return self._look_again(scan, predicted, first)

    def _look_again(self, scan: PreparedScan, predicted: Array, first: Match) -> tuple[Match, str]:
        """The best of several starts that owe nothing to the odometry; at last a wide search."""
        pose = self._state[:3].copy()
        starts = [first.pose, compose_planar(pose, self._state[3:6]), pose, predicted]
        tried = [self._keyscans.match(scan, s, _WEAK_PRIOR, COARSE) for s in starts]
        best = max(tried, key=_quality)
        poor = _POOR * self._odometry.least_overlap
        if best.overlap >= self._odometry.least_overlap:
            near = tried[0]
            if _quality(near) < _quality(best) - _CLEARLY or near.overlap < poor:
                return best, "odometry ignored"
            good = first.overlap >= self._odometry.least_overlap
            return near, "matched" if good else "odometry ignored"
        found = search_pose(
            scan, *self._keyscans.targets(), pose,
            self._odometry.search_distance, self._odometry.search_angle,
        )  # fmt: skip
        if found is not None:
            again = self._keyscans.match(scan, found.pose, _WEAK_PRIOR, COARSE)
            doubtful = is_doubtful(again, between_planar(predicted, again.pose))
            kept = doubtful and best.overlap >= _NEARLY * self._odometry.least_overlap
            if not kept and _quality(again) > _quality(best) + 0.02:
                best = again
        return best, "searched" if best.overlap >= poor else "lost"


def _quality(match: Match) -> float:
    """Overlap, less what the points miss their lines by (0.1 m costs a whole overlap)."""
    return match.overlap - 10.0 * match.residual


_NOTES = {
    "odometry ignored": "contradicted the odometry and were placed without it",
    "searched": "were found again only by a wide search",
    "odometry only": "could not be matched; their motion is the odometry's",
    "lost": "could not be matched and have no odometry: the robot is taken to go on as before",
}
