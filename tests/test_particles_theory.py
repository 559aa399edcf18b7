"""The textbook's parts of FastSLAM against cases worked by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_fastslam import run_plain_fastslam
from plain_measurement_model import (
    MeasurementNoise,
    beam_range_finder_model,
    expected_range,
    measurement_model_map,
)
from plain_motion_model import (
    MotionNoise,
    motion_variances,
    rotations_and_translation,
    sample_motion_model,
)
from plain_occupancy import (
    SensorModel,
    cells_crossed,
    log_odds,
    update_occupancy_grid,
)
from scipy.special import softmax

from mapmyworld.geometry.planar import between_planar, compose_planar
from mapmyworld.particles.filter import (
    effective_sample_size,
    kld_sample_size,
    low_variance_sampler,
)
from mapmyworld.types import OccupancyGrid, Scan

SENSOR = SensorModel(p_occupied=0.8, p_free=0.3, limit=50.0)


def scan(points: list[list[float]]) -> Scan:
    return Scan(
        points=np.array(points, np.float32).reshape(-1, 2),
        origin=np.zeros(3),
        missing=np.zeros(0, np.float32),
        range_max=10.0,
        angle_increment=0.01,
    )


def empty_grid(width: int, height: int, resolution: float, x: float, y: float) -> OccupancyGrid:
    return OccupancyGrid(np.full((height, width), np.nan, np.float32), resolution, np.array([x, y]))


def test_log_odds_are_bayes_rule_in_a_world_of_two_cells() -> None:
    """Cells A, B in a row, the robot in front; both half likely occupied at first.

    Three beams: two end in B (so A is crossed), one ends in A. By Bayes' rule for a binary state
    with p(m | z) given for an even prior, odds multiply: A: (3/7)^2 * 4 = 36/49; B: 4^2 = 16.
    """
    grid = empty_grid(2, 1, 1.0, 0.0, -0.5)
    for end in (1.5, 1.5, 0.5):
        grid = update_occupancy_grid(scan([[end, 0.0]]), np.zeros(3), grid, SENSOR)
    odds_a, odds_b = 36 / 49, 16.0
    expected = [odds_a / (1 + odds_a), odds_b / (1 + odds_b)]
    np.testing.assert_allclose(grid.probabilities()[0], expected, rtol=1e-6)


def test_a_cell_outside_the_field_of_perception_keeps_its_belief() -> None:
    grid = empty_grid(4, 3, 1.0, 0.0, -1.5)
    updated = update_occupancy_grid(scan([[2.5, 0.0]]), np.zeros(3), grid, SENSOR)
    assert np.isnan(updated.log_odds[[0, 2]]).all()
    np.testing.assert_allclose(
        updated.log_odds[1], [log_odds(0.3), log_odds(0.3), log_odds(0.8), np.nan], rtol=1e-6
    )


@given(st.tuples(st.floats(-4, 4), st.floats(-4, 4)), st.tuples(st.floats(-4, 4), st.floats(-4, 4)))
def test_cells_crossed_are_those_that_a_fine_walk_meets(
    a: tuple[float, float], b: tuple[float, float]
) -> None:
    grid = empty_grid(16, 16, 0.5, -4.0, -4.0)
    cells = cells_crossed(np.array(a), np.array(b), grid)
    shares = np.linspace(0.0, 1.0, 501)[1:-1, None]
    walk = np.array(a) + shares * (np.array(b) - np.array(a))
    in_cells = (walk - grid.origin) / grid.resolution
    clear = np.all(np.abs(in_cells - np.rint(in_cells)) > 1e-6, axis=1)
    met = {tuple(c) for c in np.floor(in_cells[clear]).astype(int)[:, ::-1]}
    assert met <= {tuple(c) for c in cells}
    assert len(cells) <= 1 + np.abs(np.diff(cells, axis=0)).sum()


def test_samples_of_the_motion_model_have_its_moments() -> None:
    """First order: the second turn's noise only turns; the first turn's moves across the way."""
    noise = MotionNoise(0.05, 0.03, 0.1, 0.02)
    u = compose_planar(np.array([0.0, 0.0, 0.3]), np.array([1.0, 0.0, 0.2]))
    assert rotations_and_translation(u) == pytest.approx((0.3, 1.0, 0.2))
    variance_1, variance_trans, variance_2 = motion_variances(u, noise)
    assert variance_1 == pytest.approx((0.05 * 0.3) ** 2 + 0.03**2)
    assert variance_trans == pytest.approx(0.1**2 + 0.02**2 * (0.3**2 + 0.2**2))
    start = np.array([2.0, -1.0, 0.7])
    samples = sample_motion_model(u, np.tile(start, (200_000, 1)), noise, np.random.default_rng(1))
    along = between_planar(compose_planar(start, np.array([0.0, 0.0, 0.3])), samples)
    np.testing.assert_allclose(along.mean(axis=0), [1.0, 0.0, 0.2], atol=2e-3)
    np.testing.assert_allclose(
        along.var(axis=0), [variance_trans, variance_1, variance_1 + variance_2], rtol=0.03
    )


def test_driving_backwards_is_no_pair_of_half_turns() -> None:
    turn, way, back = rotations_and_translation(np.array([-1.0, 0.0, 0.0]))
    assert (turn, way, back) == pytest.approx((0.0, -1.0, 0.0), abs=1e-12)
    noiseless = MotionNoise(0.0, 0.0, 0.0, 0.0)
    u = np.array([-0.5, 0.1, -0.4])
    x = sample_motion_model(u, np.array([[1.0, 2.0, 0.5]]), noiseless, np.random.default_rng(0))
    np.testing.assert_allclose(x[0], compose_planar([1.0, 2.0, 0.5], u), atol=1e-12)


weights = st.lists(st.floats(1e-3, 1.0), min_size=1, max_size=12)


@settings(max_examples=25)
@given(weights, st.integers(1, 40))
def test_low_variance_sampling_keeps_expectations(values: list[float], count: int) -> None:
    """Averaged over the one random number, particle k is drawn count * w_k times exactly;

    in any one draw it is that, rounded up or down.
    """
    w = np.array(values) / np.sum(values)
    drawn = []
    for r in (np.arange(400) + 0.5) / 400:
        ancestors = low_variance_sampler(w, count, float(r))
        assert len(ancestors) == count
        drawn.append(np.bincount(ancestors, minlength=len(w)))
        assert np.all(np.abs(drawn[-1] - count * w) < 1.0 + 1e-9)
    np.testing.assert_allclose(np.mean(drawn, axis=0), count * w, atol=0.01)


@given(st.lists(st.floats(-800.0, 800.0), min_size=1, max_size=20))
def test_effective_sample_size_lies_between_one_and_all(logs: list[float]) -> None:
    w = softmax(np.array(logs))
    assert w.sum() == pytest.approx(1.0)
    assert 1.0 - 1e-9 <= effective_sample_size(w) <= len(w) + 1e-9


def test_effective_sample_size_of_equal_and_of_lone_weights() -> None:
    assert effective_sample_size(np.full(8, 0.125)) == pytest.approx(8.0)
    assert effective_sample_size(np.array([1.0, 0.0, 0.0])) == pytest.approx(1.0)


def test_kld_sampling_follows_the_chi_squared_quantile() -> None:
    """Fox 2003, eq. 15: n = chi2_{k-1, 1-delta} / (2 epsilon); here delta = 0.01."""
    from scipy.stats import chi2

    for bins in (2, 10, 60):
        exact = chi2.ppf(0.9901, bins - 1) / (2 * 0.05)
        assert kld_sample_size(bins, 0.05) == pytest.approx(exact, rel=0.03)
    assert kld_sample_size(1, 0.05) == 1


def room() -> OccupancyGrid:
    """A wall at x = 2 m, everything before it free."""
    grid = empty_grid(40, 40, 0.1, -1.0, -2.0)
    log_odds_cells = np.full((40, 40), -3.0, np.float32)
    log_odds_cells[:, 30] = 3.0
    return OccupancyGrid(log_odds_cells, grid.resolution, grid.origin)


@pytest.mark.parametrize("model", [measurement_model_map, beam_range_finder_model])
def test_a_scan_is_most_likely_where_it_was_taken(model) -> None:  # type: ignore[no-untyped-def]
    ends = [[2.05, y] for y in np.linspace(-0.5, 0.5, 11)]
    noise = MeasurementNoise()
    by_place = [model(scan(ends), np.array([x, 0.0, 0.0]), room(), noise) for x in (-0.4, 0.0, 0.3)]
    assert by_place[1] > by_place[0]
    assert by_place[1] > by_place[2]


def test_likelihood_of_one_beam_by_hand() -> None:
    """End point in the cell next to the wall: distance 0.1 m, so one sigma."""
    noise = MeasurementNoise(sigma=0.1, hit=0.8, chance=0.1)
    gauss = np.exp(-0.5) / (np.sqrt(2 * np.pi) * 0.1)
    expected = np.log(0.8 * gauss + 0.1 / 10.0)
    got = measurement_model_map(scan([[1.95, 0.05]]), np.zeros(3), room(), noise)
    assert got == pytest.approx(expected, rel=1e-6)


def test_expected_range_stops_at_the_wall_and_is_unknown_beyond_the_map() -> None:
    lidar = np.array([0.0, 0.05])
    assert expected_range(room(), lidar, np.array([1.0, 0.05]), 10.0) == pytest.approx(
        2.0, abs=0.06
    )
    assert expected_range(room(), lidar, np.array([-1.0, 0.05]), 10.0) is None


def corner_scan(x: np.ndarray) -> Scan:
    """What a robot at x sees of a corner: walls along x = 2.02 and y = 1.52."""
    walls = [[2.02, y] for y in np.linspace(-1.0, 1.52, 60)]
    walls += [[v, 1.52] for v in np.linspace(-1.0, 2.02, 60)]
    cos, sin = np.cos(x[2]), np.sin(x[2])
    rotated = (np.array(walls) - x[:2]) @ np.array([[cos, -sin], [sin, cos]])
    return scan(rotated.tolist())


def test_one_particle_without_noise_is_mapping_with_known_poses() -> None:
    motions = [np.zeros(3), np.array([0.1, 0.0, 0.1]), np.array([0.1, 0.02, -0.2])]
    poses, x = [], np.zeros(3)
    for u in motions:
        x = compose_planar(x, u)
        poses.append(x)
    scans = [corner_scan(pose) for pose in poses]
    empty = empty_grid(60, 60, 0.1, -2.0, -2.0)
    noiseless = MotionNoise(0.0, 0.0, 0.0, 0.0)
    particles = run_plain_fastslam(
        zip(motions, scans, strict=True), empty, 1, 0, noiseless, MeasurementNoise(), SENSOR
    )
    known = empty
    for pose, z in zip(poses, scans, strict=True):
        known = update_occupancy_grid(z, pose, known, SENSOR)
    np.testing.assert_allclose(particles.x[0], poses, atol=1e-12)
    np.testing.assert_array_equal(particles.m[0].log_odds, known.log_odds)


def test_plain_particles_find_the_motion_that_odometry_missed() -> None:
    """Odometry says 0.3 m straight on; the corner says 0.4 m and 0.03 m aside."""
    truth = np.array([0.4, 0.03, 0.0])
    steps = [(np.zeros(3), corner_scan(np.zeros(3)))]
    steps += [(np.array([0.3, 0.0, 0.0]), corner_scan(truth))]
    particles = run_plain_fastslam(
        steps,
        empty_grid(80, 80, 0.05, -2.0, -2.0),
        100,
        3,
        MotionNoise(0.02, 0.1, 0.3, 0.0),
        MeasurementNoise(sigma=0.1),
        SENSOR,
    )
    ends = particles.x[:, -1]
    assert abs(ends[:, 0].mean() - truth[0]) < 0.03
    assert abs(ends[:, 1].mean() - truth[1]) < 0.03
