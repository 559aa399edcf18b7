"""Reader of relations files: `t1 t2 x y z roll pitch yaw`, one relation a line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from formats.bounds import FARTHEST
from formats.decimal_stamps import nanoseconds_from_text
from formats.whole_files import read_whole
from mapmyworld.errors import MapError
from mapmyworld.geometry.rigid import make_transform
from mapmyworld.geometry.rotations import roll_pitch_yaw_to_rotation
from mapmyworld.types.maps import Relations

_FIELDS = 8


def read_relations(path: Path) -> Relations:
    """The relations of a file, in its order; `MapError` names the line that makes no sense.

    Stamps are read as decimals, so that they are exact to the nanosecond.
    """
    try:
        lines = read_whole(path).decode("ascii").splitlines()
    except UnicodeDecodeError:
        raise MapError(f"{path}: is no relations file: it holds more than ASCII text") from None
    stamps: list[tuple[int, int]] = []
    motions = []
    for number, line in enumerate(lines, start=1):
        fields = line.split("#")[0].split()
        if not fields:
            continue
        try:
            stamp_pair, motion = _relation(fields)
        except ValueError:
            raise MapError(
                f"{path}, line {number}: expected `t1 t2 x y z roll pitch yaw`, found {line!r}"
            ) from None
        stamps.append(stamp_pair)
        motions.append(motion)
    if not motions:
        raise MapError(f"{path}: holds no relation")
    return Relations(np.array(stamps, np.int64), np.stack(motions))


def _relation(fields: list[str]) -> tuple[tuple[int, int], np.ndarray]:
    if len(fields) != _FIELDS:
        raise ValueError("not eight fields")
    first, second = (nanoseconds_from_text(field) for field in fields[:2])
    x, y, z, roll, pitch, yaw = (float(field) for field in fields[2:])
    if not (np.abs([x, y, z, roll, pitch, yaw]) <= FARTHEST).all():
        raise ValueError("not finite, or out of range")
    return (first, second), make_transform(roll_pitch_yaw_to_rotation(roll, pitch, yaw), [x, y, z])
