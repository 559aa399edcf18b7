"""Which tracker follows the robot: by laser, by camera, or by the recorded odometry alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

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
    from mapmyworld.odometry.laser_odometry import LaserTracker
    from mapmyworld.odometry.tracking_quality import TrackingQuality
    from mapmyworld.odometry.visual_odometry import VisualTracker

AT_ONCE = 64
"""Scans that are followed in one go, or wait for later ones."""
_OUT_OF_PLANE = 1e-8  # rad^2 and m^2 by which a planar robot leaves its plane, a step
Followed = Iterator[tuple[Frame, Motion]]


@dataclass(frozen=True, slots=True)
class Tracker:
    """Follows the robot frame by frame."""

    follow: Callable[[Iterable[Frame]], Followed]
    """Each frame with where the robot was; frames of which that cannot be said are left out."""
    notes: Callable[[], tuple[str, ...]] = tuple
    """What the user should know, once all frames have been followed."""
    losses: Callable[[], tuple[str, ...]] = tuple
    """What was lost on the way, one line each."""


def make_tracker(plan: Plan, config: Config, wheels: Array | None = None) -> Tracker:
    """Laser where there is one, else wheels, else the camera.

    `wheels` (56,): how the odometry is calibrated, if that is known.
    """
    if plan.scan is not None:
        from mapmyworld.odometry.laser_odometry import LaserTracker

        laser = LaserTracker(config, wheels)
        return Tracker(partial(_follow_by_laser, laser), laser.notes, laser.losses)
    if plan.odometry is not None:
        return Tracker(partial(_follow_wheels, plan.planar))
    from mapmyworld.odometry.tracking_quality import TrackingQuality
    from mapmyworld.odometry.visual_odometry import VisualTracker

    doubts, camera = TrackingQuality(), VisualTracker(config)
    follow = partial(_follow_by_camera, camera, doubts, plan.map_from_first)
    return Tracker(follow, doubts.lines)


def needs_inertial(plan: Plan) -> bool:
    """Whether the tracker that `make_tracker` chooses looks at inertial samples."""
    return plan.scan is None and plan.odometry is None


def _follow_wheels(planar: bool, frames: Iterable[Frame]) -> Followed:
    """Believes the recorded odometry."""
    before = None
    for frame in frames:
        if (pose := frame.odom_from_base) is not None:
            moved, before = np.eye(4) if before is None else between(before, pose), pose
            yield frame, Motion(pose, motion_covariance(moved, planar=planar), Odometry())


def _follow_by_camera(
    tracker: VisualTracker, doubts: TrackingQuality, start: Array, frames: Iterable[Frame]
) -> Followed:
    """Estimates the motion from colour and depth."""
    for frame, motion in tracker.track_all(frames):
        doubts.add(frame.stamp_ns, motion)
        covariance = np.asarray(np.linalg.inv(motion.information))
        source = CameraTracking(motion.verdict, int(motion.inliers))
        yield frame, Motion(start @ motion.tracker_from_base, covariance, source)


def _follow_by_laser(tracker: LaserTracker, frames: Iterable[Frame]) -> Followed:
    """Matches each scan against the local map, with the odometry as a prior.

    Scans that fit nothing wait for the next ones, which say whether tracking is lost.
    """
    waiting: list[tuple[Frame, Motion]] = []
    for frame, motion, is_open in _tracked(tracker, frames):
        waiting.append((frame, motion))
        if is_open and len(waiting) < AT_ONCE:
            continue
        if motion.is_tracking_loss:
            waiting = _lost_at_first(waiting)
        yield from waiting
        waiting = []
    yield from waiting


def _tracked(
    tracker: LaserTracker, frames: Iterable[Frame]
) -> Iterator[tuple[Frame, Motion, bool]]:
    """Each frame, its motion, and whether later scans decide if tracking is lost there."""
    for some in batches(frames, AT_ONCE):
        tracked = tracker.track_all(some)
        poses = planar_to_matrix(np.stack([moment.pose for moment in tracked]))
        planar = np.stack([moment.covariance for moment in tracked])
        spread = covariance_from_planar(planar, off_plane=_OUT_OF_PLANE)
        for frame, moment, pose, covariance in zip(some, tracked, poses, spread, strict=True):
            # What the scans refute the odometry still bridges: the path is never lost by it.
            lost = moment.is_tracking_loss and frame.odom_from_base is None
            source = LaserTracking(moment.verdict, float(moment.overlap), lost)
            yield frame, Motion(pose, covariance, source, moment.fits_nothing), moment.is_open


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
