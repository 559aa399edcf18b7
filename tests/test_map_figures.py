"""Path, duration, closures and components of a map: the same wherever they are shown."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from room_drive import drive
from sample_verdicts import REJECTED

from cli.main import group
from cli.report import report_contents
from formats.database import MemoryMap, open_store
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.map_figures import map_figures
from mapmyworld.types import (
    ConstraintKind,
    Judged,
    LaserTracking,
    Node,
    NodeData,
    Poses,
    Source,
    TrackedFrames,
)
from mapmyworld.types.sources import GIVEN

S = 1_000_000_000
LOST = LaserTracking("lost", 0.0, lost=True)


def shown(*words: object) -> dict[str, object]:
    found = CliRunner().invoke(group, [*map(str, words), "--format", "json"])
    assert found.exit_code in (0, 3), found.output
    return dict(json.loads(found.stdout))


def test_terminal_report_and_inspect_show_the_same(tmp_path: Path) -> None:
    """They gave 3.5 m in 28 s, 2.6 m in 24 s and 2.7 m in 23.6 s for one map."""
    log, path = tmp_path / "log.mcap", tmp_path / "map.db"
    room = drive(60)
    late = [  # wheels that are recorded before and after the scans
        (topic, replace(message, stamp_ns=message.stamp_ns + shift), at + shift)  # type: ignore[type-var]
        for topic, message, at in (next(e for e in room.entries if e[0] == "/odom"),)
        for shift in (-4 * S, 20 * S)
    ]
    replace(room, entries=(late[0], *room.entries, late[1])).write(log)
    built = shown("build", log, "-o", path, "-q")
    inspected, graph = shown("inspect", "map", path), shown("inspect", "graph", path)
    with open_store(path, read_only=True) as store:
        page = dict(report_contents(store).headline)
        verdict = report_contents(store).verdict
    assert built["duration_s"] == inspected["duration_s"] == pytest.approx(5.9)
    assert built["distance_m"] == inspected["length_m"] == pytest.approx(6.3, abs=0.1)
    assert page["time"] == f"{built['duration_s']:.0f} s"
    assert page["path"] == f"{built['distance_m']:.1f} m"
    assert built["constraints"] == graph["constraints"]
    kinds = built["constraints"]
    assert isinstance(kinds, dict)
    closures = [row for kind, row in kinds.items() if kind in ("loop_closure", "proximity")]
    counted = {name: sum(row[name] for row in closures) for name in inspected["closures"]}  # type: ignore[attr-defined]
    assert counted == inspected["closures"]
    assert page["closures"] == f"{counted['accepted']} accepted of {counted['tried']} tried"
    assert "closures accepted" not in verdict  # which counted those that reached the solver only
    assert inspected["components"] == len(graph["components"]) == 1  # type: ignore[arg-type]


def lost_and_found(divides: list[int], *more: Judged) -> MemoryMap:
    """Six nodes a metre apart; before the fourth, 10 m on, tracking was lost; two sessions."""
    store = MemoryMap()
    places = [0.0, 1.0, 2.0, 12.0, 13.0, 50.0]
    poses = planar_to_matrix(np.array([[x, 0.0, 0.0] for x in places]))
    with store.write_stage("track", ""):
        for k, pose in enumerate(poses):
            node = Node(k + 1, int(k == 5), k * S, pose, pose)
            store.add_node(node, NodeData())
        count = len(places)
        eye = np.broadcast_to(np.eye(4), (count, 4, 4)).copy()
        stamps, ids = np.arange(count) * S, np.arange(1, count + 1)
        store.set_tracked_frames(TrackedFrames(stamps, ids, eye, np.ones(count, bool), None))
    with store.write_stage("optimise", ""):
        store.add_constraints(
            [link(k, k + 1, source=LOST if k == 3 else GIVEN) for k in range(1, 5)] + list(more)
        )
        store.set_poses(Poses(np.arange(1, count + 1), poses))
        store.put("solve", {"divides": divides})
    return store


def link(a: int, b: int, kind: str = "neighbour", source: Source = GIVEN) -> Judged:
    return Judged(a, b, ConstraintKind(kind), np.eye(4), np.eye(6), source)


def test_what_is_jumped_is_no_path() -> None:
    figures = map_figures(lost_and_found([]))
    assert figures.path_m == pytest.approx(3.0)  # neither across the loss nor to session two
    assert figures.duration_s == pytest.approx(4.0)
    assert (figures.nodes, figures.frames, figures.sessions) == (6, 6, 2)


def test_a_loss_of_tracking_ties_nothing_unless_wheels_led_on_or_a_closure_does() -> None:
    session = link(5, 6, "loop_closure")
    assert map_figures(lost_and_found([], session)).components == ((1, 6, 6),)
    assert map_figures(lost_and_found([4], session)).components == ((1, 3, 3), (4, 6, 3))
    closed = link(1, 5, "loop_closure")
    assert len(map_figures(lost_and_found([4], session, closed)).components) == 1
    refused = closed.judged(REJECTED)
    figures = map_figures(lost_and_found([4], session, refused))
    assert len(figures.components) == 2
    assert figures.closures == {"tried": 2, "accepted": 1, "rejected": 1}
