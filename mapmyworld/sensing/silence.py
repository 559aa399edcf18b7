"""The part of the plan that indicates where a sensor is silent: late, stopped, or with a hole."""

from __future__ import annotations

from mapmyworld.sensing.plan import Draft
from mapmyworld.sensing.survey import Stream, Survey
from mapmyworld.types import MessageKind

_WORD = 1.0  # s without a message of a sensor that is worth a word
_LOSS = 5.0, 0.05  # s, share of the drive; a longer silence than both leaves the map partial
_PERIODS = 10.0  # of the sensor that a silence lasts at least
_SENSORS = {
    MessageKind.LASER_SCAN,
    MessageKind.POINT_CLOUD,
    MessageKind.IMAGE,
    MessageKind.ODOMETRY,
    MessageKind.IMU,
    MessageKind.TRANSFORMS,
}


def check_silence(draft: Draft, stream: Stream) -> None:
    """Words about a sensor that starts late, stops early or pauses; losses where it is for long."""
    start_ns, end_ns = _drive(draft.survey)
    long_s = max(_LOSS[0], _LOSS[1] * (end_ns - start_ns) * 1e-9)
    late_s = (stream.first_log_ns - start_ns) * 1e-9
    stop_s, gap_s = (stream.last_log_ns - start_ns) * 1e-9, (stream.gap_start_ns - start_ns) * 1e-9
    words = (
        (late_s, f"begins {late_s:.1f} s after the other sensors"),
        (
            (end_ns - stream.last_log_ns) * 1e-9,
            f"stops {(end_ns - stream.last_log_ns) * 1e-9:.1f} s before the log ends, "
            f"{stop_s:.1f} s after its start",
        ),
        (
            stream.largest_gap_ns * 1e-9,
            f"silent for {stream.largest_gap_ns * 1e-9:.1f} s, from {gap_s:.1f} s after the start",
        ),
    )
    least_s = _PERIODS / max(stream.frequency, 1e-3)
    for lasts_s, what in words:
        if lasts_s > max(long_s, least_s):
            draft.losses.append(
                f"{stream.topic}: {what}: no data from it there; was its driver stopped, or its "
                "cable unplugged?"
            )
        elif lasts_s > max(_WORD, least_s):
            draft.warnings.append(f"{stream.topic}: {what}")


def _drive(survey: Survey) -> tuple[int, int]:
    """Log times between which any sensor speaks; a map or description may be older."""
    speaking = [
        s
        for s in survey.streams.values()
        if s.kind in _SENSORS and s.count and not s.topic.endswith("_static")
    ]
    first = min((s.first_log_ns for s in speaking), default=survey.info.start_ns)
    return first, max((s.last_log_ns for s in speaking), default=survey.info.end_ns)
