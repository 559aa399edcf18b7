"""Laser odometry: each scan aligned with a local submap, recorded motion as a doubted prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar, compose_planar, matrix_to_planar
from mapmyworld.kernels.laser_motion import (
    STEP_VARIANCE,
    innovation,
    is_degenerate,
    step_covariance,
)
from mapmyworld.kernels.scan_tracking import explains, learn_overlap, track_scans
from mapmyworld.kernels.step_model import any_step, learn_change, new_steps, next_variances
from mapmyworld.kernels.wheel_model import (
    POSE,
    TRAVELLED,
    anchor,
    learn,
    lengthen,
    new_wheels,
    reckon,
    reckoned_variances,
)
from mapmyworld.odometry.laser_keyframes import Keyframes
from mapmyworld.odometry.pose_hypotheses import FEWEST, SEEN, Prior, likeliest_match
from mapmyworld.odometry.tracking_losses import UNKNOWN
from mapmyworld.odometry.tracking_record import TrackingRecord, fault
from mapmyworld.odometry.unobserved_motion import UnobservedMotion
from mapmyworld.registration.scan_matching import COARSE, FINE, Match, PreparedScan, prepare_scans
from mapmyworld.types import Frame, Scan

_EMPTY = Scan(np.zeros((0, 2), np.float32), np.zeros(3), np.zeros(0, np.float32), 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class LaserMotion:
    """What the laser indicates about one frame."""

    pose: Array
    """(3,) tracked_from_base."""
    covariance: Array
    """(3, 3) of the motion since the previous frame, in this frame's base."""
    verdict: str
    """"first", "matched", "odometry ignored", "odometry only" or "lost"."""
    overlap: float
    """Share of the scan that the local submap explains."""
    is_tracking_loss: bool = False
    """Whether the scans before no longer say where the robot is, and the odometry, if any, errs."""
    fits_nothing: bool = False
    """Whether it is the first scan, or the first of a new submap, that fits nothing before it."""

    is_open: bool = False
    """Whether later scans decide if tracking is lost here: no odometry, and nothing that fits."""


