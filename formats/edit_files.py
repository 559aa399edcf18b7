"""A person's edits of a graph as TOML: versionable text, replayed by every build.

[[reject]]                 # or [[accept]]
from = 12
to = 340
kind = "loop_closure"      # optional: only constraints of this kind
reason = "two identical corridors"

[[add]]                    # a constraint: pose of `to` in the frame of `from`
from = 3
to = 250
pose = [1.2, 0.0, 90.0]    # x, y in metres, yaw in degrees; or x y z roll pitch yaw
sigma = [0.05, 2.0]        # metres, degrees; or covariance = 6x6, rotation (rad) first
reason = "measured with a tape"

[[prior]]                  # like add, for one node in the map's frame
node = 1
pose = [0.0, 0.0, 0.0]
sigma = [0.01, 0.5]
reason = "the dock"

[[pin]]                    # a node that stays; at `pose`, or where it is
node = 17
reason = "surveyed"
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from formats.bounds import FARTHEST
from formats.nested_text import read_toml
from mapmyworld.errors import MapError
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import make_transform
from mapmyworld.geometry.rotations import roll_pitch_yaw_to_rotation
from mapmyworld.types import ConstraintKind
from mapmyworld.types.edits import Edit, EditAction

_PAIR = {"from", "to", "reason"}
_LEAST_SIGMA = 1e-9  # m or degrees: less is no measurement, and divides by zero
_FIELDS = {
    EditAction.ACCEPT: (_PAIR, {"kind"}),
    EditAction.REJECT: (_PAIR, {"kind"}),
    EditAction.ADD: (_PAIR | {"pose"}, {"sigma", "covariance"}),
    EditAction.PRIOR: ({"node", "pose", "reason"}, {"sigma", "covariance"}),
    EditAction.PIN: ({"node", "reason"}, {"pose"}),
}


def read_edits(path: Path) -> tuple[Edit, ...]:
    """The edits in a file; raises `MapError` with everything that is wrong in them at once.

    And `ConfigError` where the file is no TOML.
    """
    table = read_toml(path)
    edits: list[Edit] = []
    problems: list[str] = []
    for action, items in table.items():
        if action not in set(EditAction) or not isinstance(items, list):
            known = ", ".join(f"[[{a}]]" for a in EditAction)
            problems.append(f"{action!r}: an edits file holds {known}")
            continue
        for number, item in enumerate(items, 1):
            try:
                edits.append(_edit(EditAction(action), item))
            except ValueError as error:
                problems.append(f"[[{action}]] number {number}: {error}")
    if problems:
        raise MapError(f"{path}: cannot be used:", problems=problems)
    return tuple(edits)


def _edit(action: EditAction, item: Mapping[str, Any]) -> Edit:
    if not isinstance(item, dict):
        raise ValueError(f"is no table, as [[{action}]] and lines under it make one")
    needed, allowed = _FIELDS[action]
    missing, unknown = needed - set(item), set(item) - needed - allowed
    if missing:
        raise ValueError(f"lacks {', '.join(sorted(missing))}")
    if unknown:
        raise ValueError(f"does not know {', '.join(sorted(unknown))}")
    if not isinstance(item["reason"], str) or not item["reason"].strip():
        raise ValueError("reason must say why")
    ends = [item["node"]] * 2 if "node" in item else [item["from"], item["to"]]
    if not all(isinstance(end, int) and not isinstance(end, bool) for end in ends):
        raise ValueError("nodes are whole numbers")
    if "node" not in item and ends[0] == ends[1]:
        raise ValueError("from and to are the same node")
    kind = item.get("kind", "")
    if kind and kind not in list(ConstraintKind):
        raise ValueError(f"kind is one of {', '.join(ConstraintKind)}")
    motion = _pose(item["pose"]) if "pose" in item else None
    covariance = None
    if action in (EditAction.ADD, EditAction.PRIOR):
        covariance = _covariance(item)
    return Edit(action, ends[0], ends[1], item["reason"], kind, motion, covariance)


def _pose(value: Any) -> Array:
    numbers = _numbers(value, "pose")
    if numbers.shape not in {(3,), (6,)}:
        raise ValueError("pose is x, y, yaw or x, y, z, roll, pitch, yaw (metres, degrees)")
    x, y, yaw = numbers[[0, 1, -1]]
    z, roll, pitch = numbers[2:5] if len(numbers) == 6 else (0.0, 0.0, 0.0)
    angles = np.radians([roll, pitch, yaw])
    return make_transform(roll_pitch_yaw_to_rotation(*angles.tolist()), np.array([x, y, z]))


def _covariance(item: Mapping[str, Any]) -> Array:
    if ("sigma" in item) == ("covariance" in item):
        raise ValueError("give either sigma (metres, degrees) or covariance (6x6)")
    if "sigma" in item:
        sigma = _numbers(item["sigma"], "sigma")
        if sigma.shape != (2,) or (sigma < _LEAST_SIGMA).any():
            raise ValueError(
                f"sigma is two numbers of at least {_LEAST_SIGMA:.0e}: metres, degrees"
            )
        return np.diag(np.repeat([np.radians(sigma[1]) ** 2, sigma[0] ** 2], 3))
    covariance = _numbers(item["covariance"], "covariance")
    if covariance.shape != (6, 6) or not np.allclose(covariance, covariance.T):
        raise ValueError("covariance is a symmetric 6x6 matrix, rotation first")
    if np.linalg.eigvalsh(covariance)[0] <= 1e-14 * np.abs(covariance).max():
        raise ValueError("covariance is not positive definite")
    return covariance


def _numbers(value: Any, name: str) -> Array:
    try:
        numbers = np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} is made of numbers") from None
    if not (np.abs(numbers) <= FARTHEST).all():
        raise ValueError(f"{name} is not finite, or out of range")
    return numbers
