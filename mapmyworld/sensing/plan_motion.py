"""The part of the plan that decides odometry and what else reports motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mapmyworld.errors import ConfigError
from mapmyworld.geometry.rigid import between
from mapmyworld.sensing.motion import RecordedMotion
from mapmyworld.sensing.plan import Draft, ImuSource, OdometrySource, ScanSource
from mapmyworld.sensing.plan_base import BASES, ODOMS, WORLDS
from mapmyworld.sensing.sensor_mounts import by_tf
from mapmyworld.sensing.stalls import without_losses, without_resets, without_stalls
from mapmyworld.sensing.transforms import frame_name, is_called
from mapmyworld.types import ImuMessage, MessageKind

_SLOPE = 0.06  # rad for some seconds; thresholds, turns and braking stay below
_FLAT = 0.02  # metres of height, radians of roll and pitch that a planar robot stays within


def choose_odometry(draft: Draft, base: str) -> OdometrySource | None:
    """A topic whose child is the base, else tf odom -> base, else none.

    Raises `ConfigError` where the topic that is asked for reports no motion of the base.
    """
    wanted = draft.config.odometry_topic
    if wanted == "none":
        draft.decide("odometry", "", "switched off by sensing.odometry_topic")
        return None
    candidates = every = _candidates(draft, base)
    if wanted:
        candidates = [c for c in every if wanted in {c[1].name, c[1].name.split()[0]}]
        if not candidates:
            found = ", ".join(sorted(c[1].name for c in every)) or "none"
            raise ConfigError(
                f"sensing.odometry_topic = {wanted!r} reports no motion of {base}; "
                f"topics that do: {found}. Name the right one, or omit the setting"
            )
    if not candidates:
        draft.decide("odometry", "", "no odometry topic and no moving tf above the base")
        draft.warnings.append(
            "no odometry in the log: the motion is estimated from the sensors alone"
        )
        return None
    ranked = sorted(candidates, key=lambda item: (-item[0], item[1].name))
    best = ranked[0][1]
    others = tuple(f"{source.name}: {why}" for _, source, why in ranked[1:])
    draft.decide("odometry", best.name, ranked[0][2], others)
    _check_child(draft, best, base)
    motion, stalls = without_stalls(best.motion)
    if stalls:
        draft.warnings.append(
            f"{best.name} repeats a pose and then catches up in one step, {stalls} times: "
            "interpolated"
        )
    motion, resets = without_resets(motion)
    if resets:
        draft.warnings.append(
            f"{best.name} jumps farther than the robot can drive, {resets} times, as if it were "
            "reset: continued from the pose before each jump"
        )
    motion, losses = without_losses(motion)
    if losses:
        draft.warnings.append(
            f"{best.name} is silent while the robot drives, and goes on as if it had stood, "
            f"{losses} times: interpolated"
        )
    return replace(best, motion=motion)


def _check_child(draft: Draft, odometry: OdometrySource, base: str) -> None:
    """Words about odometry of another frame, of which tf does not say where on the base it is."""
    child = frame_name(draft.survey.odometry_frames.get(odometry.name, ("", ""))[1])
    if not child or child == base or draft.survey.tree.chain(child, base) is not None:
        return
    alike = is_called(child, BASES) and is_called(base, BASES)
    (draft.warnings if alike else draft.losses).append(
        f"no transform from {child} to {base}: {odometry.name} is assumed to measure the motion "
        f"of {base}; record /tf_static, or set sensing.base_frame"
    )


def _candidates(draft: Draft, base: str) -> list[tuple[float, OdometrySource, str]]:
    found = []
    for topic, motion in draft.survey.odometry.items():
        score, why, motion_of_base = _judge_topic(draft, topic, motion, base)
        together = _share_with_scans(draft, motion)
        if together > 0:
            score, why = score + together, f"{why}, {together:.0%} of the scans share its stamps"
        source = OdometrySource(topic, motion_of_base)
        found.append((score, source, why))
    edge = draft.survey.tree.edge_to(base)
    if edge is not None and edge.motion is not None and not is_called(edge.parent, WORLDS):
        source = OdometrySource(f"tf {edge.parent} -> {base}", edge.motion)
        score = 3.0 if is_called(edge.parent, ODOMS) else 1.5
        found.append((score, source, f"{len(edge.motion)} transforms"))
    still = [source.name for _, source, _ in found if not source.motion.moves]
    draft.warnings += [f"{name} reports that the robot never moved: left out" for name in still]
    return [item for item in found if item[1].motion.moves]


def _share_with_scans(draft: Draft, motion: RecordedMotion) -> float:
    """Share of the laser's scans that have a pose of exactly their stamp: no interpolation."""
    streams = draft.survey.of_kind(MessageKind.LASER_SCAN)
    stamps = np.concatenate(
        [np.array(s.stamps_ns, np.int64) for s in streams] or [np.zeros(0, np.int64)]
    )
    return float(np.mean(np.isin(stamps, motion.stamps_ns))) if len(stamps) else 0.0


