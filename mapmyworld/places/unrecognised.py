"""Where a path came back to known ground and no image recognised it, for the user to read."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.odometry.tracking_losses import NAMED
from mapmyworld.places.image_proposals import NEAR, NEAR_ANGLE
from mapmyworld.types import CLOSURES, ConstraintKind, Judged, Node, Poses

_AWAY = 2.0 * NEAR  # m travelled and rad turned between them; what is nearer, tracking ties
_LEAST = 1.0  # m of a section that is worth a word


def unrecognised_notes(
    nodes: Sequence[Node], poses: Poses, constraints: Iterable[Judged]
) -> list[str]:
    """A line for each section, by the solved poses; none where all known ground was recognised."""
    if len(nodes) < 2:
        return []
    rows = np.searchsorted(poses.ids[poses.ids > 0], [node.id for node in nodes])
    placed = poses.map_from_node[rows]
    path = _path_of(placed, np.array([node.session for node in nodes]))
    lost = _back(placed, path, ~_recognised(nodes, path, constraints))
    sections = [(_metres(placed, run), run) for run in _runs(lost)]
    return _lines(nodes, [(metres, run) for metres, run in sections if metres >= _LEAST])


def _path_of(placed: Array, sessions: NDArray[np.int64]) -> Array:
    """(N,) metres travelled and radians turned up to each node; far apart between sessions."""
    steps = between(placed[:-1], placed[1:])
    gone = np.linalg.norm(steps[:, :3, 3], axis=1) + rotation_angle(steps)
    gone[np.diff(sessions) != 0] += _AWAY
    return np.concatenate([[0.0], np.cumsum(gone)])


def _recognised(
    nodes: Sequence[Node], path: Array, constraints: Iterable[Judged]
) -> NDArray[np.bool_]:
    """(N,) nodes that a closure ties to another place along the path, or that saw a marker."""
    index = {node.id: k for k, node in enumerate(nodes)}
    known = np.zeros(len(nodes), np.bool_)
    for c in constraints:
        if not c.accepted:
            continue
        ends = [index[i] for i in (c.from_id, c.to_id) if i in index]
        if c.kind is ConstraintKind.LANDMARK or (
            c.kind in CLOSURES and np.ptp(path[ends]) >= _AWAY
        ):
            known[ends] = True
    return known


def _back(placed: Array, path: Array, asked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(N,) those asked for that stand where an earlier node stood, and look where it looked."""
    tree, found = cKDTree(placed[:, :3, 3]), np.zeros(len(placed), np.bool_)
    for i in np.flatnonzero(asked).tolist():
        near = np.array(tree.query_ball_point(placed[i, :3, 3], NEAR))
        near = near[path[i] - path[near] >= _AWAY]
        turned = np.degrees(rotation_angle(between(placed[i], placed[near])))
        found[i] = (turned <= NEAR_ANGLE).any()
    return found


def _runs(marked: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last index of each run of marked nodes."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]])))
    return [(a, b - 1) for a, b in pairwise(edges.tolist())][::2]


def _metres(placed: Array, run: tuple[int, int]) -> float:
    path = placed[run[0] : run[1] + 1, :3, 3]
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def _lines(nodes: Sequence[Node], sections: list[tuple[float, tuple[int, int]]]) -> list[str]:
    if not sections:
        return []
    total, count = sum(metres for metres, _ in sections), len(sections)
    head = (
        f"{total:.1f} m of revisited path without loop closure: position there relies on odometry"
    )
    longest = sorted(sections, key=lambda section: -section[0])[:NAMED]
    named = [_text(nodes, *section) for section in sorted(longest, key=lambda s: s[1])]
    rest = [f"shorter sections not recognised: {count - NAMED}"] if count > NAMED else []
    return [head, *named, *rest]


def _text(nodes: Sequence[Node], metres: float, run: tuple[int, int]) -> str:
    first, last = nodes[run[0]], nodes[run[1]]
    start, seconds = first.stamp_ns * 1e-9, (last.stamp_ns - first.stamp_ns) * 1e-9
    return (
        f"not recognised at {start:.2f} s for {seconds:.1f} s "
        f"({metres:.1f} m, nodes {first.id} to {last.id})"
    )
