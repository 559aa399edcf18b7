"""Where a sensor sits on the base: by a setting, by tf, or assumed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import ConfigError
from mapmyworld.geometry.rigid import make_transform
from mapmyworld.geometry.rotations import roll_pitch_yaw_to_rotation
from mapmyworld.sensing.plan import Draft
from mapmyworld.sensing.transforms import frame_name

_FARTHEST = 1000.0  # m or rad of a mount


def mount_of(draft: Draft, base: str, frame_id: str, role: str) -> tuple[NDArray[np.float64], bool]:
    """`base_from_sensor` (4, 4), and whether it had to be assumed."""
    setting = getattr(draft.config, f"{role}_mount")
    if setting:
        return _parsed(setting, f"sensing.{role}_mount"), False
    name = frame_name(frame_id)
    if name == base:
        return np.eye(4), False
    info = draft.survey.info
    found = draft.survey.tree.lookup(base, name, (info.start_ns + info.end_ns) // 2)
    return (np.eye(4), True) if found is None else (found, False)


def _parsed(text: str, name: str) -> NDArray[np.float64]:
    """The transform (4, 4) of "x y z roll pitch yaw" in metres and radians."""
    try:
        x, y, z, roll, pitch, yaw = (float(part) for part in text.replace(",", " ").split())
    except ValueError:
        raise ConfigError(f'{name} = {text!r}: give six numbers "x y z roll pitch yaw"') from None
    if not all(abs(value) < _FARTHEST for value in (x, y, z, roll, pitch, yaw)):
        raise ConfigError(f"{name} = {text!r}: no place on a robot: give metres and radians")
    return make_transform(roll_pitch_yaw_to_rotation(roll, pitch, yaw), [x, y, z])
