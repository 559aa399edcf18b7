"""By how much whole sweeps err while the robot moves, from how unsteady the tracked path is.

Within a sweep the robot's motion is known only as well as its wheels measure it, or not at all: it
comes out turned and shifted, each by itself. Robots keep on as they move, sweeps that err do not:
the second differences of the path hold six times the variance of one. Their median is that of
steady driving.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import OdometryConfig
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import between_planar, matrix_to_planar, wrap_angle
from mapmyworld.kernels.wheel_model import MOVES
from mapmyworld.types import Node, TrackedFrames

SIGMAS_PER_MEDIAN = 1.4826
"""Standard deviations of a normal distribution in a median of absolute deviations."""


def sweep_variances(
    nodes: Sequence[Node], frames: TrackedFrames, known: Array, config: OdometryConfig
) -> Array:
    """(N, 3) variances of the nodes' sweeps by their motion, in x, y, yaw of the robot; `known`
    (3,) are those that their points explain.
    """
    at = {node.id: row for row, node in enumerate(nodes)}
    used = np.isin(frames.node_ids, list(at))
    row = np.array([at[i] for i in frames.node_ids[used].tolist()])
    tracked = np.stack([node.tracked_from_base for node in nodes])
    poses = matrix_to_planar(tracked[row] @ frames.node_from_frame[used])
    step = between_planar(poses[:-1], poses[1:])
    step[:, 2] = wrap_angle(step[:, 2])
    longest = config.keyframe_distance
    turned = np.abs(step[:, 2]) * longest / config.keyframe_angle
    lengths = np.hypot(step[:, 0], step[:, 1]) + turned
    around = 0.5 * (np.append(lengths, lengths[-1:]) + np.insert(lengths, 0, lengths[:1]))
    moved = np.zeros(len(nodes))
    is_node = frames.is_node[used]
    moved[row[is_node]] = np.minimum(around[is_node], longest)
    moving = around[1:-1] > MOVES
    steady = moving & (around[1:-1] < longest)
    if 2 * np.count_nonzero(steady) <= np.count_nonzero(moving):
        return np.zeros((len(nodes), 3))
    return moved[:, None] * _per_metre(step, frames.stamps_ns[used], around[1:-1], steady, known)


def _per_metre(
    step: Array, stamps_ns: Index, lengths: Array, steady: NDArray[np.bool_], known: Array
) -> Array:
    """(3,) variances of a sweep by its motion, for every metre from frame to frame."""
    spans = np.maximum(np.diff(stamps_ns) * 1e-9, 1e-6)
    uneven = step[1:] - step[:-1] * (spans[1:] / spans[:-1])[:, None]
    lengths = lengths[steady]
    sigmas = SIGMAS_PER_MEDIAN * np.median(
        np.abs(uneven[steady]) / np.sqrt(lengths)[:, None], axis=0
    )
    return np.asarray(np.maximum(sigmas**2 / 6.0 - known / np.median(lengths), 0.0))
