"""`evaluate` and `check` from the command line, on files and on a small map."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from sample_verdicts import REJECTED

from cli.main import group
from formats.database import open_store
from formats.grid_files import write_grid
from formats.trajectory_files import write_trajectory
from mapmyworld.errors import ConfigError, MapError
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.types import (
    ConstraintKind,
    Judged,
    Node,
    NodeData,
    OccupancyGrid,
    Poses,
    TrackedFrames,
    Trajectory,
)

COUNT = 12
STAMPS = np.arange(1, COUNT + 1, dtype=np.int64) * 10**9


def circle(noise: float = 0.0) -> np.ndarray:
    angle = np.arange(COUNT) * 0.5
    poses = np.stack([2 * np.sin(angle), 2 - 2 * np.cos(angle), angle], axis=1)
    poses[:, 0] += noise * np.random.default_rng(0).normal(size=COUNT)
    return planar_to_matrix(poses)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A true trajectory, an estimate, a grid and a map with two closures, one rejected."""
    write_trajectory(tmp_path / "truth.tum", Trajectory(STAMPS, circle()))
    write_trajectory(tmp_path / "estimate.tum", Trajectory(STAMPS, circle(0.02)))
    cells = np.full((30, 40), -4.0, np.float32)
    cells[:, 20] = cells[5, 10:] = 4.0
    cells[:, :4] = np.nan
    grid = OccupancyGrid(cells, 0.05, np.zeros(2))
    write_grid(tmp_path / "grid", grid)
    with open_store(tmp_path / "map.db", create=True) as store:
        frames = TrackedFrames(
            STAMPS, np.arange(1, COUNT + 1), np.tile(np.eye(4), (COUNT, 1, 1)), np.ones(COUNT, bool)
        )
        with store.write_stage("track", "x"):
            for k in range(COUNT):
                pose = circle()[k]
                store.add_node(Node(k + 1, 0, int(STAMPS[k]), pose, pose), NodeData())
            store.set_tracked_frames(frames)
        with store.write_stage("judge", "x"):
            found = Judged(1, 12, ConstraintKind.LOOP_CLOSURE, np.eye(4), np.eye(6))
            store.add_constraints([found, found.judged(REJECTED)])
            store.set_poses(Poses(np.arange(1, COUNT + 1), circle(0.02)))
            store.set_frame_poses(circle(0.02))
        with store.write_stage("map", "x"):
            store.set_grid(grid)
    return tmp_path


def run(*arguments: str | Path):
    return CliRunner().invoke(group, [str(a) for a in arguments], catch_exceptions=False)


def test_a_trajectory_is_scored_from_a_file_and_from_a_map_alike(folder: Path) -> None:
    results = [
        json.loads(
            run(
                "evaluate", "trajectory", folder / name, folder / "truth.tum", "--format", "json"
            ).stdout
        )
        for name in ("estimate.tum", "map.db")
    ]
    assert results[0]["ate"]["rmse"] == pytest.approx(results[1]["ate"]["rmse"], abs=1e-6)
    assert 0.005 < results[0]["ate"]["rmse"] < 0.03
    assert results[0]["covered"] == 1.0


def test_relations_and_grids_are_scored(folder: Path) -> None:
    (folder / "a.relations").write_text("1 2 0 0 0 0 0 0.5\n3.5 7 0 0 0 0 0 0\n")
    shown = run("evaluate", "relations", folder / "map.db", folder / "a.relations").stdout
    assert "2 relations in the trajectory's time\n" in shown
    grid = folder / "grid.yaml"
    score = json.loads(run("evaluate", "grid", grid, grid, "--format", "json").stdout)
    assert score["aligned"]["precision_1"] == score["unaligned"]["free"] == 1.0


