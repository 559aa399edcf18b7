"""CARMEN logs (.log, .clf, .gfs; also .bz2, .gz) as messages of a robot with odometry and lasers.

The order of the file is the true order of motion: stamps step back in real logs, so log time is
the latest stamp seen so far and never decreases. Each sweep follows the odometry taken with it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, ClassVar

from formats.decimal_stamps import stamp_from_text
from formats.logs.carmen_records import (
    BARE_LASERS,
    LASER_FRAMES,
    LASER_TOPICS,
    PARSERS,
    RAW_LASERS,
    odometry_from_odom_line,
    odometry_of_record,
    pose_from_truepos_line,
    scan_of_record,
)
from formats.logs.carmen_survey import Line, Survey, survey_lines
from formats.logs.files import UnpackedFile
from formats.logs.listed_log import ListedLog
from formats.logs.poses import planar_pose
from mapmyworld.errors import LogError
from mapmyworld.types import (
    MessageKind,
    RawMessage,
    TransformsMessage,
    TransformStamped,
)

KINDS = {
    "/odom": (MessageKind.ODOMETRY, "nav_msgs/msg/Odometry"),
    "/carmen/odom": (MessageKind.ODOMETRY, "nav_msgs/msg/Odometry"),
    "/scan": (MessageKind.LASER_SCAN, "sensor_msgs/msg/LaserScan"),
    "/scan_rear": (MessageKind.LASER_SCAN, "sensor_msgs/msg/LaserScan"),
    "/ground_truth": (MessageKind.POSE, "geometry_msgs/msg/PoseStamped"),
    "/tf_static": (MessageKind.TRANSFORMS, "tf2_msgs/msg/TFMessage"),
}
_LINE_BYTES = 1 << 22  # a longer line is damage
MARKS = (
    b"FLASER ",
    b"ROBOTLASER1 ",
    b"RAWLASER1 ",
    b"RLASER ",
    b"ODOM ",
    b"PARAM ",
    b"# CARMEN",
    b"SYNC ",
)


class CarmenLog(ListedLog):
    """A LogSource over one CARMEN log file; raises `LogError` where no line of it is whole."""

    container = "CARMEN log"
    encoding = "carmen"
    type_names: ClassVar = {topic: name for topic, (_, name) in KINDS.items()}

    def _read(self) -> Callable[[], Iterator[RawMessage]]:
        lines = list(self._lines())
        survey = survey_lines(lines)
        stamped = [line for line in lines if line[0] != b"PARAM"]
        if not stamped:
            raise LogError(
                f"{self.path}: no whole FLASER, ROBOTLASER1, RAWLASER1 or ODOM line in it: not "
                "a CARMEN log, or its beginning is missing",
                problems=self.problems,
            )
        counts = Counter(kind.decode() for kind, *_ in lines).most_common()
        kinds = ", ".join(f"{kind} {count}" for kind, count in counts)
        self.details += [("lines", kinds), *_laser_details(survey)]
        self.doubts |= survey.doubts
        return partial(self._messages, survey, stamped)

    def _messages(self, survey: Survey, stamped: list[Line]) -> Iterator[RawMessage]:
        if survey.base_from_laser:
            yield _mountings(survey, *stamped[0][2:])
        for kind, read, stamp_ns, log_time_ns in stamped:
            for topic, decode, *given in _parts(kind, survey):
                made = partial(decode, read, stamp_ns, *given)
                yield RawMessage(topic, KINDS[topic][0], log_time_ns, stamp_ns, made)

    def _lines(self) -> Iterator[Line]:
        """Lines that matter, with exact stamps and non-decreasing log times; counts bad ones."""
        bad, first_bad, latest_ns, number = 0, 0, 0, 0
        unpacked = UnpackedFile(self.path)
        with unpacked.open() as stream:
            while line := stream.readline(_LINE_BYTES):
                number += 1
                kind = line[: line.find(b" ")]
                if kind == b"PARAM":
                    yield kind, line, 0, latest_ns
                if kind not in PARSERS:
                    continue
                fields = line.split()
                try:
                    if kind in BARE_LASERS and line.endswith(b"\n"):
                        # Some converters end a line with its stamp: nothing needs what follows.
                        fields += [b"-", b"0"] * (len(fields) == int(fields[1]) + 9)
                    read, stamp_ns = PARSERS[kind](fields), stamp_from_text(fields[-3])
                except (ValueError, IndexError):
                    bad, first_bad = bad + 1, first_bad or number
                    continue
                latest_ns = max(latest_ns, stamp_ns)
                yield kind, read, stamp_ns, latest_ns
        if unpacked.damage:
            self.problems.append(
                f"{self.path}: unreadable after line {number} ({unpacked.damage}): the rest is lost"
            )
        if bad:
            self.problems.append(
                f"{self.path}: {bad} damaged line(s) skipped, the first is line {first_bad}"
            )


def _parts(kind: bytes, survey: Survey) -> Iterator[tuple[Any, ...]]:
    """The topics a line speaks on, in order, and how to decode each: with what beside the line."""
    if kind == b"ODOM":
        yield "/carmen/odom", odometry_from_odom_line
    elif kind == b"TRUEPOS":
        yield "/ground_truth", pose_from_truepos_line
    elif kind not in survey.unused:
        if kind not in RAW_LASERS:
            yield "/odom", odometry_of_record
        range_max = survey.range_max.get(kind, 0.0)
        yield LASER_TOPICS[kind], scan_of_record, LASER_FRAMES[kind], range_max


def _mountings(survey: Survey, stamp_ns: int, log_time_ns: int) -> RawMessage:
    transforms = tuple(
        TransformStamped(stamp_ns, "base_link", frame, planar_pose(*pose.tolist()))
        for frame, pose in sorted(survey.base_from_laser.items())
    )
    message = TransformsMessage(transforms, static=True)
    return RawMessage("/tf_static", MessageKind.TRANSFORMS, log_time_ns, stamp_ns, lambda: message)


def _laser_details(survey: Survey) -> Iterator[tuple[str, str]]:
    for kind, range_max in survey.range_max.items():
        if kind in survey.unused:
            yield kind.decode(), f"not used: {LASER_TOPICS[kind]} has lines with the robot's pose"
            continue
        x, y, yaw = survey.base_from_laser[LASER_FRAMES[kind]]
        yield (
            kind.decode(),
            f"sees to {range_max:g} m; on the robot at x {x:g} m, y {y:g} m, yaw {yaw:g} rad",
        )
