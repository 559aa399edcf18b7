"""Where a sensor sits on the base: by a setting, by tf, or assumed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import ConfigError
from mapmyworld.geometry.rigid import between, make_transform
from mapmyworld.geometry.rotations import roll_pitch_yaw_to_rotation, rotation_angle
from mapmyworld.sensing.plan import Draft
from mapmyworld.sensing.transforms import frame_name

_FARTHEST = 1000.0  # m or rad of a mount
_LOOSE = (0.05, 0.05)  # m, rad; springs and wheels on rough floors move a sensor by less


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """Where a sensor sits on the base."""

    base_from_sensor: NDArray[np.float64]
    """(4, 4), in the middle of what tf recorded of it."""
    is_assumed: bool = False
    """Whether neither setting nor tf gives it."""
    moves: tuple[float, float] = (0.0, 0.0)
    """How far from there it is at times, m and rad."""

    @property
    def is_loose(self) -> bool:
        """Whether a joint moves it by more than a map can bear."""
        return self.moves[0] > _LOOSE[0] or self.moves[1] > _LOOSE[1]


def mount_of(draft: Draft, base: str, frame_id: str, role: str) -> Mount:
    """By the setting of its role, by tf, or assumed to be the base."""
    setting = getattr(draft.config, f"{role}_mount")
    if setting:
        return Mount(_parsed(setting, f"sensing.{role}_mount"))
    return by_tf(draft, base, frame_name(frame_id))


def by_tf(draft: Draft, base: str, frame: str) -> Mount:
    """What tf gives of a frame; assumed to be the base where that is nothing."""
    if frame == base:
        return Mount(np.eye(4))
    places = draft.survey.tree.places(base, frame)
    if not len(places):
        return Mount(np.eye(4), is_assumed=True)
    middle = places[len(places) // 2]
    moved = between(middle, places)
    shift = float(np.linalg.norm(moved[:, :3, 3], axis=1).max())
    return Mount(middle, moves=(shift, float(rotation_angle(moved).max())))


def check_joint(draft: Draft, base: str, frame_id: str, mount: Mount) -> None:
    """A loss where a sensor that is used moves on the robot."""
    if mount.is_loose:
        shift, turn = mount.moves
        draft.losses.append(
            f"{frame_name(frame_id)} moves against {base} by up to {shift:.2f} m and "
            f"{np.degrees(turn):.0f} deg, and is mapped as if it stood where it was in the middle "
            "of the log: keep the joint still while recording"
        )


def _parsed(text: str, name: str) -> NDArray[np.float64]:
    """The transform (4, 4) of "x y z roll pitch yaw" in metres and radians."""
    try:
        x, y, z, roll, pitch, yaw = (float(part) for part in text.replace(",", " ").split())
    except ValueError:
        raise ConfigError(f'{name} = {text!r}: give six numbers "x y z roll pitch yaw"') from None
    if not all(abs(value) < _FARTHEST for value in (x, y, z, roll, pitch, yaw)):
        raise ConfigError(f"{name} = {text!r}: no place on a robot: give metres and radians")
    return make_transform(roll_pitch_yaw_to_rotation(roll, pitch, yaw), [x, y, z])
