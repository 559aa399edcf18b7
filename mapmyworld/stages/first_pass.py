"""What a log shows when its laser is followed a first time, before the map is made.

Its odometry's calibration. Where there is none, how the robot moved within sweeps: one that is not
deskewed is bent, and shows where the robot was half a sweep after the stamp.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.parallel import batches
from mapmyworld.sensing import Plan, read_frames
from mapmyworld.sensing.motion import MotionRecorder
from mapmyworld.stages.plan_log import stage_of_log
from mapmyworld.stages.trackers import AT_ONCE
from mapmyworld.types import Frame, LogSource, Progress


def wheels_of_log(log: LogSource, plan: Plan, config: Config, progress: Progress) -> Array | None:
    """(52,) how the log's odometry is calibrated; None where no laser shows that."""
    if plan.scan is None or plan.odometry is None:
        return None
    from mapmyworld.odometry.wheel_calibration import calibrated_wheels

    return calibrated_wheels(_by_laser("calibrate odometry", log, plan, config, progress), config)


def deskewed(log: LogSource, plan: Plan, config: Config, progress: Progress) -> Plan:
    """The plan with the laser's own motion where beams are timed and there is no odometry."""
    if plan.odometry is not None or plan.scan is None or not plan.scan.beams_are_timed:
        return plan
    from mapmyworld.odometry.laser_odometry import LaserTracker

    tracker, motion = LaserTracker(config), MotionRecorder()
    for frames in _by_laser("deskew sweeps", log, plan, config, progress):
        for frame, moment in zip(frames, tracker.track_all(frames), strict=True):
            motion.add(frame.stamp_ns, planar_to_matrix(moment.pose))
    return replace(plan, sweep_motion=motion.finish())


def _by_laser(
    stage: str, log: LogSource, plan: Plan, config: Config, progress: Progress
) -> Iterator[list[Frame]]:
    """Frames in groups, without images and inertial samples."""
    plan, watch = replace(plan, camera=None, more_cameras=()), stage_of_log(stage, log, progress)
    return batches(read_frames(log, plan, config.sensing, watch=watch, inertial=False), AT_ONCE)
