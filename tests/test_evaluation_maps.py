"""Scores of grids, loop closures and clouds: laws and cases with known answers."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmyworld.errors import MapError
from mapmyworld.evaluation import cloud_distances, grid_score, loop_closure_score
from mapmyworld.geometry.planar import planar_to_matrix, transform_points_planar
from mapmyworld.geometry.rigid import between
from mapmyworld.types import Mesh, OccupancyGrid, PointCloud, Trajectory


def room_grid(
    shift: tuple[float, float] = (0.0, 0.0), turn: float = 0.0, resolution: float = 0.05
) -> OccupancyGrid:
    """An L-shaped room with a pillar, moved as a whole and drawn afresh on a lattice."""
    corners = np.array([[0, 0], [6, 0], [6, 4], [3.5, 4], [3.5, 2.5], [0, 2.5], [0, 0]], float)
    pillar = np.array([[1, 1], [1.6, 1], [1.6, 1.4], [1, 1.4], [1, 1]], float)
    walls = np.concatenate([_dense(corners), _dense(pillar)])
    inside = np.stack(np.meshgrid(np.arange(0.1, 5.9, 0.02), np.arange(0.1, 2.4, 0.02)), -1)
    motion = np.array([*shift, turn])
    origin = np.array([-12.0, -12.0])
    cells = np.full((round(24 / resolution),) * 2, np.nan, np.float32)
    for points, value in ((inside.reshape(-1, 2), -4.0), (walls, 4.0)):
        index = (transform_points_planar(motion, points) - origin) / resolution
        column, row = np.floor(index).astype(int).T
        cells[row, column] = value
    return OccupancyGrid(cells, resolution, origin)


def _dense(outline: np.ndarray) -> np.ndarray:
    pieces = [a + np.linspace(0, 1, 400)[:, None] * (b - a) for a, b in itertools.pairwise(outline)]
    return np.concatenate(pieces)


def test_a_grid_agrees_with_itself_completely() -> None:
    score = grid_score(room_grid(), room_grid())
    for agreement in (score.unaligned, score.aligned):
        assert agreement.precision_1 == agreement.recall_1 == agreement.free == 1.0
    assert score.reference_from_grid.tolist() == [0.0, 0.0, 0.0]
    assert score.unknown == 0.0


@pytest.mark.parametrize(
    ("shift", "turn"), [((0.3, -0.2), 0.05), ((2.0, 1.0), 1.2), ((-3.0, 1.5), 3.0)]
)
def test_alignment_finds_a_moved_room(shift: tuple[float, float], turn: float) -> None:
    score = grid_score(room_grid(shift, turn), room_grid())
    assert score.unaligned.precision_1 < 0.5
    assert score.aligned.precision_1 > 0.97
    assert score.aligned.recall_1 > 0.97
    x, y, yaw = score.reference_from_grid
    assert np.cos(yaw + turn) == pytest.approx(1.0, abs=1e-4)
    moved = transform_points_planar(np.array([x, y, yaw]), np.array([[*shift]]))[0]
    assert np.abs(moved).max() < 0.04


def test_a_shift_by_cells_is_measured_in_cells() -> None:
    """A lone wall moved by two cells: nothing within one, everything within two."""
    cells = np.full((40, 40), -4.0, np.float32)
    cells[:, 20] = 4.0
    moved = np.full((40, 40), -4.0, np.float32)
    moved[:, 22] = 4.0
    score = grid_score(
        OccupancyGrid(moved, 0.05, np.zeros(2)), OccupancyGrid(cells, 0.05, np.zeros(2))
    )
    assert score.unaligned.precision_1 == 0.0
    assert score.unaligned.precision_2 == score.unaligned.recall_2 == 1.0
    assert score.aligned.precision_1 == 1.0


def test_a_phantom_wall_costs_precision_and_a_missing_one_recall() -> None:
    whole, cells = room_grid(), room_grid().log_odds.copy()
    cells[300:400, 100] = 4.0
    phantom = OccupancyGrid(cells, 0.05, whole.origin)
    score = grid_score(phantom, whole).unaligned
    assert score.precision_1 < 0.95
    assert score.recall_1 == 1.0
    assert grid_score(whole, phantom).unaligned.recall_1 < 0.95


def test_a_grid_without_walls_is_refused() -> None:
    empty = OccupancyGrid(np.full((5, 5), -4.0, np.float32), 0.05, np.zeros(2))
    with pytest.raises(MapError, match="reference"):
        grid_score(room_grid(), empty)


def square_drive() -> Trajectory:
    """Twice round a square, a pose a second."""
    turns = np.arange(80) / 40.0
    yaw = 2 * np.pi * turns
    poses = np.stack([5 * np.sin(yaw), 5 - 5 * np.cos(yaw), yaw], axis=1)
    return Trajectory(np.arange(80, dtype=np.int64) * 10**9, planar_to_matrix(poses))


def test_right_and_wrong_closures_are_reported_apart() -> None:
    truth = square_drive()
    pairs = np.array([[k, k + 40] for k in range(0, 40, 10)])
    stamps = truth.stamps_ns[pairs]
    measured = between(truth.poses[pairs[:, 0]], truth.poses[pairs[:, 1]])
    measured[1] = measured[1] @ planar_to_matrix([0.3, 0.0, 0.0])
    measured[2] = measured[2] @ planar_to_matrix([0.0, 0.0, np.radians(2.0)])
    score = loop_closure_score(stamps, measured, truth, stamps)
    assert score.right.tolist() == [True, False, False, True]
    assert score.precision == 0.5
    assert score.recall == 0.5


def test_without_closures_nothing_is_wrong_and_nothing_is_found() -> None:
    truth = square_drive()
    nothing = (np.zeros((0, 2), np.int64), np.zeros((0, 4, 4)))
    true_pairs = truth.stamps_ns[[[0, 40]]]
    score = loop_closure_score(*nothing, truth, true_pairs)
    assert (len(score.right), score.precision, score.recall) == (0, 1.0, 0.0)


@settings(max_examples=25)
@given(st.tuples(*[st.floats(-3, 3)] * 3))
def test_distance_to_a_box_is_the_analytic_one(point: tuple[float, float, float]) -> None:
    """A unit cube centred on the origin, seen from outside and from inside."""
    p = np.array(point)
    outside = np.maximum(np.abs(p) - 0.5, 0.0)
    expected = np.linalg.norm(outside) if outside.any() else (0.5 - np.abs(p)).min()
    found = cloud_distances(PointCloud(p[None].astype(np.float32)), unit_cube())
    assert found[0] == pytest.approx(expected, abs=1e-5)


def unit_cube() -> Mesh:
    from mapmyworld.simulation.solids import Box
    from mapmyworld.simulation.world import World, build_scene

    box = Box(0.0, 0.0, 1.0, 1.0, -0.5, 0.5, "wood")
    return build_scene(World("cube", "", (box,), ())).mesh()
