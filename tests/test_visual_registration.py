"""Cameras, and poses from points, against known truth and independent references."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mapmyworld.geometry.rigid import between, se3_exp, se3_log, transform_points
from mapmyworld.registration.camera_model import pixels_of_points, rays_of_pixels
from mapmyworld.registration.camera_pose import Sightings, errors, inliers, ransac_pose, refine_pose
from mapmyworld.types import CameraModel

Array = NDArray[np.float64]
K = np.array([[500.0, 0.0, 320.0], [0.0, 510.0, 240.0], [0.0, 0.0, 1.0]])
SIGMAS = (0.002, 0.01, 0.05)


@pytest.mark.parametrize(
    ("model", "distortion"),
    [
        ("", []),
        ("plumb_bob", [0.2624, -0.9531, -0.0054, 0.0026, 1.1633]),
        ("plumb_bob", [-0.05, 0.02, 0.001, -0.001]),
        ("rational_polynomial", [0.3, 0.1, 0.0005, -0.0003, 0.02, 0.4, 0.15, 0.03]),
        ("equidistant", [0.02, -0.01, 0.004, -0.001]),
    ],
)
def test_pixels_become_rays_and_rays_the_same_pixels(model: str, distortion: list[float]) -> None:
    camera = CameraModel(640, 480, K, model, np.array(distortion), np.eye(4))
    u, v = np.meshgrid(np.linspace(80, 560, 9), np.linspace(60, 420, 7))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    rays = rays_of_pixels(camera, pixels)
    points = np.column_stack([rays, np.ones(len(rays))]) * 2.5
    assert np.abs(pixels_of_points(camera, points) - pixels).max() < 0.05


def test_points_behind_the_camera_have_no_pixel() -> None:
    camera = CameraModel(640, 480, K, "", np.zeros(0), np.eye(4))
    assert np.isnan(pixels_of_points(camera, np.array([[0.1, 0.2, -1.0], [0.0, 0.0, 0.0]]))).all()


def scene(seed: int, count: int, noise: float) -> tuple[Array, Sightings]:
    """A camera's pose and its noisy sightings; a third has no depth."""
    random = np.random.default_rng(seed)
    pose = se3_exp(random.normal(size=6) * 0.5)
    local = np.column_stack([random.uniform(-1, 1, (count, 2)), random.uniform(1, 4, count)])
    seen = np.column_stack([local[:, :2] / local[:, 2:], 1.0 / local[:, 2]])
    sigmas = np.tile(SIGMAS, (count, 1))
    seen += noise * random.normal(size=seen.shape) * sigmas[:, [0, 0, 1]]
    seen[::3, 2] = np.nan
    return pose, Sightings(transform_points(pose, local), seen, sigmas)


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000))
def test_a_pose_is_found_among_forty_percent_of_wrong_matches(seed: int) -> None:
    pose, sightings = scene(seed, 200, 1.0)
    wrong = np.random.default_rng(seed).permutation(200)[:80]
    sightings.seen[wrong, :2] += np.random.default_rng(seed + 1).uniform(0.1, 0.6, (80, 2))
    found, count = ransac_pose(sightings, 3.0)
    assert count >= 60
    kept = sightings.chosen(inliers(found, sightings, 5.0))
    refined, _ = refine_pose(found, kept)
    motion = se3_log(between(pose, refined))
    assert np.abs(motion[:3]).max() < 0.003
    assert np.abs(motion[3:]).max() < 0.01
    agreed = inliers(refined, sightings, 4.0)
    assert not agreed[wrong].any()
    assert agreed.sum() > 110


def test_the_information_predicts_the_scatter_of_refined_poses() -> None:
    """Over many noise draws, mean chi-squared of the error is its dimension, 6."""
    squares = []
    for seed in range(60):
        pose, sightings = scene(seed, 120, 1.0)
        refined, information = refine_pose(pose, sightings, width=1e9)
        motion = se3_log(between(pose, refined))
        squares.append(motion @ information @ motion)
    assert 4.5 < np.mean(squares) < 7.7  # 6 +- 3.4 standard errors of 0.45, and a little more


def test_a_motion_of_the_world_moves_the_pose_with_it() -> None:
    pose, sightings = scene(3, 100, 1.0)
    world = se3_exp(np.array([0.4, -0.2, 1.0, 3.0, -2.0, 0.5]))
    moved = Sightings(transform_points(world, sightings.points), sightings.seen, sightings.sigmas)
    here, _ = refine_pose(pose, sightings)
    there, _ = refine_pose(world @ pose, moved)
    assert np.abs(se3_log(between(world @ here, there))).max() < 1e-6
    assert errors(here, sightings) == pytest.approx(errors(world @ here, moved), rel=1e-6, abs=1e-9)


def test_two_points_give_no_pose() -> None:
    _, sightings = scene(1, 2, 0.0)
    assert ransac_pose(sightings, 3.0)[1] == 0


def test_what_is_too_few_for_use_is_not_searched_for() -> None:
    _, sightings = scene(4, 40, 1.0)
    assert ransac_pose(sightings, 3.0, least=41)[1] == 0
    assert ransac_pose(sightings, 3.0, least=10)[1] >= 10
