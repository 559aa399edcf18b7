"""Maps side by side: sharpness worked by hand, the picture, and the command."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

from cli.compare import compare
from cli.comparing import Candidate, figures_of, table_lines
from formats.database import open_store
from formats.report.map_axes import draw_rings, figure_file, plan_axes
from formats.report.map_pictures import MapPanel, write_compare_picture, write_particle_picture
from formats.trajectory_files import write_trajectory
from mapmyworld.errors import MapError
from mapmyworld.evaluation.sharpness import grid_sharpness
from mapmyworld.geometry.planar import compose_planar, planar_to_matrix
from mapmyworld.types import Node, NodeData, OccupancyGrid, Poses, TrackedFrames, Trajectory

Array = NDArray[np.float64]


def walled(thickness: int, p_wall: float = 0.9) -> OccupancyGrid:
    """A room of 60 x 40 cells of 0.1 m with one straight wall of 50 cells."""
    p = np.full((40, 60), 0.1, np.float32)
    p[20 : 20 + thickness, 5:55] = p_wall
    return OccupancyGrid(np.log(p / (1 - p)).astype(np.float32), 0.1, np.array([-1.0, -2.0]))


def test_sharpness_of_one_wall_by_hand() -> None:
    """Wall of 50 x 2 cells: area 100, outline 104 edges; entropy of p = 0.1 and 0.9 is the same."""
    grid = walled(2)
    found = grid_sharpness(grid)
    assert found.wall_thickness_m == pytest.approx(2 * 100 / 104 * 0.1)
    assert found.entropy_bits == pytest.approx(0.46899559, rel=1e-6)
    assert grid.area_m2(100) == pytest.approx(1.0)
    assert grid.area_m2(0) == pytest.approx(23.0)


def test_blurred_and_doubled_walls_are_less_sharp() -> None:
    sharp = grid_sharpness(walled(1))
    assert grid_sharpness(walled(3)).wall_thickness_m > 2 * sharp.wall_thickness_m
    assert grid_sharpness(walled(1, p_wall=0.7)).entropy_bits > sharp.entropy_bits


def test_an_empty_grid_has_no_sharpness() -> None:
    nothing = OccupancyGrid(np.full((3, 3), np.nan, np.float32), 0.1, np.zeros(2))
    found = grid_sharpness(nothing)
    assert found.entropy_bits is None
    assert found.wall_thickness_m is None


def path(bend: float) -> Trajectory:
    angle = np.linspace(0.0, 2.0, 21)
    planar = np.stack([2 * np.cos(angle), (2 + bend) * np.sin(angle), angle], axis=-1)
    stamps = np.arange(21, dtype=np.int64) * 100_000_000
    return Trajectory(stamps, planar_to_matrix(planar))


def test_figures_hold_what_can_be_known() -> None:
    first, second = (
        Candidate("a", path(0.0), walled(1)),
        Candidate("b", path(0.2), None, {"cpu_s": 4}),
    )
    rows = [figures_of(c, first, path(0.0), None) for c in (first, second)]
    assert rows[0]["ate_m"] == pytest.approx(0.0, abs=1e-9)
    assert 0.01 < rows[1]["ate_m"] == rows[1]["apart_m"] < 0.2
    assert "entropy_bits" not in rows[1]
    assert rows[1]["cpu_s"] == 4
    lines = table_lines(rows)
    assert lines[0].split()[:2] == ["map", "frames"]
    assert len({len(line) for line in lines}) <= 2
    assert lines[2].split()[0] == "b"
    assert "-" in lines[2].split()


def test_a_map_turned_in_its_frame_is_drawn_as_the_first_one(tmp_path: Path) -> None:
    """A wall drawn from a map whose frame is turned by 30 degrees lies where the first's lies."""
    grid = walled(4)
    first_from_map = np.array([0.4, -0.3, np.pi / 6])
    two = [MapPanel(grid, np.zeros(3), np.zeros((0, 2)), ())] * 2
    write_compare_picture(tmp_path / "two.png", two)
    dark = shown(tmp_path / "two.png").max(axis=-1) < 100
    half = dark.shape[1] // 2
    assert dark[:, :half].sum() == pytest.approx(dark[:, half:].sum(), rel=0.05)
    wall = np.array([[-0.5, 0.2], [4.5, 0.2]])
    moved = compose_planar(first_from_map, np.column_stack([wall, np.zeros(2)]))[:, :2]
    write_compare_picture(tmp_path / "one.png", [MapPanel(grid, first_from_map, wall, ("turned",))])
    picture = shown(tmp_path / "one.png")
    blue = np.argwhere((picture[..., 2] > 150) & (picture[..., 0] < 100))
    rise = np.ptp(blue[:, 0]) / np.ptp(blue[:, 1])
    assert rise == pytest.approx(
        abs(np.subtract(*moved[:, 1]) / np.subtract(*moved[:, 0])), rel=0.1
    )
    assert blue[np.argmax(blue[:, 1]), 0] < blue[np.argmin(blue[:, 1]), 0], "upwards to the right"
    dark = np.argwhere(picture.max(axis=-1) < 60)  # the wall lies under its own path, turned alike
    assert np.abs(dark.mean(axis=0) - blue.mean(axis=0)).max() < 0.05 * len(picture)


