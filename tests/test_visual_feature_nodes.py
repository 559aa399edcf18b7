"""Features as nodes of the graph: asked for, and refused where a laser tells more."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from sample_maps import APARTMENT, apartment  # noqa: F401

from cli.main import group
from formats.database import open_store
from mapmyworld.geometry.rigid import invert, se3_exp, transform_points
from mapmyworld.graph.bundle import Bundle
from mapmyworld.graph.sighting_errors import with_measured_errors
from mapmyworld.types import Poses


def poses_of(path: Path) -> Poses:
    with open_store(path, read_only=True) as store:
        poses = store.poses()
    assert poses is not None
    return poses


def test_features_become_no_nodes_where_scans_tell_the_poses(
    apartment: Path,  # noqa: F811
    tmp_path: Path,
) -> None:
    """They know nothing of the scans, so they would take the poses away from them."""
    path = tmp_path / "map.db"
    shutil.copy(apartment, path)
    command = ["build", str(APARTMENT), "-o", str(path), "--no-export"]
    result = CliRunner().invoke(group, [*command, "--set", "visual.adjust_features=true"])
    assert result.exit_code == 0, result.output
    assert "features become no nodes" in result.stderr
    assert "track" in result.output.partition("reused:")[2]
    before, after = poses_of(apartment), poses_of(path)
    np.testing.assert_array_equal(after.map_from_node, before.map_from_node)


def ate(path: Path) -> tuple[float, float]:
    """Metres and degrees."""
    truth = APARTMENT.with_name("apartment.mcap.truth") / "trajectory.tum"
    command = ["evaluate", "trajectory", str(path), str(truth), "--format", "json"]
    result = CliRunner().invoke(group, command)
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    return found["ate"]["rmse"], found["ate_rotation_deg"]["rmse"]


@pytest.mark.slow
def test_features_as_nodes_bring_a_map_of_camera_and_wheels_nearer_to_the_truth(
    tmp_path: Path,
) -> None:
    """One node of the log shares no feature with another; the wheels' motions across it count.

    Without them, and with outliers counted, the map got four times worse.
    """
    path = tmp_path / "map.db"
    command = ["build", str(APARTMENT), "-o", str(path), "--no-export", "-q"]
    command += ["--set", "sensing.use_scans=false"]
    assert CliRunner().invoke(group, command).exit_code == 0
    without = ate(path)
    result = CliRunner().invoke(group, [*command, "--set", "visual.adjust_features=true"])
    assert result.exit_code == 0, result.output
    found = ate(path)
    assert found[0] < 0.9 * without[0]
    assert found[1] < without[1]


@pytest.mark.parametrize(("aside", "deeper"), [(0.4, 2.5), (1.0, 1.0), (3.0, 0.2)])
def test_errors_are_as_large_as_they_are_whatever_the_outliers(aside: float, deeper: float) -> None:
    """Sightings err by a known factor of what is expected, and a tenth of them are false."""
    random = np.random.default_rng(4)
    points = random.uniform((-2.0, -2.0, 2.0), (2.0, 2.0, 6.0), (400, 3))
    cameras = se3_exp(random.normal(size=(12, 6)) * 0.05)
    point_of, camera_of = np.divmod(np.arange(400 * 12), 12)
    local = transform_points(invert(cameras[camera_of]), points[point_of][:, None])[:, 0]
    seen = np.column_stack([local[:, :2] / local[:, 2:], 1.0 / local[:, 2]])
    sigmas = np.column_stack([random.uniform(0.002, 0.004, (len(seen), 2)), np.ones(len(seen))])
    seen[:, :2] += aside * sigmas[:, :1] * random.normal(size=(len(seen), 2))
    seen[:, 2] += deeper * sigmas[:, 1] * random.normal(size=len(seen))
    false = random.random(len(seen)) < 0.1
    seen[false, :2] += random.uniform(0.1, 0.3, (int(false.sum()), 2))
    seen[::5, 2] = np.nan
    bundle = Bundle(cameras, np.zeros(12, np.bool_), points, camera_of, point_of, seen, sigmas)
    found = with_measured_errors(bundle)
    ratio = found.sigmas[0, :2] / sigmas[0, :2]
    np.testing.assert_allclose(ratio, (aside, deeper), rtol=0.2)
    np.testing.assert_array_equal(found.sigmas[:, 2], 1.0)
    assert len(found.seen) > 0.95 * (~false).sum()
    assert np.isfinite(found.seen).all(axis=1).sum() > 0.7 * len(found.seen)
    kept = {tuple(row) for row in np.nan_to_num(found.seen).tolist()}
    assert not kept & {tuple(row) for row in np.nan_to_num(seen[false]).tolist()}


def test_a_point_left_to_one_camera_goes() -> None:
    """Two cameras disagree about one of two points by far more than about the others."""
    cameras = np.tile(np.eye(4), (2, 1, 1))
    cameras[1, 0, 3] = 0.5
    points = np.array([[x, 0.1, 3.0] for x in np.linspace(-1.0, 1.0, 9)])
    point_of, camera_of = np.divmod(np.arange(18), 2)
    local = points[point_of] - cameras[camera_of, :3, 3]
    seen = np.column_stack([local[:, :2] / 3.0, np.full(18, np.nan)])
    seen[:, 1] += np.where(camera_of, 0.001, -0.001)
    seen[9, 0] += 0.2
    bundle = Bundle(
        cameras, np.zeros(2, np.bool_), points, camera_of, point_of, seen, np.full((18, 3), 0.01)
    )
    found = with_measured_errors(bundle)
    assert len(found.points) == 8
    assert not np.any(np.all(found.points == points[4], axis=1))
    np.testing.assert_array_equal(np.bincount(found.point_of), 2)
