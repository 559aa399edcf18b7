"""How far tracked poses may have drifted between two nodes: what a closure may correct."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.types import Constraint, ConstraintKind, Node

Array = NDArray[np.float64]
_TRANSLATION = 0.05  # share of the path that tracked poses may be off by
_ROTATION = 0.03  # rad a metre of path that tracked poses may be off by
_TURN = 0.03  # share of all rotation that tracked poses may be off by
_BASE_TRANSLATION = 0.05  # m that a closure may be off without any drift
_BASE_ROTATION = 0.03  # rad


class Drift:
    """Expected error of the tracked motion between any two nodes of a session.

    Grown by path and turn; but where the neighbour constraints state that they know less,
    as those of a camera that was blind, they are believed.
    """

    def __init__(self, nodes: Sequence[Node], constraints: Sequence[Constraint] = ()) -> None:
        self._poses = np.stack([node.tracked_from_base for node in nodes])
        self._sessions = np.array([node.session for node in nodes])
        steps = between(self._poses[:-1], self._poses[1:])
        self._path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps[:, :3, 3], axis=1))])
        self._turn = np.concatenate([[0.0], np.cumsum(rotation_angle(steps))])
        self._stated = _stated_variances(nodes, constraints)

    def sigmas(self, i: int, j: int) -> tuple[float, float]:
        """Standard deviations (m, rad) of the tracked motion from node index i to j."""
        path, turn = abs(self._path[i] - self._path[j]), abs(self._turn[i] - self._turn[j])
        rotation = _BASE_ROTATION + _ROTATION * np.sqrt(path)
        rotation += _TURN * np.sqrt(turn)
        lever = min(path / 4.0, 10.0)
        stated = np.sqrt(np.abs(self._stated[i] - self._stated[j]))
        rotation = max(rotation, stated[0])
        translation = _BASE_TRANSLATION + _TRANSLATION * path + rotation * lever
        return float(max(translation, stated[1])), float(rotation)

    def comparable(self, i: int, j: int) -> bool:
        """Whether tracking connects two nodes at all: it does within a session."""
        return bool(self._sessions[i] == self._sessions[j])

    def excess(
        self, i: int, j: int, i_from_j: Array, own: tuple[float, float] = (0.0, 0.0)
    ) -> tuple[float, float, float]:
        """How measured `i_from_j` (4, 4) contradicts tracking: largest sigma, metres, radians.

        `own`: standard deviations (m, rad) of the measured motion itself.
        """
        error = between(between(self._poses[i], self._poses[j]), i_from_j)
        metres, radians = float(np.linalg.norm(error[:3, 3])), float(rotation_angle(error))
        translation, rotation = self.sigmas(i, j)
        translation, rotation = np.hypot([translation, rotation], own).tolist()
        return max(metres / translation, radians / rotation), metres, radians

    def tracked(self, i: int, j: int) -> Array:
        """i_from_j (4, 4) by tracking."""
        return between(self._poses[i], self._poses[j])


def _stated_variances(nodes: Sequence[Node], constraints: Sequence[Constraint]) -> Array:
    """(N, 2) rad^2 and m^2 that the neighbour constraints up to each node sum up to."""
    steps = [c for c in constraints if c.kind is ConstraintKind.NEIGHBOUR]
    if not steps:
        return np.zeros((len(nodes), 2))
    ends = np.array([max(c.from_id, c.to_id) for c in steps])
    information = np.stack([c.information for c in steps])
    covariance = np.linalg.inv(information + 1e-9 * np.eye(6))
    largest = [np.linalg.eigvalsh(covariance[:, k : k + 3, k : k + 3])[:, -1] for k in (0, 3)]
    order = np.argsort(ends, kind="stable")
    total = np.cumsum(np.stack(largest, axis=1)[order], axis=0)
    known = np.searchsorted(ends[order], [node.id for node in nodes], "right")
    return np.concatenate([np.zeros((1, 2)), total])[known]