def _judge_topic(
    draft: Draft, topic: str, motion: RecordedMotion, base: str
) -> tuple[float, str, RecordedMotion]:
    child = frame_name(draft.survey.odometry_frames[topic][1])
    rate = draft.survey.streams[topic].frequency
    why = f"{len(motion)} poses at {rate:.1f} Hz of {child or 'an unnamed frame'}"
    name = topic.rsplit("/", 1)[-1].lower()
    preference = 0.5 if name in {"odom", "odometry"} or "filtered" in topic else 0.0
    if child == base:
        return 4.0 + preference, why, motion
    if not child or draft.survey.tree.chain(child, base) is None:
        return 2.0 + preference, f"{why}, taken for {base}: tf does not connect them", motion
    offset = draft.survey.tree.lookup(child, base, 0)
    if offset is None or not draft.survey.tree.is_fixed(child, base):
        return 1.0, f"{why}, which moves against {base}", motion
    return 3.5 + preference, f"{why}, carried over to {base} by tf", motion.followed_by(offset)


def choose_ground_truth(draft: Draft) -> str:
    """The topic of a recorded true pose; used for scores only, never for mapping."""
    for stream in draft.survey.of_kind(MessageKind.POSE):
        if "truth" in stream.topic or stream.topic.rsplit("/", 1)[-1] in {"gt", "mocap"}:
            draft.decide("ground truth", stream.topic, "stored for scores, not used to map")
            return stream.topic
    return ""


def choose_gps(draft: Draft) -> str:
    """The topic of the receiver with the most fixes; empty without any."""
    best = draft.survey.fullest(MessageKind.GPS)
    if best is None:
        return ""
    draft.decide("gps", best.topic, f"{best.count} fixes, stored with the nodes, not used to map")
    return best.topic


def choose_imu(draft: Draft, base: str) -> ImuSource | None:
    """The IMU with the most samples, when tf indicates how it is mounted."""
    best = draft.survey.fullest(MessageKind.IMU)
    if best is None:
        return None
    sample = best.first(ImuMessage)
    frame = frame_name(sample.frame_id) if sample else ""
    mount = by_tf(draft, base, frame or base)
    if mount.is_loose:
        draft.decide("imu", "", f"{best.topic}: {frame} moves against {base}")
        return None
    if mount.is_assumed:
        draft.decide("imu", "", f"{best.topic}: tf does not say how {frame} is mounted")
        draft.losses.append(
            f"{best.topic} is left out: tf does not say how {frame} is mounted on {base}; record "
            "/tf_static"
        )
        return None
    draft.decide("imu", best.topic, f"{best.count} samples at {best.frequency:.0f} Hz")
    return ImuSource(best.topic, mount.base_from_sensor)


def is_planar(draft: Draft, odometry: OdometrySource | None, scan: ScanSource | None) -> bool:
    """Flat when the odometry stays in a plane; without odometry, when there is a laser."""
    if odometry is None:
        flat = scan is not None
        reason = "a planar laser and no odometry" if flat else "a camera without odometry"
    else:
        poses = odometry.motion.poses_at(slice(None, None, max(len(odometry.motion) // 2000, 1)))
        moved = between(poses[0], poses)
        height = float(np.abs(moved[:, 2, 3]).max())
        tilt = float(np.arccos(np.clip(moved[:, 2, 2].min(), -1.0, 1.0)))
        flat = height < _FLAT and tilt < _FLAT
        reason = f"odometry rises {height:.3f} m and tilts {np.degrees(tilt):.2f} deg at most"
    draft.decide("dimensions", "2D" if flat else "3D", reason)
    for topic, slope in sorted(draft.survey.slopes.items()):
        if flat and slope > _SLOPE:
            draft.losses.append(
                f"{topic} measures slopes of up to {np.degrees(slope):.1f} deg, but the map is "
                "flat: map each level by itself"
            )
    return flat
