"""The part of the plan that diagnoses: clocks, gaps, tf, missing values."""

from __future__ import annotations

import numpy as np

from mapmyworld.sensing.plan import CameraSource, Draft, OdometrySource, ScanSource
from mapmyworld.sensing.plan_lasers import share_of, valid_ranges
from mapmyworld.sensing.survey import Stream
from mapmyworld.types import LaserScanMessage, MessageKind

_CLOCKS_APART = 1.0  # s between the sensors' clocks from which they cannot be one clock
_GAP = 1.0  # s without a message of a sensor that is worth a word


def used_streams(
    draft: Draft,
    scan: ScanSource | None,
    camera: CameraSource | None,
    odometry: OdometrySource | None,
) -> list[Stream]:
    """The streams that the plan relies on."""
    topics = [scan.topic] if scan else []
    topics += [camera.colour_topic, camera.depth_topic] if camera else []
    topics += [odometry.name] if odometry else []
    return [draft.survey.streams[t] for t in topics if t in draft.survey.streams]


def choose_clock(
    draft: Draft,
    scan: ScanSource | None,
    camera: CameraSource | None,
    odometry: OdometrySource | None,
) -> bool:
    """Whether to use log time because the header stamps cannot be one clock."""
    streams = used_streams(draft, scan, camera, odometry)
    stamped = [s for s in streams if s.last_stamp_ns]
    if not stamped:
        if streams:
            draft.decide("clock", "log time", "the messages carry no header stamps")
            draft.losses.append("no header stamps: log time is used, which jitters")
        return True
    latencies = {s.topic: s.latency_s for s in stamped}
    spread = max(latencies.values()) - min(latencies.values())
    if len(stamped) < len(streams) or spread > _CLOCKS_APART:
        worst = ", ".join(f"{t} {v:+.3f} s" for t, v in sorted(latencies.items()))
        draft.decide("clock", "log time", f"header stamps disagree with one another: {worst}")
        draft.losses.append(f"the sensors' clocks disagree ({worst}): log time is used instead")
        return True
    draft.decide("clock", "header stamps", f"sensors agree within {spread:.3f} s")
    return False


def check_tree(draft: Draft) -> None:
    """Words about tf: slashes, no static topic, a localiser, two parents."""
    tree = draft.tree
    if tree.had_leading_slashes:
        draft.warnings.append("frame names with a leading slash: read without it")
    dynamic = [e for e in tree.edges() if not e.static]
    if dynamic and not any(e.static for e in tree.edges()):
        draft.warnings.append("no /tf_static: fixed transforms are taken from /tf")
    for edge in tree.edges():
        if edge.parent == "map" and not edge.static:
            draft.warnings.append(
                f"a localiser was running (tf map -> {edge.child}, {edge.count}x): not used"
            )
    draft.warnings.extend(f"tf: {line}" for line in tree.ignored.values())


def check_streams(
    draft: Draft,
    scan: ScanSource | None,
    camera: CameraSource | None,
    odometry: OdometrySource | None,
) -> None:
    """Words about silence, steps back in time, gaps and missing values of what is used."""
    used = used_streams(draft, scan, camera, odometry)
    for stream in used:
        _check_stream(draft, stream)
    for topic, doubt in draft.survey.info.doubts:
        (draft.losses if topic in {s.topic for s in used} else draft.warnings).append(doubt)
    for topic in draft.survey.info.topics:
        if topic.count == 0 and topic.kind is not MessageKind.OTHER:
            draft.warnings.append(f"{topic.topic} ({topic.kind}) is silent: announced, no message")
    if scan is not None:
        _check_ranges(draft, draft.survey.streams[scan.topic])


def _check_stream(draft: Draft, stream: Stream) -> None:
    if stream.backward_steps:
        draft.warnings.append(
            f"{stream.topic}: header stamps step back {stream.backward_steps} times, by up to "
            f"{stream.largest_backward_ns * 1e-9:.3f} s; the order of the log is kept"
        )
    if stream.largest_gap_ns * 1e-9 > max(_GAP, 10.0 / max(stream.frequency, 1e-3)):
        draft.warnings.append(
            f"{stream.topic}: silent for {stream.largest_gap_ns * 1e-9:.1f} s at one place"
        )
    if stream.undecodable:
        draft.losses.append(
            f"{stream.topic}: {stream.undecodable} of the messages looked at cannot be decoded, or "
            "hold numbers that are not finite: left out"
        )
    _check_ends(draft, stream)


def _check_ends(draft: Draft, stream: Stream) -> None:
    """Words about a sensor that starts late or stops early."""
    longest_s = max(_GAP, 10.0 / max(stream.frequency, 1e-3))
    late_s = (stream.first_log_ns - draft.survey.info.start_ns) * 1e-9
    early_s = (draft.survey.end_ns - stream.last_log_ns) * 1e-9
    if late_s > longest_s:
        draft.warnings.append(f"{stream.topic}: begins {late_s:.1f} s after the log does")
    if early_s > longest_s:
        draft.warnings.append(
            f"{stream.topic}: falls silent {early_s:.1f} s before the log ends: was its driver "
            "stopped, or its cable loose?"
        )


def _check_ranges(draft: Draft, stream: Stream) -> None:
    scans = [m for m in stream.samples if isinstance(m, LaserScanMessage)]
    nan = float(np.mean([share_of(np.isnan(s.ranges)) for s in scans])) if scans else 0.0
    if nan:
        draft.warnings.append(f"{stream.topic}: {nan:.0%} of the sampled ranges are NaN: left out")
    if scans and not np.any([np.any(valid_ranges(s)) for s in scans]):
        draft.losses.append(f"{stream.topic}: the sampled scans hold no usable range")
