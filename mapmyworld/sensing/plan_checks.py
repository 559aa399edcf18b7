"""The part of the plan that diagnoses: clocks, gaps, tf, missing values."""

from __future__ import annotations

import numpy as np

from mapmyworld.sensing.plan import CameraSource, Draft, OdometrySource, ScanSource
from mapmyworld.sensing.silence import check_silence
from mapmyworld.sensing.survey import Stream
from mapmyworld.sensing.transforms import is_called
from mapmyworld.types import LaserScanMessage, MessageKind

_CLOCKS_APART = 1.0  # s between the sensors' clocks from which they cannot be one clock


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


def choose_clock(draft: Draft, streams: list[Stream]) -> bool:
    """Whether to use log time because the header stamps of what is used cannot be one clock."""
    stamped = [s for s in streams if _is_stamped(s)]
    if not stamped:
        if streams:
            draft.decide("clock", "log time", "the messages carry no header stamps")
            draft.losses.append("no header stamps: log time is used, which jitters")
        return True
    latencies = {s.topic: 1e-9 * float(np.median(s.offsets_ns or [0])) for s in stamped}
    spread = max(latencies.values()) - min(latencies.values())
    if len(stamped) < len(streams):
        silent = ", ".join(s.topic for s in streams if s not in stamped)
        draft.decide("clock", "log time", f"{silent}: no header stamps, or always the same one")
        draft.losses.append(
            f"{silent}: header stamps are missing (0), or always the same: log time is used for "
            "all sensors, which jitters; have the driver fill header.stamp"
        )
        return True
    if spread > _CLOCKS_APART:
        worst = ", ".join(f"{t} {v:+.3f} s" for t, v in sorted(latencies.items()))
        draft.decide("clock", "log time", f"header stamps disagree with one another: {worst}")
        draft.losses.append(f"the sensors' clocks disagree ({worst}): log time is used instead")
        return True
    draft.decide("clock", "header stamps", f"sensors agree within {spread:.3f} s")
    return False


def _is_stamped(stream: Stream) -> bool:
    return bool(stream.last_stamp_ns) and (
        stream.count < 2
        or stream.latest_stamp_ns != stream.first_stamp_ns
        or stream.backward_steps > 0
    )


def check_tree(draft: Draft) -> None:
    """Words about tf: slashes, no static topic, a localiser, two parents."""
    tree = draft.survey.tree
    if tree.had_leading_slashes:
        draft.warnings.append("frame names with a leading slash: read without it")
    if tree.edges() and not any(e.static for e in tree.edges()):
        some = any(e.is_fixed for e in tree.edges())
        said = "fixed transforms are taken from /tf" if some else "no transform in the log is fixed"
        draft.warnings.append(f"no /tf_static: {said}")
    for edge in tree.edges():
        if is_called(edge.parent, ("map",)) and not edge.static:
            draft.warnings.append(
                f"a localiser was running (tf {edge.parent} -> {edge.child}, {edge.count}x): "
                "not used"
            )
    draft.warnings.extend(f"tf: {line}" for line in tree.ignored.values())


def check_streams(
    draft: Draft, used: list[Stream], scan: ScanSource | None, *, sorted_by_stamp: bool
) -> None:
    """Words about silence, steps back in time, gaps and missing values of what is used."""
    for stream in used:
        if stream.undecodable:
            draft.losses.append(
                f"{stream.topic}: {stream.undecodable} of the messages looked at cannot be "
                "decoded, or hold numbers that are not finite: left out"
            )
        if not sorted_by_stamp:
            check_silence(draft, stream)
    for about, doubt in draft.survey.info.doubts:
        (draft.losses if about in {s.topic for s in used} else draft.warnings).append(doubt)
    for topic in draft.survey.info.topics:
        if topic.count == 0 and topic.kind is not MessageKind.OTHER:
            draft.warnings.append(f"{topic.topic} ({topic.kind}) is listed but has no message")
    if scan is None:
        return
    samples = draft.survey.streams[scan.topic].samples
    ranges = [m.ranges for m in samples if isinstance(m, LaserScanMessage)]
    if nan := sum(int(np.isnan(some).sum()) for some in ranges):
        count = f"{nan:,} of {sum(map(len, ranges)):,}"
        draft.warnings.append(f"{scan.topic}: {count} sampled ranges are NaN: left out")
