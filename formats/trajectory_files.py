"""Trajectories as TUM, KITTI or CSV text."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from formats.bounds import FARTHEST
from formats.decimal_stamps import nanoseconds_from_integer, nanoseconds_from_text, seconds_text
from formats.whole_files import read_whole, write_whole
from mapmyworld.errors import MapError
from mapmyworld.geometry.rigid import make_transform
from mapmyworld.geometry.rotations import quaternion_to_rotation, rotation_to_quaternion
from mapmyworld.types import Trajectory

Style = Literal["tum", "kitti", "csv"]
CSV_HEADER = "stamp_ns,x,y,z,qx,qy,qz,qw"
_ROTATION = 0.01  # by which a matrix of KITTI's, rounded, may miss being a rotation
_SECOND = 1_000_000_000


def write_trajectory(path: Path, trajectory: Trajectory, style: Style = "tum") -> None:
    """TUM: `t x y z qx qy qz qw`; KITTI: 3x4 row-major, no times; CSV: integer nanoseconds.

    Lines with times ascend by them, each time once, as readers of TUM's demand: a log's stamps may
    step back. KITTI's lines keep the order of motion.
    """
    if style == "kitti":
        rows = trajectory.poses.reshape(-1, 16)[:, :12].tolist()
        lines = [" ".join(f"{number:.12g}" for number in row) for row in rows]
    elif style == "csv":
        lines = [CSV_HEADER, *_stamped_lines(ascending(trajectory), ",", str)]
    else:
        lines = list(_stamped_lines(ascending(trajectory), " ", seconds_text))
    write_whole(path, "".join(f"{line}\n" for line in lines))


def ascending(trajectory: Trajectory) -> Trajectory:
    """By stamp; of poses with the same stamp the first."""
    if np.all(np.diff(trajectory.stamps_ns) > 0):
        return trajectory
    stamps, first = np.unique(trajectory.stamps_ns, return_index=True)
    return Trajectory(stamps, trajectory.poses.reshape(-1, 4, 4)[first])


def _stamped_lines(
    trajectory: Trajectory, separator: str, stamp_text: Callable[[int], str]
) -> Iterator[str]:
    poses = trajectory.poses.reshape(-1, 4, 4)
    rows = np.hstack([poses[:, :3, 3], rotation_to_quaternion(poses[:, :3, :3])]).tolist()
    for stamp_ns, numbers in zip(trajectory.stamps_ns.tolist(), rows, strict=True):
        yield separator.join([stamp_text(stamp_ns), *(f"{number:z.9f}" for number in numbers)])


def read_trajectory(path: Path) -> Trajectory:
    """A trajectory in any of the three styles, by its lines; KITTI's stamps count from 0.

    Raises `MapError` where it is none.
    """
    try:
        text = read_whole(path).decode("utf-8")
    except UnicodeDecodeError as error:
        raise MapError(f"{path}: cannot be read as a trajectory ({error})") from None
    numbered = [
        (number, line.strip())
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not numbered:
        raise MapError(f"{path}: holds no poses")
    if numbered[0][1].startswith(CSV_HEADER.split(",")[0]):
        return _read_stamped(path, numbered[1:], ",", nanoseconds_from_integer)
    if len(numbered[0][1].split()) == 12:
        return _read_kitti(path, numbered)
    return _read_stamped(path, numbered, None, nanoseconds_from_text)


def _read_stamped(
    path: Path,
    lines: list[tuple[int, str]],
    separator: str | None,
    parse_stamp: Callable[[str], int],
) -> Trajectory:
    stamps, rows = [], []
    for number, line in lines:
        fields = line.split(separator)
        if len(fields) != 8:
            raise MapError(
                f"{path}, line {number}: {len(fields)} fields where a stamp, a position and a"
                " quaternion (t x y z qx qy qz qw) make 8"
            )
        try:
            stamps.append(parse_stamp(fields[0]))
        except ValueError:
            raise MapError(f"{path}, line {number}: {fields[0]!r} is not a time") from None
        rows.append(_numbers(path, number, fields[1:]))
    table = np.array(rows, np.float64).reshape(-1, 7)
    short = np.flatnonzero(np.linalg.norm(table[:, 3:], axis=1) < 0.5)
    if len(short):
        raise MapError(f"{path}, line {lines[short[0]][0]}: the quaternion is not of length 1")
    poses = make_transform(quaternion_to_rotation(table[:, 3:]), table[:, :3])
    return Trajectory(np.array(stamps, np.int64), poses)


def _read_kitti(path: Path, lines: list[tuple[int, str]]) -> Trajectory:
    rows = []
    for number, line in lines:
        fields = line.split()
        if len(fields) != 12:
            raise MapError(f"{path}, line {number}: {len(fields)} numbers where KITTI has 12")
        rows.append(_numbers(path, number, fields))
    table: NDArray[np.float64] = np.array(rows, np.float64).reshape(-1, 3, 4)
    turns = table[:, :, :3]
    off = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    if (bad := np.flatnonzero(off > _ROTATION)).size:
        raise MapError(f"{path}, line {lines[bad[0]][0]}: its 3 x 3 matrix is no rotation")
    poses = make_transform(turns, table[:, :, 3])
    return Trajectory(np.arange(len(poses), dtype=np.int64) * _SECOND, poses)


def _numbers(path: Path, number: int, fields: list[str]) -> list[float]:
    try:
        values = [float(field) for field in fields]
    except ValueError as error:
        raise MapError(f"{path}, line {number}: {error}") from None
    if not (np.abs(values) <= FARTHEST).all():
        raise MapError(f"{path}, line {number}: a number that is not finite, or out of range")
    return values
