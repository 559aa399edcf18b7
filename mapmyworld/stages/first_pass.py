"""What a log shows when its laser is followed a first time, before the map is made.

Its odometry's calibration, and how fast the laser sweeps where it does not say. Without odometry,
how the robot moved within sweeps: one that is not deskewed is bent, and shows where the robot was
half a sweep after the stamp.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from mapmyworld.config import Config
from mapmyworld.decisions import decided
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.parallel import batches
from mapmyworld.sensing import Plan, read_frames
from mapmyworld.sensing.motion import MotionRecorder, RecordedMotion
from mapmyworld.sensing.plan import Decision, ScanSource
from mapmyworld.sensing.synchronise import scans_near
from mapmyworld.stages.plan_log import stage_of_log
from mapmyworld.stages.trackers import AT_ONCE
from mapmyworld.types import Frame, LogSource, Progress


def wheels_of_log(log: LogSource, plan: Plan, config: Config, progress: Progress) -> Array | None:
    """(56,) how the log's odometry is calibrated; None where no laser shows that."""
    if plan.scan is None or plan.odometry is None:
        return None
    from mapmyworld.odometry.wheel_calibration import calibrated_wheels

    return calibrated_wheels(_by_laser("calibrate", log, plan, config, progress), config)


def deskewed(log: LogSource, plan: Plan, config: Config, progress: Progress) -> Plan:
    """The plan with what sweeps are deskewed by.

    The laser's own motion, where there is no odometry; and how fast it sweeps, where its messages
    do not say.
    """
    scan = plan.scan
    if scan is None or scan.is_cloud:
        return plan
    motion = plan.odometry.motion if plan.odometry else _own_motion(log, plan, config, progress)
    if plan.odometry is None:
        plan = replace(plan, sweep_motion=motion)
    if scan.beams_are_timed or not len(motion):
        return plan
    return _with_beam_times(log, plan, scan, motion, config, progress)


def _own_motion(log: LogSource, plan: Plan, config: Config, progress: Progress) -> RecordedMotion:
    """The motion of a laser whose sweeps are as they are."""
    from mapmyworld.odometry.laser_odometry import LaserTracker

    tracker, motion = LaserTracker(config), MotionRecorder()
    for frames in _by_laser("deskew sweeps", log, plan, config, progress):
        for frame, moment in zip(frames, tracker.track_all(frames), strict=True):
            motion.add(frame.stamp_ns, planar_to_matrix(moment.pose))
    return motion.finish()


def _with_beam_times(
    log: LogSource, plan: Plan, scan: ScanSource, motion: RecordedMotion, config: Config,
    progress: Progress,
) -> Plan:  # fmt: skip
    """The plan with how fast its laser sweeps, where turns show it, and what was found of that."""
    from mapmyworld.odometry.beam_times import beam_times, turning_moments
    from mapmyworld.places.node_drift import SIGMAS

    moments, watch = turning_moments(motion), stage_of_log("calibrate", log, progress)
    nearest = scans_near(log, plan, moments.ravel(), config.sensing, watch)
    pairs = [(a, b) for a, b in zip(nearest[::2], nearest[1::2], strict=True) if a and b]
    found = beam_times(pairs, scan.base_from_lidar, motion, config.registration)
    choice, seconds, reason = "", 0.0, "no pair of scans where the robot turns"
    if found.pairs:
        measured = f"{1e3 * found.seconds:.1f} +- {1e3 * found.sigma:.1f} ms per radian"
        reason = f"{measured} by {found.pairs} pairs of scans where the robot turns"
    if abs(found.seconds) > SIGMAS * found.sigma:
        choice, seconds = "measured", found.seconds
    decided("plan", f"beam times: {choice or 'none'}: {reason}")
    progress.note(f"sweeps are {'' if choice else 'not '}deskewed: {reason}")
    return replace(
        plan,
        scan=replace(scan, seconds_a_radian=seconds),
        decisions=(*plan.decisions, Decision("beam times", choice, reason)),
    )


def _by_laser(
    stage: str, log: LogSource, plan: Plan, config: Config, progress: Progress
) -> Iterator[list[Frame]]:
    """Frames in groups, without images and inertial samples."""
    plan, watch = replace(plan, camera=None, more_cameras=()), stage_of_log(stage, log, progress)
    return batches(read_frames(log, plan, config.sensing, watch=watch, inertial=False), AT_ONCE)
