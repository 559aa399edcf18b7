"""Kernels of points and cells, against plain numpy."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import transform_points_planar
from mapmyworld.geometry.rigid import se3_exp
from mapmyworld.kernels.branch_and_bound import RESOLUTION, SQUARE, UNSEEN
from mapmyworld.kernels.cells import first_in_cells, judged
from mapmyworld.kernels.sweep_points import carried_on, returned_points

seeds = strategies.integers(0, 2**32 - 1)


@given(seeds, strategies.integers(0, 300))
def test_of_every_cell_the_first_point_stays(seed: int, count: int) -> None:
    points = np.random.default_rng(seed).normal(size=(count, 2))
    cells = np.floor(points / 0.3).astype(np.int64)
    expected = np.sort(np.unique(cells, axis=0, return_index=True)[1]) if count else []
    np.testing.assert_array_equal(first_in_cells(points, 0.3), expected)


@given(seeds)
def test_evidence_is_that_of_the_cell_a_point_lies_in_unless_seen_from_its_other_side(
    seed: int,
) -> None:
    random = np.random.default_rng(seed)
    own, other = (
        random.choice([0, UNSEEN, 255], p=[0.03, 0.67, 0.3], size=(40, 30)).astype(np.uint8)
        for _ in range(2)
    )
    corners, pose = random.normal(size=(2, 2)), random.normal(size=3)
    points = random.normal(size=(100, 2)) * 30.0 * RESOLUTION
    steps = np.arange(-3, 4) * RESOLUTION
    around = points[:, None] + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    placed, turned = (transform_points_planar(pose, p) for p in (points, around.reshape(-1, 2)))
    passed = (
        (indicated(own, corners[0], around.reshape(-1, 2)) < 0).reshape(100, -1),
        (indicated(other, corners[1], turned) < 0).reshape(100, -1),
    )
    two_sides = passed[0].any(axis=1) & passed[1].any(axis=1) & ~(passed[0] & passed[1]).any(axis=1)
    there = np.sign(indicated(other, corners[1], placed))
    expected = np.where((there > 0) & two_sides, 0, there)
    found = judged(points, own, corners[0], other, corners[1], pose)
    np.testing.assert_array_equal(found, expected)


def indicated(cells: NDArray[np.uint8], corner: Array, points: Array) -> NDArray[np.int64]:
    """(N,) the cells that points (N, 2) lie in, less what is unseen; 0 outside."""
    at = np.floor((points - corner) / RESOLUTION) + SQUARE
    inside = ((at >= 0) & (at < [30, 40])).all(axis=1)
    column, row = np.where(inside[:, None], at, 0).astype(np.int64).T
    return np.where(inside, cells[row, column].astype(np.int64) - UNSEEN, 0)


@given(seeds)
def test_beams_between_the_limits_become_points_of_the_base(seed: int) -> None:
    random = np.random.default_rng(seed)
    mount, angles = se3_exp(random.normal(size=6)), random.uniform(-3.0, 3.0, 40)
    ranges = random.uniform(0.0, 10.0, 40).astype(np.float32)
    ranges[:3] = np.nan, np.inf, 0.0
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    beams, points = returned_points(ranges, np.float32(1.0), np.float32(8.0), ways, mount)
    (expected,) = np.nonzero((ranges > 1.0) & (ranges < 8.0))
    np.testing.assert_array_equal(beams, expected)
    in_lidar = ranges[expected, None] * ways[expected]
    np.testing.assert_allclose(points, in_lidar @ mount[:3, :2].T + mount[:3, 3], atol=1e-12)


@given(seeds)
def test_points_seen_on_an_arc_are_carried_along_its_chord(seed: int) -> None:
    random = np.random.default_rng(seed)
    points, seconds = random.normal(size=(20, 3)), random.uniform(0.0, 0.2, 20)
    velocity, found = random.normal(size=3), points.copy()
    carried_on(found, velocity, seconds)
    turned = velocity[2] * seconds
    chord = transform_points_planar(
        np.stack([0 * turned, 0 * turned, 0.5 * turned], axis=1),
        velocity[:2] * seconds[:, None, None],
    )[:, 0]
    poses = np.concatenate([chord, turned[:, None]], axis=1)
    expected = transform_points_planar(poses, points[:, None, :2])[:, 0]
    np.testing.assert_allclose(found[:, :2], expected, atol=1e-12)
    np.testing.assert_array_equal(found[:, 2], points[:, 2])
