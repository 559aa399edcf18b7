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


def read_relations(path: Path) -> Relations:
    """The relations of a file, in its order; `MapError` names the line that makes no sense.

    Stamps are read as decimals, so that they are exact to the nanosecond.
    """
    try:
        lines = read_whole(path).decode("ascii").splitlines()
    except UnicodeDecodeError:
        raise MapError(f"{path}: is no relations file: it holds more than ASCII text") from None
    stamps, motions = [], []
    for number, line in enumerate(lines, start=1):
        fields = line.split("#")[0].split()
        if not fields:
            continue
        try:
            x, y, z, *angles = map(float, fields[2:])
            if len(angles) != 3 or not (np.abs([x, y, z, *angles]) <= FARTHEST).all():
                raise ValueError
            stamps.append([nanoseconds_from_text(field) for field in fields[:2]])
        except ValueError:
            raise MapError(
                f"{path}, line {number}: expected `t1 t2 x y z roll pitch yaw`, found {line!r}"
            ) from None
        motions.append(make_transform(roll_pitch_yaw_to_rotation(*angles), [x, y, z]))
    if not motions:
        raise MapError(f"{path}: holds no relation")
    return Relations(np.array(stamps, np.int64), np.stack(motions))
