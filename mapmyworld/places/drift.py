"""How far tracked poses may have drifted between two nodes: what a closure may correct."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.kernels.wheel_model import FIRST_SIGMAS
from mapmyworld.odometry.recorded_odometry import motion_covariance
from mapmyworld.types import Constraint, ConstraintKind, CorrectedOdometry, Node, Odometry

_HEADING = np.diag(FIRST_SIGMAS[4:])  # by distance, rad per m, and by rotation, rad per rad
WHEELS = Odometry, CorrectedOdometry
"""Sources of motions that wheels measured."""


class Drift:
    """Expected error of the tracked motion between any two nodes of a session.

    A step's is that of wheels, or what its neighbour constraints state where that is more, as
    after a camera was blind. Errors of heading differ from step to step; those of the distance are
    alike, as of a wheel's radius. Where wheels measured the motion its heading has such errors as
    well, as of unequal wheels and of a wrong wheelbase (`wheel_model.FIRST_SIGMAS`).
    """

    def __init__(self, nodes: Sequence[Node], constraints: Sequence[Constraint] = ()) -> None:
        self._poses = np.stack([node.tracked_from_base for node in nodes])
        self._sessions = np.array([node.session for node in nodes])
        steps = between(self._poses[:-1], self._poses[1:])
        lengths = np.linalg.norm(steps[:, :3, 3], axis=1)
        stated = np.diff(_stated_variances(nodes, constraints), axis=0)
        by_model = [motion_covariance(step, planar=False).diagonal()[[0, 3]] for step in steps]
        turned, moved = np.maximum(np.reshape(by_model, (-1, 2)), stated).T
        by_wheels = {c.to_id for c in constraints if isinstance(c.source, WHEELS)}
        alike = _HEADING @ np.stack([lengths, rotation_angle(steps)])
        alike *= [node.id in by_wheels for node in nodes[1:]]
        self._up_to = np.cumsum(np.stack([lengths, np.sqrt(moved), turned, *alike]), axis=1)
        self._up_to = np.concatenate([np.zeros((5, 1)), self._up_to], axis=1)

    def sigmas(self, i: int, j: int) -> tuple[float, float]:
        """Standard deviations (m, rad) of the tracked motion from node index i to j."""
        path, moved, turned, *alike = np.abs(self._up_to[:, i] - self._up_to[:, j]).tolist()
        rotation = float(np.hypot(np.sqrt(turned), np.hypot(*alike)))
        return float(moved + rotation * min(path / 4.0, 10.0)), rotation

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