def shown(path: Path) -> NDArray[np.int64]:
    """The picture (H, W, 3) RGB of a file."""
    picture = cv2.imread(str(path))
    assert picture is not None
    return picture[..., ::-1].astype(np.int64)


def test_a_map_is_drawn_where_it_lies(tmp_path: Path) -> None:
    """A ring about a cell's middle in metres goes round that cell's pixels; y points up."""
    log_odds = np.full((10, 20), -4.0, np.float32)
    log_odds[2, 15] = 4.0
    grid = OccupancyGrid(log_odds, 0.5, np.array([3.0, 4.0]))
    with figure_file(tmp_path / "a.png") as figure:
        axes = plan_axes(figure, grid, np.array([[3.0, 4.0]]))
        axes.axis("off")
        draw_rings(axes, np.array([[3.0 + 15.5 * 0.5, 4.0 + 2.5 * 0.5]]), "#ff0000", "here")
    picture = shown(tmp_path / "a.png")
    dark = np.argwhere(picture.max(axis=-1) < 60).mean(axis=0)
    red = np.argwhere((picture[..., 0] > 200) & (picture[..., 1] < 100)).mean(axis=0)
    assert np.abs(dark - red).max() < 3.0
    assert dark[0] > 0.6 * len(picture)


def test_a_picture_has_the_same_bytes_each_time_and_a_known_ending(tmp_path: Path) -> None:
    for name in ("a.svg", "b.svg"):
        write_compare_picture(
            tmp_path / name, [MapPanel(walled(1), np.zeros(3), np.zeros((0, 2)), ("$a_$",))]
        )
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    with pytest.raises(MapError, match=r"ends in \.png"), figure_file(tmp_path / "a.xyz"):
        pass


def test_particle_paths_are_drawn_over_the_grid(tmp_path: Path) -> None:
    branches = np.array([[[0.0, 0.0], [1.0, 1.0]]], np.float32)
    best = np.array([[0.0, -1.0], [3.0, -1.0]], np.float32)
    path = tmp_path / "a.png"
    write_particle_picture(path, walled(1), branches, best, np.array([[2.0, -1.0]]))
    picture = shown(path)
    for colour in ((240, 150, 60), (30, 90, 200), (0, 150, 70)):
        misses = np.abs(picture - colour).max(axis=-1)  # lines are smoothed
        assert misses.min() < 40, colour


def stored(folder: Path, name: str, bend: float) -> Path:
    """A finished map with one node and 21 frames."""
    trajectory = path(bend)
    file = folder / f"{name}.db"
    with open_store(file, create=True) as store, store.write_stage("map", "x"):
        node = Node(1, 0, 0, trajectory.poses[0], trajectory.poses[0])
        store.add_node(node, NodeData())
        relative = np.linalg.inv(trajectory.poses[0]) @ trajectory.poses
        is_node = np.arange(21) == 0
        ids = np.ones(21, np.int64)
        store.set_tracked_frames(TrackedFrames(trajectory.stamps_ns, ids, relative, is_node))
        store.set_poses(Poses(np.array([1]), trajectory.poses[:1]))
        store.set_frame_poses(trajectory.poses)
        store.set_grid(walled(2))
    stages = [
        {"name": "track", "wall_s": 1.0, "cpu_s": 1.5, "peak_memory_mb": 80.0},
        {"name": "grid", "wall_s": 0.5, "cpu_s": 0.25, "peak_memory_mb": 99.0},
    ]  # whose sum is told: the last part of a build that was resumed took less
    file.with_suffix(".timing.json").write_text(json.dumps({"cpu_s": 0.3, "stages": stages}))
    return file


def test_the_command_prints_json_and_draws(tmp_path: Path) -> None:
    maps = [stored(tmp_path, "one", 0.0), stored(tmp_path, "two", 0.3)]
    truth, image = tmp_path / "truth.tum", tmp_path / "both.png"
    write_trajectory(truth, path(0.0), "tum")
    arguments = [*map(str, maps), "--reference", str(truth), "--image", str(image)]
    done = CliRunner().invoke(compare, [*arguments, "--format", "json"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    rows = json.loads(done.stdout)["maps"]
    assert [row["name"] for row in rows] == ["one", "two"]
    assert rows[0]["ate_m"] < 1e-6 < rows[1]["ate_m"]
    assert [rows[0][key] for key in ("cpu_s", "wall_s", "peak_memory_mb")] == [1.75, 1.5, 99.0]
    picture = cv2.imread(str(image))
    assert picture is not None
    assert picture.shape[1] > 1000
    text = CliRunner().invoke(compare, list(map(str, maps)), catch_exceptions=False)
    assert [line.split()[0] for line in text.stdout.splitlines()] == ["map", "one", "two"]
    assert all(heading in text.stdout for heading in ("CPU s", "wall s", "peak MB"))


def test_a_missing_map_and_an_unknown_method_are_reported(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"none\.db"):
        CliRunner().invoke(compare, [str(tmp_path / "none.db")], catch_exceptions=False)
    done = CliRunner().invoke(compare, ["x.mcap", "--methods", "graph,magic"])
    assert done.exit_code == 2
    assert "magic" in done.output
