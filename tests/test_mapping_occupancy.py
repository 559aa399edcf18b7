"""The occupancy grid: by hand, against a plain references, and against what must not matter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmyworld.config import Config, MappingConfig
from mapmyworld.config.settings import apply_settings
from mapmyworld.errors import MapError
from mapmyworld.kernels.rays import clear_passed, count_scans
from mapmyworld.mapping.occupancy import build_grid, log_odds_in_place
from mapmyworld.types import OccupancyGrid, Scan


def scan_of(points: list[list[float]], missing: list[float] | None = None) -> Scan:
    return Scan(
        np.array(points, np.float32).reshape(-1, 2),
        np.zeros(3),
        np.array(missing or [], np.float32),
        10.0,
        0.01,
    )


def cell(grid: OccupancyGrid, x: float, y: float) -> float:
    column, row = np.floor((np.array([x, y]) - grid.origin) / grid.resolution + 1e-9).astype(int)
    return float(grid.log_odds[row, column])


def test_one_beam_by_hand() -> None:
    """From (0.025, 0.025) along x to 0.325: six cells passed, the seventh hit, nothing behind."""
    config = Config()
    grid = build_grid([(np.array([0.025, 0.025, 0.0]), scan_of([[0.3, 0.0]]))], config)
    free = np.log(config.mapping.miss_probability / (1 - config.mapping.miss_probability))
    occupied = np.log(config.mapping.hit_probability / (1 - config.mapping.hit_probability))
    for column in range(6):
        assert cell(grid, 0.05 * column + 0.01, 0.01) == pytest.approx(free, rel=1e-5)
    assert cell(grid, 0.31, 0.01) == pytest.approx(occupied, rel=1e-5)
    assert np.isfinite(grid.log_odds).sum() == 7


def test_a_way_that_was_seen_to_be_free_is_passed_and_nothing_is_hit() -> None:
    """Along x from a base that stands at (0.025, 0.025) and looks along y: up the y axis."""
    scan = replace(scan_of([]), passed=np.array([[0.3, 0.0]], np.float32))
    grid = build_grid([(np.array([0.025, 0.025, np.pi / 2]), scan)], Config())
    assert np.isfinite(grid.log_odds).sum() == 6
    assert (grid.log_odds[np.isfinite(grid.log_odds)] < 0).all()
    assert cell(grid, 0.01, 0.26) < 0


def test_log_odds_add_up_as_bayes_says_and_stop_at_the_clamp() -> None:
    """Two hits and a pass by Bayes' rule on one cell with an even prior."""
    mapping = MappingConfig()
    odds = (0.7 / 0.3) ** 2 * (0.35 / 0.65)
    found = log_odds_in_place(np.array([[[2, 1], [500, 0], [0, 0]]], np.uint16), mapping)
    assert found[0, 0] == pytest.approx(np.log(odds), rel=1e-5)
    assert found[0, 1] == pytest.approx(np.log(0.97 / 0.03), rel=1e-5)
    assert np.isnan(found[0, 2])


def passed_cells(x0: float, y0: float, x1: float, y1: float) -> set[tuple[int, int]]:
    """The plain references: cells that a finely sampled segment enters, the last one left out."""
    t = np.linspace(0.0, 1.0, 200_001)
    x, y = np.floor(x0 + t * (x1 - x0)).astype(int), np.floor(y0 + t * (y1 - y0)).astype(int)
    return set(zip(y.tolist(), x.tolist(), strict=True)) - {(int(y1), int(x1))}


coordinates = st.floats(0.01, 19.99)


@settings(max_examples=30)
@given(coordinates, coordinates, coordinates, coordinates)
def test_a_ray_visits_the_cells_that_it_crosses(x0: float, y0: float, x1: float, y1: float) -> None:
    """Cells whose corner the ray only grazes, closer than the sampling, may differ."""
    counts = np.zeros((20, 20, 2), np.uint16)
    marks = np.zeros((20, 20), np.uint8)
    start, end = np.array([[x0, y0]]), np.array([[x1, y1]])
    count_scans(counts, marks, start, end, np.array([True]), np.array([0, 1]))
    hits, passes = counts[:, :, 0], counts[:, :, 1]
    found = set(zip(*(axis.tolist() for axis in np.nonzero(passes)), strict=True))
    wanted = passed_cells(x0, y0, x1, y1)
    length = abs(int(x1) - int(x0)) + abs(int(y1) - int(y0))
    assert wanted <= found | {(int(y1), int(x1))}
    assert len(found) <= max(length, 0)
    assert hits.sum() == 1
    cells = np.full((20, 20), 7, np.uint8)
    clear_passed(cells, start, end, np.array([0, 1]))
    assert np.array_equal(cells == 0, passes > 0)


