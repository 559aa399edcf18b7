"""Places that other visits contradict, where a map fell apart and where things were moved."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from laser_rooms import cast
from numpy.typing import NDArray
from room_drive import drive

from cli.main import group
from mapmyworld.config import Config
from mapmyworld.geometry.planar import compose_planar
from mapmyworld.places import misplaced
from mapmyworld.places.laser_nodes import LaserNodes, laser_nodes
from mapmyworld.places.misplaced import Misplaced, misplaced_places
from mapmyworld.registration.scan_matching import prepare_scan, scan_set
from mapmyworld.stages import track_particles

Array = NDArray[np.float64]
BENT = np.array([1.0, 0.5, 0.35])


def walls_of(*corners: tuple[float, float]) -> Array:
    """Walls x0, y0, x1, y1 (m) along corners and back to the first one."""
    return np.array([[*a, *b] for a, b in zip(corners, (*corners[1:], corners[0]), strict=True)])


# A corridor 2 m wide round a block, with niches, and boxes that stand in it in one lap alone.
RING = np.concatenate([
    walls_of((0, 0), (5, 0), (5, -0.6), (5.8, -0.6), (5.8, 0), (12, 0), (12, 9), (0, 9)),
    walls_of((2, 2), (10, 2), (10, 4), (9.4, 4), (9.4, 4.7), (10, 4.7), (10, 7), (2, 7)),
])  # fmt: skip
BOXES = np.concatenate(
    [walls_of((x, y), (x + 0.9, y), (x + 0.9, y + 0.5), (x, y + 0.5)) for x, y in
     ((2.5, 0.0), (4.0, 1.5), (6.5, 0.0), (8.5, 1.5), (10.0, 3.0), (11.1, 5.0), (7.0, 7.0))]
)  # fmt: skip


def laps(count: int) -> Array:
    """Poses (N, 3), one each 0.25 m, along the middle of the ring."""
    corners = np.array([[1.0, 1.0], [11.0, 1.0], [11.0, 8.0], [1.0, 8.0]])
    poses = []
    for side in range(4 * count):
        a, b = corners[side % 4], corners[(side + 1) % 4]
        length = float(np.hypot(*(b - a)))
        heading = np.arctan2(*(b - a)[::-1])
        poses += [[*(a + way * (b - a) / length), heading] for way in np.arange(0, length, 0.25)]
    return np.array(poses)


TRUTH = laps(2)
LAP = len(TRUTH) // 2


def seen_from(believed: Array, later: Array = RING) -> LaserNodes:
    """What is seen along the true path, in the second lap of walls `later`, thought elsewhere."""
    config = Config().registration
    scans = scan_set([
        prepare_scan(cast(pose, RING if k < LAP else later, k), config)
        for k, pose in enumerate(TRUTH)
    ])  # fmt: skip
    return laser_nodes(np.arange(1, len(TRUTH) + 1), scans, believed)


def bent() -> Array:
    return np.concatenate([TRUTH[:LAP], compose_planar(BENT, TRUTH[LAP:])])


def test_two_laps_that_lie_right_go_with_each_other() -> None:
    found = misplaced_places(seen_from(TRUTH))
    assert found.compared >= 12
    assert not found.rows
    assert not found.fell_apart


def test_a_lap_that_lies_beside_the_first_one_fell_apart() -> None:
    found = misplaced_places(seen_from(bent()))
    assert len(found.rows) >= 3
    assert found.fell_apart


def test_boxes_that_were_moved_meanwhile_misplace_nothing() -> None:
    later = np.concatenate([RING, BOXES])
    assert not misplaced_places(seen_from(TRUTH, later)).fell_apart
    assert misplaced_places(seen_from(bent(), later)).fell_apart


def test_nodes_that_see_nothing_and_components_without_a_tie_are_not_compared() -> None:
    nodes = seen_from(bent())
    second = np.arange(len(TRUTH)) >= LAP
    assert not misplaced_places(replace(nodes, sees=~second)).rows
    assert not misplaced_places(replace(nodes, session=second.astype(np.int64))).rows
    assert misplaced_places(replace(nodes, sees=np.zeros_like(second))).compared == 0


def test_one_place_in_a_hundred_is_chance_and_five_are_not() -> None:
    assert not Misplaced(0, ()).fell_apart
    assert not Misplaced(150, (7,)).fell_apart
    assert Misplaced(150, (7, 8, 9, 50, 51, 52)).fell_apart
    assert Misplaced(20, (1, 2, 3)).fell_apart


@pytest.mark.parametrize(
    ("method", "words"),
    [("graph", "the map contradicts itself"), ("fastslam", "the particle filter diverged")],
)
def test_a_map_that_fell_apart_ends_with_exit_code_3(
    method: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "room.mcap"
    drive().write(log)

    def build(out: str) -> Any:
        arguments = ["build", str(log), "-o", str(tmp_path / out), "--method", method, "-q"]
        few = ["--set", "particles.count=3"]
        return CliRunner().invoke(group, [*arguments, *few], catch_exceptions=False)

    assert build("sound.db").exit_code == 0

    def fallen(nodes: LaserNodes) -> Misplaced:
        return Misplaced(20, (0, 3, 5, 6, 8))

    monkeypatch.setattr(misplaced, "misplaced_places", fallen)
    monkeypatch.setattr(track_particles, "misplaced_places", fallen)
    built = build("map.db")
    assert built.exit_code == 3
    assert words in built.stderr
    assert "5 of 20 places do not go with what was seen there at another time" in built.stderr
