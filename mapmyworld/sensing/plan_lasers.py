"""The part of the plan that chooses the laser scan, or the 3D lidar whose slice serves as one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import LogError
from mapmyworld.sensing.cloud_scans import points_of_cloud, scan_of_points, view_of
from mapmyworld.sensing.plan import Draft, ScanSource
from mapmyworld.sensing.sensor_mounts import Mount, check_joint, mount_of
from mapmyworld.sensing.survey import Stream
from mapmyworld.sensing.sweeps import valid_ranges
from mapmyworld.sensing.transforms import frame_name
from mapmyworld.types import LaserScanMessage, MessageKind, PointCloudMessage

_TILTED = 0.17  # rad from level beyond which a laser does not see walls as walls
_FAULTY = -1.0  # of a laser that could serve if it were sound: a loss; 0: one made for else
_LEAST_BEAMS = 2  # a single one is a range finder's
_WHOLE = 6.3  # rad, more than which no two beams lie apart
_TWICE_ROUND = 2 * _WHOLE  # rad from the first beam to the last that no sweep spans
_LONGEST_SWEEP = 2.0  # times that from one sweep to the next; longer in other units than seconds
_NARROW = 2.0  # rad that clouds show at least where they are a lidar's and not a camera's
_AFTER_SCANS = 1e-4  # weight of clouds: any usable laser comes first


def choose_scan(draft: Draft, base: str) -> ScanSource | None:
    """The planar laser with the widest view and the most returns, else a 3D lidar; or None."""
    if not draft.config.use_scans:
        draft.decide("scan", "", "switched off by sensing.use_scans")
        return None
    ranked = sorted(
        ((*_judge(draft, stream, base), stream) for stream in _streams(draft)),
        key=lambda item: (-item[0], len(item[2].topic), item[2].topic),
    )
    ranked = [item for item in ranked if item[0] > 0] or ranked
    if not ranked or ranked[0][0] <= 0:
        for score, why, stream in ranked:
            (draft.losses if score == _FAULTY else draft.problems).append(f"{stream.topic}: {why}")
        draft.problems += [] if ranked else ["no laser scan topic and no 3D lidar in the log"]
        draft.decide("scan", "", ranked[0][1] if ranked else "no laser scan in the log")
        return None
    _, why, stream = ranked[0]
    others = tuple(f"{other.topic}: {reason}" for _, reason, other in ranked[1:])
    draft.decide("scan", stream.topic, why, others)
    return _source(draft, stream, base)


def _streams(draft: Draft) -> list[Stream]:
    streams = draft.survey.of_kind(MessageKind.LASER_SCAN)
    streams += draft.survey.of_kind(MessageKind.POINT_CLOUD)
    wanted = draft.config.scan_topic
    return [s for s in streams if wanted in {"", s.topic}]


def _judge(draft: Draft, stream: Stream, base: str) -> tuple[float, str]:
    if stream.kind is MessageKind.POINT_CLOUD:
        return _judge_clouds(draft, stream, base)
    scans = [m for m in stream.samples if isinstance(m, LaserScanMessage)]
    if not scans:
        return _FAULTY, "none of its messages can be decoded"
    scan = scans[0]
    field = abs(scan.angle_increment) * len(scan.ranges)
    returns = float(np.mean([valid_ranges(s).sum() / max(len(s.ranges), 1) for s in scans]))
    mount = mount_of(draft, base, scan.frame_id, "scan")
    tilt = float(np.arccos(np.clip(abs(mount.base_from_sensor[2, 2]), -1.0, 1.0)))
    why = (
        f"{stream.count} scans at {stream.frequency:.1f} Hz, {len(scan.ranges)} beams over "
        f"{np.degrees(field):.0f} deg, {returns:.0%} returns"
    )
    if tilt > _TILTED:
        return 0.0, f"{why}; tilted by {np.degrees(tilt):.0f} deg: not a level scan"
    fault = _fault_of(scans)
    if fault:
        return _FAULTY, f"{why}; {fault}"
    if not stream.frequency:
        return _FAULTY, f"{why}; a map needs scans of at least two times"
    if not returns:
        return _FAULTY, f"{why}; no range in the log is usable"
    return field * min(stream.frequency, 10.0) * (0.2 + returns) * _trust(mount), why


def _trust(mount: Mount) -> float:
    """Share that a laser counts by how well it is known where it sits."""
    return 0.1 if mount.is_loose else 0.5 if mount.is_assumed else 1.0


def _fault_of(scans: list[LaserScanMessage]) -> str:
    """What makes scans indicate nothing about directions; empty where they do."""
    if all(len(s.ranges) < _LEAST_BEAMS for s in scans):
        return f"a scan needs {_LEAST_BEAMS} beams at least"
    if not any(np.isfinite(s.angle_min) and 0 < abs(s.angle_increment) < _WHOLE for s in scans):
        return (
            f"angle_increment {scans[0].angle_increment:g} rad: all beams would point one way; "
            "correct what the driver writes, (angle_max - angle_min) / (beams - 1)"
        )
    if all(abs(s.angle_increment) * len(s.ranges) > _TWICE_ROUND for s in scans):
        return "its beams span more than two turns: record its angles in radians, not degrees"
    return ""


def _judge_clouds(draft: Draft, stream: Stream, base: str) -> tuple[float, str]:
    """A 3D lidar, after every laser; a camera's points are none, its images serve better."""
    clouds = [m for m in stream.samples if isinstance(m, PointCloudMessage) and len(m.points)]
    if not clouds:
        return 0.0, "none of its messages holds a point"
    mount = mount_of(draft, base, clouds[0].frame_id, "scan")
    view = max(_view(draft, cloud, mount.base_from_sensor) for cloud in clouds)
    why = (
        f"{stream.count} clouds at {stream.frequency:.1f} Hz; between sensing.cloud_lowest and "
        f"cloud_highest they show {np.degrees(view):.0f} deg"
    )
    if view < _NARROW:
        return 0.0, f"{why}: field of view too narrow for a lidar"
    return _AFTER_SCANS * view * min(stream.frequency, 10.0) * _trust(mount), why


