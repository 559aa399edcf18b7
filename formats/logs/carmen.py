"""CARMEN logs (.log, .clf, .gfs; also .bz2, .gz) as messages of a robot with odometry and lasers.

The order of the file is the true order of motion: stamps step back in real logs, so log time is
the latest stamp seen so far and never decreases. Each sweep follows the odometry taken with it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import ClassVar

from formats.decimal_stamps import stamp_from_text
from formats.logs.carmen_records import (
    LASER_FRAMES,
    LASER_TOPICS,
    RAW_LASERS,
    odometry_from_laser_line,
    odometry_from_odom_line,
    pose_from_truepos_line,
    scan_from_line,
)
from formats.logs.carmen_survey import Survey, survey_lines
from formats.logs.files import UnpackedFile
from formats.logs.listed_log import ListedLog
from formats.logs.poses import planar_pose
from mapmyworld.errors import LogError
from mapmyworld.types import (
    Message,
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
_STAMPED = frozenset({b"ODOM", b"TRUEPOS", *LASER_TOPICS})
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

Line = tuple[bytes, bytes, int, int]


class CarmenLog(ListedLog):
    """A LogSource over one CARMEN log file; raises `LogError` where no line of it is whole."""

    container = "CARMEN log"
    encoding = "carmen"
    type_names: ClassVar = {topic: name for topic, (_, name) in KINDS.items()}

    def _read(self) -> Iterator[RawMessage]:
        lines = list(self._lines())
        survey = survey_lines(lines)
        stamped = [line for line in lines if line[0] != b"PARAM"]
        if not stamped or survey.lasers_damaged == len(stamped):
            raise LogError(
                f"{self.path}: no whole FLASER, ROBOTLASER1, RAWLASER1 or ODOM line in it: not "
                "a CARMEN log, or its beginning is missing",
                problems=self.problems,
            )
        counts = Counter(kind.decode() for kind, *_ in lines).most_common()
        kinds = ", ".join(f"{kind} {count}" for kind, count in counts)
        self.details += [("lines", kinds), *_laser_details(survey)]
        self.doubts |= survey.doubts
        if survey.base_from_laser:
            yield _mountings(survey, *stamped[0][2:])
        for kind, line, stamp_ns, log_time_ns in stamped:
            for topic, decode in _parts(kind, line, stamp_ns, survey):
                guarded = partial(_decode, decode, self.path, kind)
                yield RawMessage(topic, KINDS[topic][0], log_time_ns, stamp_ns, guarded)

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
                if kind not in _STAMPED:
                    continue
                try:
                    stamp_ns = _checked_stamp(kind, line)
                except (ValueError, IndexError):
                    completed = _completed(kind, line)
                    if completed is None:
                        bad, first_bad = bad + 1, first_bad or number
                        continue
                    line, stamp_ns = completed
                latest_ns = max(latest_ns, stamp_ns)
                yield kind, line, stamp_ns, latest_ns
        if unpacked.damage:
            self.problems.append(
                f"{self.path}: unreadable after line {number} ({unpacked.damage}): the rest is lost"
            )
        if bad:
            self.problems.append(
                f"{self.path}: {bad} damaged line(s) skipped, the first is line {first_bad}"
            )


_LEAST_FIELDS = {
    b"ODOM": 10, b"TRUEPOS": 10, b"ROBOTLASER1": 24, b"ROBOTLASER2": 24,
    b"RAWLASER1": 13, b"RAWLASER2": 13,
}  # fmt: skip


def _checked_stamp(kind: bytes, line: bytes) -> int:
    """The stamp, once the line has as many fields as it announces."""
    fields = line.split()
    if kind in {b"FLASER", b"RLASER"} and len(fields) != int(fields[1]) + 11:
        raise ValueError("wrong number of fields")
    if len(fields) < _LEAST_FIELDS.get(kind, 0):
        raise ValueError("wrong number of fields")
    return stamp_from_text(fields[-3])


def _completed(kind: bytes, line: bytes) -> tuple[bytes, int] | None:
    """A whole line that ends with its stamp, as some converters write them, and that stamp.

    Host and logger's time, which nothing here needs, are put behind it. None for a damaged line.
    """
    if kind not in {b"FLASER", b"RLASER"} or not line.endswith(b"\n"):
        return None
    whole = line.rstrip() + b" - 0\n"
    try:
        return whole, _checked_stamp(kind, whole)
    except (ValueError, IndexError):
        return None


def _parts(
    kind: bytes, line: bytes, stamp_ns: int, survey: Survey
) -> Iterator[tuple[str, Callable[[], Message]]]:
    """The topics a line speaks on, in order, and how to decode each."""
    if kind == b"ODOM":
        yield "/carmen/odom", partial(odometry_from_odom_line, line, stamp_ns)
    elif kind == b"TRUEPOS":
        yield "/ground_truth", partial(pose_from_truepos_line, line, stamp_ns)
    elif kind not in survey.unused:
        if kind not in RAW_LASERS:
            yield "/odom", partial(odometry_from_laser_line, line, stamp_ns)
        range_max = survey.range_max.get(kind, 0.0)
        frame = LASER_FRAMES[kind]
        yield LASER_TOPICS[kind], partial(scan_from_line, line, stamp_ns, frame, range_max)


def _decode(decode: Callable[[], Message], path: Path, kind: bytes) -> Message:
    try:
        return decode()
    except (ValueError, IndexError) as error:
        raise LogError(f"{path}: damaged {kind.decode()} line: {error}") from error


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
