"""Real logs through the whole pipeline, with the bands that the project promises."""

from __future__ import annotations

import bz2
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from cli.main import group
from formats.database import open_store
from formats.grid_files import read_grid
from formats.relation_files import read_relations
from formats.trajectory_files import read_trajectory
from mapmyworld.config import Config
from mapmyworld.evaluation.relations_metric import relations_score
from mapmyworld.evaluation.trajectory_error import ate
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.mapping.occupancy import build_grid

pytestmark = [pytest.mark.slow, pytest.mark.real_log]


def build(log: Path, folder: Path, *options: str) -> dict[str, object]:
    folder.mkdir(exist_ok=True)
    arguments = ["build", str(log), "-o", str(folder / "map.db"), "-q", "--format", "json"]
    found = CliRunner().invoke(group, [*arguments, *options])
    assert found.exit_code == 0, found.output + repr(found.exception)
    return dict(json.loads(found.stdout))


@pytest.mark.parametrize(
    ("name", "metres", "degrees"), [("intel", 0.06, 0.6), ("fr079", 0.10, 0.8)]
)
def test_benchmark_relations(
    data: Path, tmp_path: Path, name: str, metres: float, degrees: float
) -> None:
    """Mean errors of the relations metric (Kuemmerle et al. 2009) as recorded, no repair."""
    build(data / "laser" / f"{name}.clf.bz2", tmp_path)
    trajectory = read_trajectory(tmp_path / "map.tum")
    score = relations_score(trajectory, read_relations(data / "laser" / f"{name}.relations"))
    assert score.translation.mean <= metres
    assert score.rotation_deg.mean <= degrees


def test_csail_closes_its_loops_though_its_odometry_stalls_and_jumps(
    data: Path, tmp_path: Path
) -> None:
    """No relations at hand: the mapped area is a second measure, doubled rooms would enlarge it."""
    summary = build(data / "laser" / "mit-csail.clf.bz2", tmp_path)
    assert summary["frames"] == 1988
    cells = read_grid(tmp_path / "map.yaml").trinary()
    free = (cells == 0).sum() * 0.05**2
    assert 800 < free < 1300


def test_a_carmen_log_and_its_conversions_give_the_same_map_byte_for_byte(
    data: Path, tmp_path: Path
) -> None:
    """The first minute of CSAIL, whose stamps and floats must survive three other formats."""
    with bz2.open(data / "laser" / "mit-csail.clf.bz2") as whole:
        lines = [line for _, line in zip(range(400), whole, strict=False)]
    (tmp_path / "csail.clf").write_bytes(b"".join(lines))
    build(tmp_path / "csail.clf", tmp_path / "carmen")
    for name in ("csail.bag", "csail.mcap", "csail_db3"):
        convert = ["convert", str(tmp_path / "csail.clf"), "-o", str(tmp_path / name)]
        assert CliRunner().invoke(group, convert).exit_code == 0
        build(tmp_path / name, tmp_path / f"of_{name}")
        for product in ("map.pgm", "map.yaml", "map.tum"):
            found = (tmp_path / f"of_{name}" / product).read_bytes()
            assert found == (tmp_path / "carmen" / product).read_bytes(), (name, product)


def test_a_surface_that_moves_ahead_does_not_set_a_robot_without_odometry_back(
    data: Path, tmp_path: Path
) -> None:
    """Intel after 38 minutes, in a passage: one scan fits a little better half a metre back."""
    with bz2.open(data / "laser" / "intel.clf.bz2") as whole:
        lines = [line for line in whole if line.startswith(b"FLASER")][11_300:11_600]
    (tmp_path / "passage.clf").write_bytes(b"".join(lines))
    build(tmp_path / "passage.clf", tmp_path / "wheels")
    build(tmp_path / "passage.clf", tmp_path / "none", "--set", "sensing.odometry_topic=none")
    by_wheels, alone = (read_trajectory(tmp_path / of / "map.tum") for of in ("wheels", "none"))
    assert ate(alone, by_wheels).translation.maximum < 0.1


@pytest.mark.parametrize("name", ["neato_middle", "neato_with_particle_filter"])
def test_bags_of_a_vacuum_cleaner(data: Path, tmp_path: Path, name: str) -> None:
    """Drawn at the poses of odometry alone, walls stand beside themselves and fill more cells."""
    summary = build(data / "bags" / f"{name}.bag", tmp_path)
    assert summary["losses"] == []
    ours = read_grid(tmp_path / "map.yaml")
    with open_store(tmp_path / "map.db", read_only=True) as store:
        recorded = store.tracked_frames().odom_from_base
        assert recorded is not None
        at_odometry = matrix_to_planar(recorded)
        scans = [(at_odometry[k], scan) for k, scan in store.scans(range(len(recorded)))]
    doubled = build_grid(scans, Config())
    assert 0.0 < ours.area_m2(100) < 0.85 * doubled.area_m2(100)


def test_a_depth_camera_alone(data: Path, tmp_path: Path) -> None:
    """Fast rotations at half rate, without odometry: ATE over all frames that have a pose."""
    folder = data / "rgbd" / "freiburg1_rpy_15hz"
    build(folder, tmp_path)
    estimate = read_trajectory(tmp_path / "map.tum")
    score = ate(estimate, read_trajectory(folder / "groundtruth.txt"), align=True)
    assert len(estimate.stamps_ns) >= 0.98 * 339
    assert score.translation.rmse < 0.030
    assert np.isfinite(estimate.poses).all()