def test_the_order_of_scans_does_not_matter_and_the_canvas_grows_to_all_sides() -> None:
    rng = np.random.default_rng(3)
    scans = [
        (rng.uniform(-20, 20, 3), scan_of(rng.uniform(-5, 5, (40, 2)).tolist())) for _ in range(30)
    ]
    there, back = build_grid(scans, Config()), build_grid(scans[::-1], Config())
    assert there.origin.tolist() == back.origin.tolist()
    assert np.array_equal(there.log_odds, back.log_odds, equal_nan=True)


@pytest.mark.parametrize("range_max", [0.5, 30.0, 1e6])
def test_places_that_are_known_beforehand_change_nothing(range_max: float) -> None:
    """Neither where a few of them are wrong, nor where scans may reach farther than any map."""
    config = apply_settings(Config(), {"mapping.range_max": range_max})
    rng = np.random.default_rng(4)
    poses = rng.uniform(-20, 20, (30, 3))
    scans = [(pose, scan_of(rng.uniform(-5, 5, (40, 2)).tolist())) for pose in poses]
    known = build_grid(scans, config, np.append(poses[:10, :2], [[np.nan, 0.0]], axis=0))
    grown = build_grid(scans, config)
    assert known.origin.tolist() == grown.origin.tolist()
    assert np.array_equal(known.log_odds, grown.log_odds, equal_nan=True)


def test_more_scans_than_marks_count_each_cell_once_a_scan() -> None:
    """400 scans along a way that turns back, in two orders: marks begin anew at other scans."""
    random = np.random.default_rng(5)
    ways = np.concatenate([np.linspace(0.0, 30.0, 250), np.linspace(30.0, -20.0, 150)])
    scans = [
        (np.array([x, -0.3 * x, x]), scan_of(random.normal(0.0, 4.0, (20, 2)).tolist()))
        for x in ways
    ]
    there, back = build_grid(scans, Config()), build_grid(scans[::-1], Config())
    np.testing.assert_array_equal(there.log_odds, back.log_odds)
    np.testing.assert_array_equal(there.origin, back.origin)
    assert there.log_odds.size > 100_000


def test_a_beam_without_return_clears_nothing_unless_asked() -> None:
    still = np.array([0.02, 0.02, 0.0])
    scan = scan_of([[0.0, 1.0]], missing=[0.0])
    silent = build_grid([(still, scan)], Config())
    clearing = apply_settings(Config(), {"mapping.missing_range": 2.0})
    cleared = build_grid([(still, scan)], clearing)
    assert np.isfinite(silent.log_odds).sum() == 21
    assert np.isfinite(cleared.log_odds).sum() > 21 + 35


def test_a_return_beyond_the_range_clears_the_way_and_marks_no_wall() -> None:
    config = apply_settings(Config(), {"mapping.range_max": 1.0})
    grid = build_grid([(np.array([0.02, 0.02, 0.0]), scan_of([[3.0, 0.0]]))], config)
    assert np.nanmax(grid.log_odds) < 0
    assert cell(grid, 0.9, 0.02) < 0


@pytest.mark.parametrize("points", [[], [[float("nan"), 1.0]]])
def test_scans_without_returns_are_refused(points: list[list[float]]) -> None:
    with pytest.raises(MapError, match="no scan has a return"):
        build_grid([(np.zeros(3), scan_of(points))], Config())


def test_a_pose_far_away_is_refused_before_memory_runs_out() -> None:
    near, far = np.zeros(3), np.array([1e6, 1e6, 0.0])
    with pytest.raises(MapError, match=r"raise mapping\.resolution"):
        build_grid([(near, scan_of([[1.0, 0.0]])), (far, scan_of([[1.0, 0.0]]))], Config())
