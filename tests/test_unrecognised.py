"""Revisited ground that nothing recognised: the notes about paths whose closures are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from sample_verdicts import REJECTED

from mapmyworld.geometry.rigid import make_transform, se3_exp
from mapmyworld.geometry.rotations import so3_exp
from mapmyworld.places.unrecognised import unrecognised_notes
from mapmyworld.types import ConstraintKind, Judged, Node, Poses

Array = NDArray[np.float64]
_LAP = 80  # nodes, 0.25 m apart, 10 a second


def laps(count: int, side: float = 5.0) -> list[Array]:
    """map_from_node (4, 4) of laps around a square, a node every 0.25 m; corners turn at once."""
    found = []
    for k in range(count * _LAP):
        edge, along = divmod(k % _LAP * 0.25, side)
        turned = so3_exp([0.0, 0.0, edge * np.pi / 2])
        corner = np.array([[0.0, 0.0], [side, 0.0], [side, side], [0.0, side]])[int(edge)]
        found.append(make_transform(turned, [*corner, 0.0] + turned @ [along, 0.0, 0.0]))
    return found


def solved(
    path: Sequence[Array], sessions: Sequence[int] | None = None
) -> tuple[list[Node], Poses]:
    ids = np.arange(1, len(path) + 1)
    belongs = [0] * len(path) if sessions is None else sessions
    nodes = [
        Node(k, belongs[k - 1], k * 100_000_000, pose, pose) for k, pose in enumerate(path, start=1)
    ]
    return nodes, Poses(ids, np.stack(path))


def closure(first: int, second: int, kind: ConstraintKind = ConstraintKind.LOOP_CLOSURE) -> Judged:
    return Judged(first, second, kind, np.eye(4), np.eye(6))


def closures(but: range = range(0)) -> list[Judged]:
    """Each node of the second lap with its like of the first, except some."""
    return [closure(i - _LAP, i) for i in range(_LAP + 1, 2 * _LAP + 1) if i not in but]


def test_the_section_without_a_closure_is_named_with_its_time_and_length() -> None:
    nodes, poses = solved(laps(2))
    reported = unrecognised_notes(nodes, poses, closures(range(101, 114)))
    assert len(reported) == 2
    assert "3.0 m of revisited path without loop closure" in reported[0]  # 12 steps of 0.25 m
    assert reported[1] == "not recognised at 10.10 s for 1.2 s (3.0 m, nodes 101 to 113)"


def test_what_was_recognised_everywhere_or_lacks_less_than_a_metre_is_worth_no_word() -> None:
    nodes, poses = solved(laps(2))
    assert unrecognised_notes(nodes, poses, closures()) == []
    assert unrecognised_notes(nodes, poses, closures(range(101, 105))) == []


def test_a_first_lap_and_ground_seen_the_other_way_round_are_not_known_ground() -> None:
    nodes, poses = solved(laps(1))
    assert unrecognised_notes(nodes, poses, ()) == []
    out = [make_transform(np.eye(3), [0.25 * k, 0.0, 0.0]) for k in range(40)]
    about = so3_exp([0.0, 0.0, np.pi])
    home = [make_transform(about, pose[:3, 3]) for pose in out[::-1]]
    assert unrecognised_notes(*solved(out + home), ()) == []
    assert unrecognised_notes(*solved(out + out), ()) != []


def test_rejected_closures_and_those_to_the_nodes_just_before_recognise_nothing() -> None:
    nodes, poses = solved(laps(2))
    rejected = [c.judged(REJECTED) for c in closures()]
    near = [closure(i, i + 2) for i in range(1, 2 * _LAP - 1)]
    for useless in (rejected, near):
        assert "nodes 81 to 160" in unrecognised_notes(nodes, poses, useless)[1]


def test_markers_and_other_sessions_recognise_too() -> None:
    nodes, poses = solved(laps(2))
    markers = [closure(i, -1, ConstraintKind.LANDMARK) for i in range(_LAP + 1, 2 * _LAP + 1)]
    assert unrecognised_notes(nodes, poses, markers) == []
    path = laps(1)[:6]  # 1.25 m, twice: only another session makes it known ground
    assert unrecognised_notes(*solved(path + path), ()) == []
    assert unrecognised_notes(*solved(path + path, [0] * 6 + [1] * 6), ()) != []


def test_five_sections_are_named_in_order_and_the_rest_counted() -> None:
    nodes, poses = solved(laps(2))
    gaps = [range(_LAP + 3 + 11 * k, _LAP + 9 + 11 * k + (k != 2)) for k in range(7)]
    kept = [c for c in closures() if not any(c.to_id in gap for gap in gaps)]
    reported = unrecognised_notes(nodes, poses, kept)
    assert len(reported) == 7
    assert reported[-1] == "shorter sections not recognised: 2"
    starts = [float(line.split()[3]) for line in reported[1:-1]]
    assert starts == sorted(starts)
    assert gaps[2][0] / 10 not in starts


@given(st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6))
def test_a_rigid_motion_of_the_map_changes_no_word(twist: list[float]) -> None:
    nodes, poses = solved(laps(2))
    moved = replace(poses, map_from_node=se3_exp(np.array(twist)) @ poses.map_from_node)
    useful = closures(range(101, 114))
    assert unrecognised_notes(nodes, moved, useful) == unrecognised_notes(nodes, poses, useful)


def test_single_nodes_and_empty_maps_are_fine() -> None:
    assert unrecognised_notes([], Poses(np.zeros(0, np.int64), np.zeros((0, 4, 4))), ()) == []
    nodes, poses = solved(laps(1)[:1])
    assert unrecognised_notes(nodes, poses, ()) == []
