"""The final pose of every tracked frame, nodes or not."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.rigid import between, interpolate, invert
from mapmyworld.types import Constraint, Node, Poses, TrackedFrames

_BLOCK = 4096  # frames whose poses are found together: what that takes does not grow with the log


def pose_every_frame(
    nodes: Sequence[Node],
    poses: Poses,
    frames: TrackedFrames,
    constraints: Iterable[Constraint] = (),
) -> NDArray[np.float64]:
    """`map_from_frame` (F, 4, 4): frames between two nodes share out what solving moved them.

    A frame follows its node at first and the next node at last, in proportion to its place among
    the frames between them, so that the path has no steps. Frames after the last node of a session,
    or before one of the `constraints` that interrupt tracking, follow it alone.
    """
    row_of_id = {int(i): row for row, i in enumerate(poses.ids)}
    solved = np.stack([poses.map_from_node[row_of_id[node.id]] for node in nodes])
    tracked = np.stack([node.tracked_from_base for node in nodes])
    index_of_id = {node.id: index for index, node in enumerate(nodes)}
    here = np.array([index_of_id[int(i)] for i in frames.node_ids], np.int64)
    if len(nodes) == 1:
        return np.asarray(solved[here] @ frames.node_from_frame)
    after = np.minimum(here + 1, len(nodes) - 1)
    sessions = np.array([node.session for node in nodes])
    lost = {c.to_id for c in constraints if c.interrupts_tracking}
    goes_on = (after > here) & (sessions[after] == sessions[here])
    goes_on &= ~np.array([node.id in lost for node in nodes])[after]
    share = np.where(goes_on, _share_of_path(here, len(nodes)), 0.0)
    step = invert(between(tracked[:-1], tracked[1:]))
    result = np.empty((len(here), 4, 4))
    for first in range(0, len(here), _BLOCK):
        some = slice(first, first + _BLOCK)
        seen, node = frames.node_from_frame[some], here[some]
        by_next = solved[after[some]] @ step[np.minimum(node, len(nodes) - 2)] @ seen
        result[some] = interpolate(solved[node] @ seen, by_next, share[some])
    return result


def _share_of_path(here: NDArray[np.int64], count: int) -> NDArray[np.float64]:
    """How far (F,) a frame is from its node (0) to the next one (towards 1), counted in frames."""
    first = np.searchsorted(here, np.arange(count + 1))
    place = np.arange(len(here)) - first[here]
    return np.asarray(place / np.maximum(first[here + 1] - first[here], 1))
