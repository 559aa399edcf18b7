"""Which moments become nodes, and the neighbour constraints between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import SensingConfig
from mapmyworld.geometry import between, invert, rotation_angle, se3_adjoint
from mapmyworld.types import Constraint, ConstraintKind, Frame, Node

_ROUNDING = 1e-6  # share of the distance, so that ten steps of a centimetre are ten
_PATIENCE = 1.5  # times the distance that a due node waits for a frame with an image


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """What a tracker says of one frame."""

    tracked_from_base: NDArray[np.float64]
    """(4, 4)."""
    covariance: NDArray[np.float64]
    """(6, 6), rotation first, of the motion since the previous frame, in this frame's base."""
    reason: str
    """Where the motion comes from, in words."""


class NodeSelector:
    """Makes a node of the first frame and of each that moved far enough since the last one."""

    def __init__(self, config: SensingConfig, *, wants_images: bool) -> None:
        self.config, self.wants_images = config, wants_images
        self.nodes = 0
        self.session = 0
        self._last: Node | None = None
        self._covariance = np.zeros((6, 6))
        self._previous = np.eye(4)

    def consider(self, frame: Frame, motion: Motion) -> tuple[Node | None, Constraint | None]:
        """The node that the frame becomes, if it does, and its constraint to the one before."""
        pose = motion.tracked_from_base
        self._grow(pose, motion.covariance)
        if self._last is not None and not self._is_due(frame, pose):
            return None, None
        self.nodes += 1
        odometry = pose if frame.odom_from_base is None else frame.odom_from_base
        node = Node(
            id=self.nodes,
            session=self.session,
            stamp_ns=frame.stamp_ns,
            odom_from_base=odometry,
            tracked_from_base=pose,
            ground_truth=frame.ground_truth,
        )
        constraint = None if self._last is None else self._neighbour(self._last, node, motion)
        self._last, self._covariance = node, np.zeros((6, 6))
        return node, constraint

    @property
    def last(self) -> Node | None:
        """The newest node."""
        return self._last

    def _grow(self, pose: NDArray[np.float64], covariance: NDArray[np.float64]) -> None:
        """Carries the covariance of the motion since the last node on to this frame."""
        adjoint = se3_adjoint(invert(between(self._previous, pose)))
        self._covariance = adjoint @ self._covariance @ adjoint.T + covariance
        self._previous = pose

    def _is_due(self, frame: Frame, pose: NDArray[np.float64]) -> bool:
        assert self._last is not None
        moved = between(self._last.tracked_from_base, pose)
        share = max(
            float(np.linalg.norm(moved[:3, 3])) / max(self.config.node_distance, 1e-9),
            float(rotation_angle(moved)) / max(self.config.node_angle, 1e-9),
        )
        waits = self.wants_images and not frame.images
        return share >= (_PATIENCE if waits else 1.0) - _ROUNDING

    def _neighbour(self, last: Node, node: Node, motion: Motion) -> Constraint:
        measured = between(last.tracked_from_base, node.tracked_from_base)
        return Constraint(
            from_id=last.id,
            to_id=node.id,
            kind=ConstraintKind.NEIGHBOUR,
            from_from_to=measured,
            information=np.asarray(np.linalg.inv(self._covariance + 1e-12 * np.eye(6))),
            reason=motion.reason,
        )
