"""Deciding: the rules of the plan in the order in which they build on one another."""

from __future__ import annotations

from mapmyworld.config import SensingConfig
from mapmyworld.errors import LogError
from mapmyworld.sensing import plan_base, plan_cameras, plan_checks, plan_lasers, plan_motion
from mapmyworld.sensing.order import check_stamps, choose_order
from mapmyworld.sensing.plan import Draft, OdometrySource, Plan
from mapmyworld.sensing.plan_more_cameras import choose_more_cameras
from mapmyworld.sensing.plan_topics import check_topics
from mapmyworld.sensing.survey import Survey


def make_plan(survey: Survey, config: SensingConfig) -> Plan:
    """Decides from a survey; raises `LogError` with every problem when no map can be made."""
    draft = Draft(survey, config)
    if not any(stream.count for stream in survey.streams.values()):
        raise LogError(
            f"{survey.info.paths[0]}: the log holds no message that mapping can use",
            problems=list(dict.fromkeys([*survey.info.problems, *survey.losses])),
        )
    check_topics(draft)
    base = plan_base.choose_base(draft)
    odometry = plan_motion.choose_odometry(draft, base)
    scan = plan_lasers.choose_scan(draft, base)
    camera = plan_cameras.choose_camera(draft, base)
    more_cameras = choose_more_cameras(draft, base, camera)
    plan_checks.check_tree(draft)
    used = plan_checks.used_streams(draft, scan, camera, odometry)
    sort_ns, odometry = choose_order(draft, used, odometry)
    use_log_time = plan_checks.choose_clock(draft, used) if not sort_ns else False
    if use_log_time and odometry is not None:
        odometry = OdometrySource(odometry.name, odometry.motion.on_log_time())
    if not (sort_ns or use_log_time):
        check_stamps(draft, used)
    plan_checks.check_streams(draft, used, scan, sorted_by_stamp=sort_ns > 0)
    if scan is None and camera is None:
        _refuse(draft)
    plan = Plan(
        scan=scan,
        camera=camera,
        odometry=odometry,
        imu=plan_motion.choose_imu(draft, base),
        ground_truth_topic=plan_motion.choose_ground_truth(draft),
        gps_topic=plan_motion.choose_gps(draft),
        base_frame=base,
        map_from_first=plan_cameras.first_pose(camera, scan),
        planar=plan_motion.is_planar(draft, odometry, scan),
        use_log_time=use_log_time,
        decisions=tuple(draft.decisions),
        warnings=tuple(draft.warnings),
        sort_ns=sort_ns,
        losses=(*survey.losses, *draft.losses),
        more_cameras=more_cameras,
    )
    return plan.with_odometry_shifted(config.odometry_offset) if config.odometry_offset else plan


def _refuse(draft: Draft) -> None:
    paths = ", ".join(draft.survey.info.paths)
    raise LogError(
        f"{paths}: no map can be made: the log has neither a laser scan nor colour with depth "
        "that can be used",
        problems=list(dict.fromkeys([*draft.problems, *draft.losses, *draft.survey.losses])),
    )
