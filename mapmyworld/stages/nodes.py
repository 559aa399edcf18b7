"""Which moments become nodes, and the neighbour constraints between them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import SensingConfig
from mapmyworld.geometry.rigid import invert, se3_adjoint
from mapmyworld.kernels.wheel_model import MEMORY
from mapmyworld.odometry.unobserved_motion import GOES_ON
from mapmyworld.types import ConstraintKind, Frame, Judged, LaserTracking, Node, Source

_ROUNDING = 1e-6  # share of the distance, so that ten steps of a centimetre are ten
_GAP = 10.0  # times as long as it usually takes to the next frame is unusual
_PATIENCE = 1.5  # times the distance that a due node waits for a frame with an image


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """What a tracker reports about one frame."""

    tracked_from_base: NDArray[np.float64]
    """(4, 4)."""
    covariance: NDArray[np.float64]
    """(6, 6), rotation first, of the motion since the previous frame, in this frame's base."""
    source: Source
    """Where the motion comes from."""
    fits_nothing: bool = False
    """Whether what is seen from here on fits nothing that was seen before."""

    @property
    def is_tracking_loss(self) -> bool:
        """Whether nothing is known of it: the robot was lost."""
        return isinstance(self.source, LaserTracking) and self.source.lost


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """The way from a node to the next one: what makes their constraint."""

    from_id: int
    i_from_j: NDArray[np.float64]
    """(4, 4), of the next node in the frame of `from_id`."""
    next_from_map: NDArray[np.float64]
    """(4, 4)."""
    motions: list[Motion]
    """Of the frames since the node, up to the next one."""
    source: Source


def _uncertainty(motion: Motion) -> tuple[bool, float]:
    return motion.is_tracking_loss, float(motion.covariance.trace())


class NodeSelector:
    """Makes a node of the first frame and of each that moved far enough since the last one."""

    def __init__(self, config: SensingConfig, *, wants_images: bool) -> None:
        self.config, self.wants_images = config, wants_images
        self.last: Node | None = None
        """The newest node."""
        self._last_from_map = np.eye(4)
        self._since: list[Motion] = []
        self._before_ns: int | None = None
        self._usual = 0.0  # s from frame to frame

    def consider(
        self, frame: Frame, motion: Motion
    ) -> tuple[Node | None, Step | None, NDArray[np.float64]]:
        """The node that the frame becomes, if it does, the way to it from the one before, and the
        frame's pose (4, 4) in its node: itself, or the last one.
        """
        self._since.append(motion)
        pose, last = motion.tracked_from_base, self.last
        moved = self._last_from_map @ pose
        after_gap = self._is_gap(frame.stamp_ns)
        anew = motion.is_tracking_loss or motion.fits_nothing or after_gap
        if last is not None and not anew and not self._is_due(frame, moved):
            return None, None, moved
        odometry = pose if frame.odom_from_base is None else frame.odom_from_base
        node = Node(
            id=1 if last is None else last.id + 1,
            session=0,
            stamp_ns=frame.stamp_ns,
            odom_from_base=odometry,
            tracked_from_base=pose,
            ground_truth=frame.ground_truth,
            gps=frame.gps,
        )
        self._last_from_map = invert(pose)
        source = max(self._since, key=_uncertainty).source
        if isinstance(source, LaserTracking) and after_gap:
            source = replace(source, after_gap=True)
        step = None
        if last is not None:
            step = Step(last.id, moved, self._last_from_map, self._since, source)
        self.last, self._since = node, []
        return node, step, np.eye(4)

    def _is_gap(self, stamp_ns: int) -> bool:
        """Whether the log has no frame for unusually long before this one."""
        before, self._before_ns = self._before_ns, stamp_ns
        if before is None:
            return False
        took = 1e-9 * (stamp_ns - before)
        usual = self._usual or took
        self._usual = MEMORY * usual + (1.0 - MEMORY) * min(took, _GAP * usual)
        return took > max(GOES_ON, _GAP * usual)

    def _is_due(self, frame: Frame, moved: NDArray[np.float64]) -> bool:
        # Of one motion, plain numbers take a fifth of numpy's time.
        (xx, xy, xz, x), (yx, yy, yz, y), (zx, zy, zz, z), _ = moved.tolist()
        turn = math.atan2(math.hypot(zy - yz, xz - zx, yx - xy), xx + yy + zz - 1.0)
        share = max(
            math.hypot(x, y, z) / max(self.config.node_distance, 1e-9),
            turn / max(self.config.node_angle, 1e-9),
        )
        waits = self.wants_images and all(image.depth is None for image in frame.images)
        return share >= (_PATIENCE if waits else 1.0) - _ROUNDING


def neighbours(steps: Sequence[Step]) -> list[Judged]:
    """The constraints of ways between nodes; each step's covariance is carried to the way's end."""
    lengths = np.array([len(step.motions) for step in steps])
    way = np.arange(len(steps)).repeat(lengths)
    motions = [motion for step in steps for motion in step.motions]
    covariances = np.array([motion.covariance for motion in motions])
    ends = np.array([step.next_from_map for step in steps])
    adjoint = se3_adjoint(ends[way] @ np.array([motion.tracked_from_base for motion in motions]))
    carried = adjoint @ covariances @ adjoint.transpose(0, 2, 1)
    alone = (lengths == 1)[way]  # these end there themselves
    carried[alone] = covariances[alone]
    summed = np.zeros((len(steps), 6, 6))
    np.add.at(summed, way, carried)
    information = np.linalg.inv(summed + 1e-12 * np.eye(6))
    return [
        Judged(
            from_id=step.from_id,
            to_id=step.from_id + 1,
            kind=ConstraintKind.NEIGHBOUR,
            i_from_j=step.i_from_j,
            information=one,
            source=step.source,
        )
        for step, one in zip(steps, information, strict=True)
    ]
