"""Fields of messages as other libraries' parsers give them: objects with fields as attributes."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from formats.bounds import LATEST_NS
from formats.logs.poses import pose_matrix

# What holds a time, and the names of its seconds and of their fractions.
_STAMPS = (
    ("stamp", (("sec",), ("nanosec",))),
    ("timestamp", (("seconds", "sec"), ("nanos", "nsec", "nanosec"))),
)


def field(value: Any, name: str, default: Any = None) -> Any:
    """An attribute, in either case of letters; `default` where it is absent or null."""
    found = getattr(value, name, None)
    if found is None:
        found = getattr(value, name.lower(), None)
    return default if found is None else found


def doubles_of(value: Any, name: str) -> NDArray[np.float64]:
    """A sequence of N numbers (N,); none where it is absent."""
    return np.array(field(value, name, ()), np.float64).reshape(-1)


def singles(values: ArrayLike) -> NDArray[np.float32]:
    """Values as float32, (...) both; what is too large for one is infinite, like no return."""
    with np.errstate(over="ignore", invalid="ignore"):  # signalling NaN is invalid
        return np.asarray(values, np.float32)


def singles_of(value: Any, name: str) -> NDArray[np.float32]:
    """A sequence of N numbers (N,) in single precision; none where it is absent."""
    return singles(field(value, name, ())).reshape(-1)


def matrix_of(value: Any, name: str, rows: int, columns: int) -> NDArray[np.float64]:
    """A matrix (R, C), row by row; zeros where it is absent. ValueError for another size."""
    found = doubles_of(value, name)
    if len(found) not in {0, rows * columns}:
        raise ValueError(f"{len(found)} numbers where {rows * columns} are needed")
    return found.reshape(rows, columns) if len(found) else np.zeros((rows, columns))


def xyz(value: Any) -> list[float]:
    """A vector's three numbers."""
    return [float(field(value, axis, 0.0)) for axis in "xyz"]


def motion_of(position: Any, rotation: Any) -> NDArray[np.float64]:
    """The matrix (4, 4) of a vector and a quaternion."""
    return pose_matrix([*xyz(position), *(float(field(rotation, axis, 0.0)) for axis in "xyzw")])


def pose_of(value: Any) -> NDArray[np.float64]:
    """The matrix (4, 4) of a message's `pose`."""
    pose = field(value, "pose")
    return motion_of(field(pose, "position"), field(pose, "orientation"))


def header_of(value: Any) -> tuple[int, str]:
    """Stamp in nanoseconds and frame of a ROS message's header, or of a message of Foxglove's."""
    header = field(value, "header", value)
    return stamp_of(header), field(header, "frame_id", "")


def stamp_of(header: Any) -> int:
    """Nanoseconds of ROS's time, or of Foxglove's: protobuf's Timestamp, {sec, nsec} in JSON."""
    for stamp, names in _STAMPS:
        time = field(header, stamp)
        if time is not None:
            seconds, rest = (next((f for n in part if (f := field(time, n))), 0) for part in names)
            return min(max(int(seconds) * 1_000_000_000 + int(rest), 0), LATEST_NS)
    return 0


def octets_of(value: Any, name: str) -> memoryview:
    """A sequence of bytes, which JSON holds in base64; none where it is absent."""
    found = field(value, name, b"")
    return memoryview(base64.b64decode(found, validate=True) if isinstance(found, str) else found)
