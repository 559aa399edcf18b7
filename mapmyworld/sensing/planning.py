"""Deciding: the rules of the plan in the order in which they build on one another."""

from __future__ import annotations

import difflib

from mapmyworld.config import SensingConfig
from mapmyworld.errors import ConfigError, LogError
from mapmyworld.sensing import plan_base, plan_cameras, plan_checks, plan_lasers, plan_motion
from mapmyworld.sensing.order import check_stamps, choose_order
from mapmyworld.sensing.plan import Draft, OdometrySource, Plan
from mapmyworld.sensing.plan_more_cameras import choose_more_cameras
from mapmyworld.sensing.survey import Survey
from mapmyworld.types import MessageKind

_IMAGES = {MessageKind.IMAGE}
# Setting -> kinds of topics that it may name, and what they are called.
_ROLES = {
    "scan_topic": ({MessageKind.LASER_SCAN, MessageKind.POINT_CLOUD}, "scans"),
    "odometry_topic": ({MessageKind.ODOMETRY}, "odometry"),
    "colour_topic": (_IMAGES, "images"),
    "depth_topic": (_IMAGES, "images"),
    "camera_info_topic": ({MessageKind.CAMERA_INFO}, "camera infos"),
}


def make_plan(survey: Survey, config: SensingConfig) -> Plan:
    """Decides from a survey; raises `LogError` with every problem when no map can be made."""
    draft = Draft(survey, config)
    if not any(stream.count for stream in survey.streams.values()):
        raise LogError(
            f"{survey.info.paths[0]}: the log holds no message that mapping can use",
            problems=survey.info.problems,
        )
    _check_topics(draft)
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
        raise LogError(
            f"{', '.join(survey.info.paths)}: no map can be made: the log has neither a laser scan "
            "nor colour with depth that can be used",
            problems=list(dict.fromkeys([*draft.problems, *draft.losses, *survey.info.problems])),
        )
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
        losses=(*survey.info.problems, *draft.losses),
        more_cameras=more_cameras,
    )
    return plan.with_odometry_shifted(config.odometry_offset) if config.odometry_offset else plan


def _check_topics(draft: Draft) -> None:
    """Raises `ConfigError` with every topic that is set and of which the log holds no message."""
    problems = list[str]()
    for name, (kinds, plural) in _ROLES.items():
        wanted = getattr(draft.config, name)
        known = sorted(s.topic for kind in kinds for s in draft.survey.of_kind(kind))
        no_topic = name == "odometry_topic" and (wanted == "none" or wanted.startswith("tf"))
        if not wanted or no_topic or wanted in known:
            continue
        near = difflib.get_close_matches(wanted, known, n=1, cutoff=0.5)
        hint = f"; did you mean {near[0]}?" if near else ""
        problems.append(
            f"sensing.{name} = {wanted!r} is not in the log; {plural}: "
            f"{', '.join(known) or 'none'}{hint}"
        )
    if problems:
        raise ConfigError("topics are set that the log does not have:", problems=problems)
