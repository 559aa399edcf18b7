"""Which tracker follows the robot: by laser, by camera, or by the recorded odometry alone."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import covariance_from_planar, planar_to_matrix
from mapmyworld.geometry.rigid import between
from mapmyworld.odometry.recorded_odometry import motion_covariance
from mapmyworld.parallel import batches
from mapmyworld.sensing import Plan
from mapmyworld.stages.nodes import Motion
from mapmyworld.types import CameraTracking, Frame, LaserTracking, Odometry

if TYPE_CHECKING:
    from mapmyworld.odometry.visual_odometry import VisualMotion

AT_ONCE = 64
"""Scans that are followed in one go, or wait for later ones."""
_OUT_OF_PLANE = 1e-8  # rad^2 and m^2 by which a planar robot leaves its plane, a step
Followed = Iterator[tuple[Frame, Motion]]


class Tracker(Protocol):
    """Follows the robot frame by frame."""

    def follow(self, frames: Iterable[Frame]) -> Iterator[tuple[Frame, Motion]]:
        """Each frame with where the robot was; frames of which that cannot be said are left out."""

    def notes(self) -> tuple[str, ...]:
        """What the user should know, once all frames have been followed."""
        return ()

    def losses(self) -> tuple[str, ...]:
        """What was lost on the way, one line each."""
        return ()


def make_tracker(plan: Plan, config: Config, wheels: Array | None = None) -> Tracker:
    """Laser where there is one, else wheels, else the camera.

    `wheels` (15,): how the odometry is calibrated, if that is known.
    """
    if plan.scan is not None:
        return LaserFollower(config, wheels)
    if plan.odometry is not None:
        return WheelFollower(plan)
    return CameraFollower(plan, config)


def needs_inertial(plan: Plan) -> bool:
    """Whether the tracker that `make_tracker` chooses looks at inertial samples."""
    return plan.scan is None and plan.odometry is None


class WheelFollower(Tracker):
    """Believes the recorded odometry."""

    def __init__(self, plan: Plan) -> None:
        self._planar = plan.planar

    def follow(self, frames: Iterable[Frame]) -> Followed:
        before = None
        for frame in frames:
            if (pose := frame.odom_from_base) is not None:
                moved, before = np.eye(4) if before is None else between(before, pose), pose
                yield frame, Motion(pose, motion_covariance(moved, planar=self._planar), Odometry())


class CameraFollower(Tracker):
    """Estimates the motion from colour and depth."""

    def __init__(self, plan: Plan, config: Config) -> None:
        from mapmyworld.odometry.tracking_quality import TrackingQuality
        from mapmyworld.odometry.visual_odometry import VisualTracker

        self._start = plan.map_from_first
        self._tracker = VisualTracker(config)
        self._doubts = TrackingQuality()

    def follow(self, frames: Iterable[Frame]) -> Followed:
        for frame, motion in self._tracker.track_all(frames):
            yield frame, self._motion(frame, motion)

    def _motion(self, frame: Frame, motion: VisualMotion) -> Motion:
        self._doubts.add(frame.stamp_ns, motion)
        covariance = np.linalg.inv(motion.information)
        return Motion(
            self._start @ motion.tracker_from_base,
            np.asarray(covariance),
            CameraTracking(motion.verdict, int(motion.inliers)),
        )

    def notes(self) -> tuple[str, ...]:
        return self._doubts.lines()


class LaserFollower(Tracker):
    """Matches each scan against the local map, with the odometry as a prior."""

    def __init__(self, config: Config, wheels: Array | None) -> None:
        """`wheels` (15,): how the odometry is calibrated, if that is known."""
        from mapmyworld.odometry.laser_odometry import LaserTracker

        self._tracker = LaserTracker(config, wheels)

    def follow(self, frames: Iterable[Frame]) -> Followed:
        """Scans that fit nothing wait for the next ones, which say whether tracking is lost."""
        waiting: list[tuple[Frame, Motion]] = []
        for frame, motion, is_open in self._tracked(frames):
            waiting.append((frame, motion))
            if is_open and len(waiting) < AT_ONCE:
                continue
            if motion.is_tracking_loss:
                waiting = _lost_at_first(waiting)
            yield from waiting
            waiting = []
        yield from waiting

    def _tracked(self, frames: Iterable[Frame]) -> Iterator[tuple[Frame, Motion, bool]]:
        """Each frame, its motion, and whether later scans decide if tracking is lost there."""
        for some in batches(frames, AT_ONCE):
            tracked = self._tracker.track_all(some)
            poses = planar_to_matrix(np.stack([moment.pose for moment in tracked]))
            planar = np.stack([moment.covariance for moment in tracked])
            spread = covariance_from_planar(planar, off_plane=_OUT_OF_PLANE)
            for frame, moment, pose, covariance in zip(some, tracked, poses, spread, strict=True):
                # What the scans refute the odometry still bridges: the path is never lost by it.
                lost = moment.is_tracking_loss and frame.odom_from_base is None
                source = LaserTracking(moment.verdict, float(moment.overlap), lost)
                motion = Motion(pose, covariance, source, moment.fits_nothing)
                yield frame, motion, moment.is_open

    def notes(self) -> tuple[str, ...]:
        return self._tracker.notes()

    def losses(self) -> tuple[str, ...]:
        return self._tracker.losses()


def _lost_at_first(waiting: list[tuple[Frame, Motion]]) -> list[tuple[Frame, Motion]]:
    """The same frames, tracking being lost before the first of them instead of before the last."""
    (first, motion), (last, loss) = waiting[0], waiting[-1]
    if len(waiting) == 1:
        return waiting
    return [
        (first, replace(motion, covariance=loss.covariance, source=loss.source)),
        *waiting[1:-1],
        (last, replace(loss, covariance=motion.covariance, source=motion.source)),
    ]