def _view(draft: Draft, cloud: PointCloudMessage, mount: NDArray[np.float64]) -> float:
    try:
        points = points_of_cloud(cloud, mount, draft.config)
    except LogError:
        return 0.0
    return view_of(scan_of_points(points, mount, draft.config))


def _source(draft: Draft, stream: Stream, base: str) -> ScanSource:
    scan = next(m for m in stream.samples if isinstance(m, LaserScanMessage | PointCloudMessage))
    timed = isinstance(scan, LaserScanMessage) and _is_timed(scan, stream)
    mount = mount_of(draft, base, scan.frame_id, "scan")
    check_joint(draft, base, scan.frame_id, mount)
    if mount.is_assumed:
        draft.losses.append(
            f"no transform from {base} to {frame_name(scan.frame_id) or 'the laser'}: the laser is "
            'assumed to sit at the base; set sensing.scan_mount = "x y z roll pitch yaw"'
        )
    if isinstance(scan, PointCloudMessage):
        draft.losses.append(
            f"{stream.topic}: 3D points serve as flat scans between sensing.cloud_lowest and "
            "cloud_highest; slopes, floors and the motion within a sweep are ignored"
        )
    elif not timed:
        draft.warnings.append(
            f"{stream.topic} does not say when each beam was taken (time_increment "
            f"{scan.time_increment:g}): sweeps are deskewed if turns of the robot show it"
        )
    is_cloud = isinstance(scan, PointCloudMessage)
    return ScanSource(stream.topic, mount.base_from_sensor, timed, is_cloud)


def _is_timed(scan: LaserScanMessage, stream: Stream) -> bool:
    """Whether its beams have times that a sweep can have: it ends before the next but one."""
    steps = max(stream.count - 1, 1)
    period = 1e-9 * (stream.latest_stamp_ns - (stream.first_stamp_ns or 0)) / steps
    period = period or 1.0 / stream.frequency
    return bool(0.0 < scan.time_increment * len(scan.ranges) < _LONGEST_SWEEP * period)
