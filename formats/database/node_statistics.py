"""Figures of each node under RTAB-Map's names, for the plots of its tools.

No timings: they differ from build to build, and the same log must give the same bytes.
"""

from __future__ import annotations

import functools
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.database.blobs import text_to_blob
from mapmyworld.geometry.rigid import between, invert
from mapmyworld.geometry.rotations import rotation_to_roll_pitch_yaw
from mapmyworld.types import ConstraintKind, ImageMatch, Judged, Node, Poses, ScanMatch

INSERT_STATISTICS = "INSERT INTO Statistics (id, stamp, data) VALUES (?,?,?)"
_CLOSURES = (ConstraintKind.LOOP_CLOSURE, ConstraintKind.PROXIMITY, ConstraintKind.USER)


def statistics_rows(
    nodes: Sequence[Node],
    constraints: Sequence[Judged],
    poses: Poses,
    feature_counts: Mapping[int, int],
    word_count: int,
) -> Iterator[tuple[int, float, bytes]]:
    """One row a node; a closure counts for the later of its two nodes."""
    place = {int(i): pose for i, pose in zip(poses.ids, poses.map_from_node, strict=True)}
    closures = defaultdict[int, list[Judged]](list)
    for constraint in constraints:
        if constraint.kind in _CLOSURES:
            closures[max(constraint.from_id, constraint.to_id)].append(constraint)
    at_base = _pose_figures("Loop/MapToBase", place)
    at_odom = _pose_figures("Loop/MapToOdom", _corrections(nodes, place))
    none = _closure_figures(0, (), place)
    for number, (node, travelled) in enumerate(zip(nodes, _travelled(nodes), strict=True)):
        tried = closures.get(node.id)
        figures = {
            "Loop/Map_id/": node.session,
            "Memory/Distance_travelled/m": travelled,
            "Memory/Working_memory_size/": number + 1,
            "Keypoint/Current_frame/words": feature_counts.get(node.id, 0),
            "Keypoint/Dictionary_size/words": word_count,
            **(_closure_figures(node.id, tried, place) if tried else none),
            **at_base.get(node.id, {}),
            **at_odom.get(node.id, {}),
        }
        yield node.id, node.stamp_ns * 1e-9, text_to_blob(_text(figures))


def _travelled(nodes: Sequence[Node]) -> list[float]:
    """Metres to each node, along the tracked path of all sessions."""
    tracked = np.array([node.tracked_from_base[:3, 3] for node in nodes]).reshape(-1, 3)
    sessions = np.array([node.session for node in nodes])
    steps = np.linalg.norm(np.diff(tracked, axis=0), axis=1) * (np.diff(sessions) == 0)
    return list(np.concatenate([np.zeros(min(len(nodes), 1)), np.cumsum(steps)]).tolist())


def _corrections(
    nodes: Sequence[Node], place: Mapping[int, NDArray[np.float64]]
) -> dict[int, NDArray[np.float64]]:
    """map_from_odom (4, 4) of every node that has a pose."""
    solved = [node for node in nodes if node.id in place]
    if not solved:
        return {}
    poses = np.array([place[node.id] for node in solved])
    back = invert(np.array([node.odom_from_base for node in solved]))
    return dict(zip([node.id for node in solved], poses @ back, strict=True))


def _closure_figures(
    node_id: int, tried: Sequence[Judged], place: Mapping[int, NDArray[np.float64]]
) -> dict[str, float]:
    """What was tried at a node, what was accepted, how well it fits."""
    loops = [c for c in tried if c.kind is not ConstraintKind.PROXIMITY]
    near = [c for c in tried if c.kind is ConstraintKind.PROXIMITY]
    accepted = [c for c in loops if c.accepted]
    best = max(loops, key=_score, default=None)
    kept = next((c for c in accepted if c is best), accepted[0] if accepted else None)
    added = [c for c in near if c.accepted]
    return {
        "Loop/Highest_hypothesis_id/": 0 if best is None else _other(best, node_id),
        "Loop/Highest_hypothesis_value/": 0.0 if best is None else _score(best),
        "Loop/Accepted_hypothesis_id/": 0 if kept is None else _other(kept, node_id),
        "Loop/RejectedHypothesis/": int(bool(loops) and kept is None),
        "Loop/Visual_inliers/": _inliers(best),
        "Loop/Optimization_max_error/m": max(
            (_residual(c, place) for c in tried if c.accepted), default=0.0
        ),
        "Proximity/Space_last_detection_id/": _other(added[-1], node_id) if added else 0,
        "Proximity/Space_detections_added_icp_multi/": len(added),
        "Proximity/Space_scan_paths_checked/": len(near),
    }


def _score(constraint: Judged) -> float:
    """Likelihood of a hypothesis, by what its finder calls it."""
    match constraint.source:
        case ImageMatch(posterior=posterior):
            return posterior
        case ScanMatch(score=score):
            return score
    return 0.0


def _inliers(best: Judged | None) -> int:
    return 0 if best is None or not isinstance(best.source, ImageMatch) else best.source.inliers


def _other(constraint: Judged, node_id: int) -> int:
    return constraint.from_id if constraint.to_id == node_id else constraint.to_id


def _residual(constraint: Judged, place: Mapping[int, NDArray[np.float64]]) -> float:
    """Metres between where a constraint puts its node and where optimisation put it."""
    if constraint.from_id not in place or constraint.to_id not in place:
        return 0.0
    solved = between(place[constraint.from_id], place[constraint.to_id])
    return float(np.linalg.norm(solved[:3, 3] - constraint.i_from_j[:3, 3]))


def _pose_figures(
    name: str, place: Mapping[int, NDArray[np.float64]]
) -> dict[int, dict[str, float]]:
    """Position and angles of each of the poses, id -> (4, 4)."""
    if not place:
        return {}
    poses = np.array(list(place.values()))
    angles = np.degrees(rotation_to_roll_pitch_yaw(poses[:, :3, :3]))
    columns = np.column_stack([poses[:, :3, 3], angles])
    names = [f"{name}_{axis}/m" for axis in "xyz"]
    names += [f"{name}_{axis}/deg" for axis in ("roll", "pitch", "yaw")]
    return {
        i: dict(zip(names, row, strict=True))
        for i, row in zip(place, columns.tolist(), strict=True)
    }


def _text(figures: Mapping[str, Any]) -> str:
    finite = {name: value for name, value in figures.items() if math.isfinite(value)}
    return _template(tuple(finite)) % finite


@functools.cache
def _template(names: tuple[str, ...]) -> str:
    """Figures of these names, six digits each, to be filled in."""
    return ";".join(f"{name}:%({name}).6g" for name in sorted(names)) + ";"