def test_relations_outside_the_map_are_not_scored_and_few_inside_are_reported(folder: Path) -> None:
    """A map of the first 12 s against relations of a minute: its end pose is no answer there."""
    inside, outside = "1 2 0.96 0.24 0 0 0 0.5", "40 60 7 0 0 0 0 0"
    few = folder / "few.relations"
    few.write_text("\n".join([inside, *4 * [outside], "11 13 9 9 0 0 0 0"]) + "\n")
    result = run("evaluate", "relations", folder / "map.db", few, "--format", "json")
    score = json.loads(result.stdout)
    assert (score["count"], score["outside"]) == (1, 5)
    assert score["translation_m"]["mean"] < 0.1
    assert result.exit_code == 3
    assert "only 1 of 6 relations lie in the trajectory's time" in result.stderr
    checked = ["check", folder / "map.db", "--relations", few, "--require"]
    passed = run(*checked, "relations_translation < 0.1")
    assert passed.exit_code == 3
    assert "only 1 of 6 relations" in passed.stderr
    assert run(*checked, "relations_translation < 0.1", "--allow-partial").exit_code == 0
    assert run(*checked, "relations_covered >= 0.5").exit_code == 4
    most = folder / "most.relations"
    most.write_text("\n".join([*3 * [inside], outside]) + "\n")
    assert run("evaluate", "relations", folder / "map.db", most).exit_code == 0
    assert run("check", folder / "map.db", "--relations", most, "--require",
               "relations_translation < 0.1").exit_code == 0  # fmt: skip


def test_relations_of_another_log_are_refused(folder: Path) -> None:
    (folder / "far.relations").write_text("40 60 7 0 0 0 0 0\n")
    refused = CliRunner().invoke(
        group, ["evaluate", "relations", str(folder / "map.db"), str(folder / "far.relations")]
    )
    assert isinstance(refused.exception, MapError)
    assert "none of 1 relations lies in the trajectory's time" in str(refused.exception)


def test_a_check_passes_or_fails_with_its_own_exit_code(folder: Path) -> None:
    files = ("--reference", folder / "truth.tum", "--grid", folder / "grid.yaml")
    good = [f"nodes == {COUNT}", "loop_closures>=1", "rejected <= 1", "ate_rmse < 0.05"]
    good += ["unknown_share < 0.2", "grid_precision >= 1", "covered == 1", "loop_precision == 0"]
    wanted = [word for text in good for word in ("--require", text)]
    passed = run("check", folder / "map.db", *files, *wanted)
    assert passed.exit_code == 0, passed.stdout
    failed = run("check", folder / "map.db", "--require", "nodes > 100", "--format", "json")
    assert failed.exit_code == 4
    assert json.loads(failed.stdout)["requirements"][0]["value"] == COUNT


@pytest.mark.parametrize(
    ("requirement", "said"),
    [("lops > 1", "loop_closures"), ("nodes", "KEY OP VALUE"), ("nodes > nan", "KEY OP VALUE")],
)
def test_a_requirement_that_is_not_understood_is_refused(
    folder: Path, requirement: str, said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        run("check", folder / "map.db", "--require", requirement)


def test_what_a_requirement_needs_is_asked_for(folder: Path) -> None:
    with pytest.raises(ConfigError, match="--reference"):
        run("check", folder / "map.db", "--require", "ate_rmse < 1")
    with pytest.raises(ConfigError, match="nothing is required"):
        run("check", folder / "map.db")


def test_a_drive_too_short_for_rpe_still_has_its_ate(folder: Path) -> None:
    words = ["evaluate", "trajectory", str(folder / "estimate.tum"), str(folder / "truth.tum")]
    short = CliRunner().invoke(group, [*words, "--delta", "1000"])
    assert short.exit_code == 3
    assert "ATE [m]" in short.stdout
    assert "RPE" not in short.stdout
    assert "--delta" in short.stderr
    reported = json.loads(
        CliRunner().invoke(group, [*words, "--delta", "1000", "--format", "json"]).stdout
    )
    assert reported["rpe"] is None
    assert reported["ate"]["count"] == COUNT


def test_relations_that_are_not_there_are_reported_without_pythons_words(folder: Path) -> None:
    words = ["evaluate", "relations", str(folder / "map.db"), str(folder / "none.relations")]
    error = str(CliRunner().invoke(group, words).exception)
    assert "none.relations: cannot be read: No such file" in error
    assert "Errno" not in error


def test_a_cloud_is_moved_only_by_both_trajectories(folder: Path) -> None:
    arguments = ["evaluate", "cloud", "c.ply", "m.ply", "--reference", str(folder / "truth.tum")]
    result = CliRunner().invoke(group, arguments)
    assert result.exit_code != 0
    assert "--trajectory and --reference go together" in result.output