class LaserTracker:
    """Follows the robot from scan to scan in bounded memory."""

    def __init__(self, config: Config, wheels: Array | None = None) -> None:
        """`wheels` (56,): how the odometry is calibrated, if that is known."""
        self._odometry, self._matching = config.odometry, config.registration
        self._record = TrackingRecord()
        self._close_looks = np.ones(2)  # at scans of which no hypothesis fitted, and at others
        self._keyframes = Keyframes(config)
        self._state = np.zeros(8)  # pose, last step, overlaps: see `track_scans`
        self._steps = new_steps()
        self._wheels = new_wheels() if wheels is None else wheels.copy()
        anchor(self._wheels, np.zeros(3))
        self._stalled: Array | None = None  # wheels of before they repeated a pose and scans moved
        self._time = UnobservedMotion()
        self._last_odometry: Array | None = None
        odometry, matching = config.odometry, config.registration
        self._settings = np.array([
            matching.residual_share, matching.range_sigma, matching.correlation,
            odometry.contradiction**2, odometry.least_overlap,
            odometry.keyframe_distance, odometry.keyframe_angle,
        ])  # fmt: skip

    def track(self, frame: Frame) -> LaserMotion:
        """The robot's pose at a frame, from its scan, its odometry and the scans before."""
        return self.track_all([frame])[0]

    def track_all(self, frames: Sequence[Frame]) -> list[LaserMotion]:
        """The same of some frames in a row, with the same result and faster."""
        scans = prepare_scans([frame.scan or _EMPTY for frame in frames], self._matching)
        recorded = self._recorded_steps(frames)
        interpolated = np.array([frame.is_interpolated for frame in frames])
        stamps = [frame.stamp_ns for frame in frames]
        unseen = np.where(
            np.isnan(recorded[:, 0]), self._time.leaps(stamps), self._time.gaps(stamps)
        )
        self._keyframes.make_room(int(np.diff(scans.bounds).max(initial=0)))
        out, covariances = np.zeros((len(frames), 7)), np.zeros((len(frames), 3, 3))
        tracked: list[LaserMotion] = []
        while len(tracked) < len(frames):
            first = len(tracked)
            if not self._time.is_placed and np.isnan(recorded[first, 0]):
                unseen[first] = True  # where it is is as open as time since then lets it be
            # Most scans need no second look: a kernel follows them, up to one that does.
            last = track_scans(
                first, scans.rows, scans.bounds, scans.origins, recorded, interpolated | unseen,
                *self._keyframes.ring, self._state, self._wheels, self._steps, FINE, self._settings,
                FEWEST, out, covariances,
            )  # fmt: skip
            for k in range(first, last):
                tracked.append(LaserMotion(out[k, :3], covariances[k], "matched", float(out[k, 3])))
                self._record.degenerate.add(
                    frames[k].stamp_ns, float(out[k, 5]), weak=out[k, 6] > 0.0
                )
                self._time.take(frames[k].stamp_ns, out[k, :3])
            self._record.compared += int(np.isfinite(recorded[first:last, 0]).sum())
            if recorded[first:last].any():
                self._stalled = None
            if last < len(frames):
                step = None if np.isnan(recorded[last, 0]) else recorded[last]
                tracked.append(self._look_closely(frames[last], scans.one(last), step))
        self._record.verdicts.update(moment.verdict for moment in tracked)
        return tracked

    @property
    def wheels(self) -> Array:
        """(56,) how the log has calibrated its odometry so far: see `kernels.wheel_model`."""
        return self._wheels.copy()

    def notes(self) -> tuple[str, ...]:
        """What was noticed on the way: how far odometry can be trusted, where tracking failed."""
        return self._record.notes(self._wheels)

    def losses(self) -> tuple[str, ...]:
        """Whether most scans reported nothing, so that the path owes them next to nothing."""
        return self._record.losses()

    def _recorded_steps(self, frames: Sequence[Frame]) -> Array:
        """Odometry's motion (B, 3) from frame to frame, NaN where it is not known."""
        poses = [self._last_odometry, *(frame.odom_from_base for frame in frames)]
        self._last_odometry = poses[-1]
        unknown = np.full((4, 4), np.nan)
        planar = matrix_to_planar(np.stack([unknown if p is None else p for p in poses]))
        stands = (planar[1:] == planar[:-1]).all(axis=1)
        return np.where(stands[:, None], 0.0, between_planar(planar[:-1], planar[1:]))

    def _look_closely(
        self, frame: Frame, scan: PreparedScan, recorded: Array | None
    ) -> LaserMotion:
        """One frame that needs more than a match: the first, an empty or a contradicting one."""
        if self._record.first_ns is None:
            self._record.first_ns = frame.stamp_ns
            self._time.begin(frame.stamp_ns, np.zeros(3))
            tracked = LaserMotion(np.zeros(3), STEP_VARIANCE * np.eye(3), "first", 1.0)
        else:
            tracked = self._follow(frame, scan, recorded)
        placed, goes_on = tracked.verdict not in ("odometry only", "lost"), self._goes_on(frame)
        if recorded is not None or goes_on:
            step = between_planar(self._state[:3], tracked.pose)
            if recorded is None and placed:
                learn_change(self._steps, step, self._state[3:6])
            self._state[3:6] = step
        if recorded is None:
            self._steps[:3] += self._steps[3:] if goes_on else any_step(np.zeros(3))
        self._state[:3] = tracked.pose
        self._time.take(frame.stamp_ns, tracked.pose if placed else None)
        if len(scan.rows) >= FEWEST and (placed or not self._keyframes.count):
            if tracked.is_tracking_loss:
                self._state[3:6], self._steps[:3] = 0.0, any_step(np.zeros(3))
                self._time.begin(frame.stamp_ns, tracked.pose)
            is_known = self._keyframes.remember(scan, tracked.pose, tracked.overlap)
            if is_known and not frame.is_interpolated:
                anchor(self._wheels, tracked.pose)
        return tracked

    def _follow(self, frame: Frame, scan: PreparedScan, recorded: Array | None) -> LaserMotion:
        before, stalled = self._by_wheels(self._wheels).variances, None
        if recorded is not None:
            if recorded.any():
                stalled, self._stalled = self._stalled, None
            way = self._time.way(frame.stamp_ns) if recorded.any() else np.zeros(2)
            for wheels in [self._wheels] if stalled is None else [self._wheels, stalled]:
                reckon(wheels, recorded)
                lengthen(wheels, recorded, way)
        if recorded is None or frame.is_interpolated:
            prior, grown = self._going_on(frame, recorded)
        else:
            prior = self._by_wheels(self._wheels)
            grown = np.maximum(prior.variances - before, STEP_VARIANCE)
        if len(scan.rows) < FEWEST or not self._keyframes.count:
            verdict = "lost" if recorded is None else "odometry only"
            return LaserMotion(prior.pose, np.diag(grown), verdict, 0.0)
        if recorded is None and self._time.may_have_left(frame.stamp_ns):
            return self._lost(frame, prior.pose, prior.variances, 0.0)
        match, verdict, left = self._matched(scan, prior)
        if stalled is not None and verdict != "matched":
            caught_up = self._by_wheels(stalled)  # counted from before it stood
            other, its_verdict, its_left = self._matched(scan, caught_up)
            if its_verdict == "matched" or verdict == "lost":
                match, verdict, left = other, its_verdict, its_left
                prior, self._wheels = caught_up, stalled
        if verdict == "lost":
            return self._unmatched(frame, scan, prior, grown, match.overlap)
        measured = None if frame.is_interpolated else recorded
        learn_overlap(self._state, match.overlap)
        if measured is None:
            verdict = "matched"
        is_new = self._keyframes.is_new(match, self._settings)
        if is_new:
            self._keyframes.learn_matching(scan, match, self._settings)
        return self._placed(
            frame.stamp_ns, measured, prior, match, verdict, left, grown, is_new=is_new
        )

    def _going_on(self, frame: Frame, recorded: Array | None) -> tuple[Prior, Array]:
        """Where a robot is expected that goes on as it did, or as interpolated, and by how much it
        may not.
        """
        step, unseen = recorded, np.zeros(3)
        if step is None:
            step = self._time.step(frame.stamp_ns, self._state[3:6])
            unseen = self._time.variances(frame.stamp_ns)
        grown = any_step(step)
        variances = otherwise = grown + unseen
        if recorded is None and self._goes_on(frame):
            variances = next_variances(self._steps) + unseen
        expected = compose_planar(self._state[:3], step)
        return Prior(expected, variances, recorded is not None, otherwise), grown

    def _goes_on(self, frame: Frame) -> bool:
        """Whether the last frame's scan showed where the robot was, and this one comes soon."""
        return self._time.is_placed and self._time.goes_on(frame.stamp_ns)

    def _by_wheels(self, wheels: Array) -> Prior:
        """Where the odometry of a model (56,) leads to since the last keyframe.

        The probability of a scan that fits nothing is their share of all that were looked at
        closely.
        """
        variances, fault = np.asarray(reckoned_variances(wheels)), self._record.fault_share()
        fits = float(np.log(self._close_looks[1] / self._close_looks[0]))
        return Prior(wheels[POSE].copy(), variances, True, variances, fault, fits)

    def _unmatched(
        self, frame: Frame, scan: PreparedScan, prior: Prior, grown: Array, overlap: float
    ) -> LaserMotion:
        """A scan that fits nothing: the odometry leads on, unless it is refuted.

        One may be anything. Where the next fits nothing either, and the odometry leads beyond what
        is searched, a new submap begins; and where one would see through walls from where the robot
        must be, it was carried off. Without odometry it is expected to go on as it did, for as long
        as nothing else can have become of it.
        """
        is_first = self._time.is_placed
        path, rotation = self._wheels[TRAVELLED]
        far = path > self._odometry.search_distance or rotation > self._odometry.search_angle
        changed = prior.has_odometry and far
        refuted = False
        if not (is_first or frame.is_interpolated):
            if not changed:
                refuted = self._keyframes.share_seen_through(scan, prior.pose) >= SEEN
            if changed or refuted:
                self._keyframes.forget()
        if not prior.has_odometry:
            if refuted:
                return self._lost(frame, prior.pose, UNKNOWN, overlap)
            return LaserMotion(
                prior.pose, np.diag(grown), "lost", overlap, fits_nothing=is_first, is_open=True
            )
        is_new = not self._keyframes.count
        return LaserMotion(
            prior.pose, np.diag(grown), "odometry only", overlap, refuted,
            fits_nothing=is_first or is_new,
        )  # fmt: skip

    def _lost(self, frame: Frame, pose: Array, variances: Array, overlap: float) -> LaserMotion:
        """The first scan of a new submap, which nothing ties to the one before."""
        self._keyframes.forget()
        self._record.lost_ns.append(frame.stamp_ns)
        return LaserMotion(pose, np.diag(variances), "lost", overlap, is_tracking_loss=True)

    def _placed(
        self, stamp_ns: int, recorded: Array | None, prior: Prior, match: Match, verdict: str,
        left: Array, grown: Array, *, is_new: bool,
    ) -> LaserMotion:  # fmt: skip
        """What a match that is believed reports about the motion, and of the odometry.

        A fault has `left` these variances (3,) of the prior, of which the last recorded step has
        added those `grown` (3,).
        """
        variances = prior.variances
        grown = variances if recorded is None else grown
        moved = between_planar(self._state[:3], match.pose)
        weak = is_degenerate(match.information)
        self._record.degenerate.add(stamp_ns, float(np.hypot(*moved[:2])), weak=weak)
        if recorded is not None:
            found = innovation(prior.pose, match.pose, match.information, variances)
            if is_new or verdict != "matched":
                if not recorded.any() and self._stalled is None and verdict != "matched":
                    self._stalled = self._wheels.copy()
                learn(self._wheels, found, weak)
                anchor(self._wheels, match.pose)
            self._record.compared += 1
            if found[6] > self._odometry.contradiction**2:
                self._record.faults[fault(recorded, moved)] += 1
                if verdict != "matched":
                    variances = grown = left
        covariance = step_covariance(
            moved, match.information, variances, grown,
            self._odometry.keyframe_distance, self._odometry.keyframe_angle,
        )  # fmt: skip
        return LaserMotion(match.pose, covariance, verdict, match.overlap)

    def _matched(self, scan: PreparedScan, prior: Prior) -> tuple[Match, str, Array]:
        """The match near the prediction, or where that contradicts it, the best of several.

        And its verdict, and what it leaves of the prediction: the variances (3,).
        """
        information = np.diag(1.0 / prior.variances)
        wide = 9.0 * prior.otherwise[0] > FINE[0] ** 2
        first = self._keyframes.match(
            scan, prior.pose, information, COARSE if wide else FINE, self._settings
        )
        found = innovation(prior.pose, first.pose, first.information, prior.variances)
        good = explains(self._state, first.overlap, self._settings, prior.has_odometry)
        if good and found[6] <= self._odometry.contradiction**2:
            return first, "matched", prior.variances
        best = likeliest_match(
            scan, self._keyframes, self._state, prior, first, self._odometry, self._settings
        )
        self._close_looks[int(best is not None)] += 1.0
        if best is None:
            return first, "lost", prior.variances
        if best is first:
            return best, "matched", prior.variances
        fused, variances, is_fault = prior.fused(best, self._odometry)
        return fused, "odometry ignored" if is_fault else "matched", variances
