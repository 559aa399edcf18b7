"""`mapmyworld export` on maps of ours and on databases that RTAB-Map wrote."""

from __future__ import annotations

import re
import shutil
from contextlib import closing
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from click.testing import CliRunner, Result
from database_samples import fill, grid

from cli.export import export
from formats.cloud_files import read_cloud
from formats.database import open_store
from formats.graph_reading import read_graph
from formats.grid_files import read_grid
from formats.logs import open_log
from formats.trajectory_files import read_trajectory
from mapmyworld.errors import MapError, MapMyWorldError
from mapmyworld.types import ImageMessage

COMMANDS = sorted(set(export.commands) - {"mesh"})  # it needs Open3D
ENDINGS = {"figure": ".png", "mcap": ".mcap"}  # of those that take no other


@pytest.fixture
def ours(tmp_path: Path) -> Path:
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
    return tmp_path / "map.db"


def run(*words: str | Path) -> Result:
    result = CliRunner().invoke(export, [str(word) for word in words], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result


@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_a_grid_of_every_mode_reads_back(ours: Path, tmp_path: Path, mode: str) -> None:
    result = run("grid", ours, "-o", tmp_path / "floor", "--mode", mode, "--verify")
    image = tmp_path / ("floor.png" if mode == "scale" else "floor.pgm")
    assert result.output.split() == [str(image), str(tmp_path / "floor.yaml")]
    read = read_grid(tmp_path / "floor.yaml")
    np.testing.assert_array_equal(read.trinary() == 100, grid().trinary() == 100)


def test_grid_of_another_resolution_is_drawn_anew(ours: Path, tmp_path: Path) -> None:
    run("grid", ours, "-o", tmp_path / "floor", "--resolution", "0.1")
    read = read_grid(tmp_path / "floor.yaml")
    assert read.resolution == 0.1
    assert (read.trinary() == 100).any()


@pytest.mark.parametrize("style", ["tum", "kitti", "csv"])
def test_a_trajectory_of_every_style_reads_back(ours: Path, tmp_path: Path, style: str) -> None:
    run("trajectory", ours, "-o", tmp_path / "t", "--style", style)
    with open_store(ours, read_only=True) as store:
        poses, frames = store.frame_poses(), store.tracked_frames()
    read = read_trajectory(tmp_path / "t")
    np.testing.assert_allclose(read.poses, poses, atol=2e-9)
    if style != "kitti":
        np.testing.assert_array_equal(read.stamps_ns, frames.stamps_ns)


def test_odometry_is_that_of_all_tracked_frames(ours: Path, tmp_path: Path) -> None:
    run("trajectory", ours, "-o", tmp_path / "t", "--which", "odometry")
    with open_store(ours, read_only=True) as store:
        expected = store.tracked_frames().odom_from_base
        assert len(expected) > len(store.nodes())
    np.testing.assert_allclose(read_trajectory(tmp_path / "t").poses, expected, atol=2e-9)


def test_a_graph_holds_accepted_constraints_and_solved_poses(ours: Path, tmp_path: Path) -> None:
    run("graph", ours, "-o", tmp_path / "graph.g2o")
    graph = read_graph(tmp_path / "graph.g2o").graph
    with open_store(ours, read_only=True) as store:
        poses = store.poses()
    assert poses is not None
    assert len(graph.edges) == 6  # the accepted ones between nodes, and that of the landmark
    np.testing.assert_allclose(
        graph.map_from_node[np.searchsorted(graph.ids, [1, 2, 3])][:, :3, 3],
        poses.map_from_node[:3, :3, 3],
        atol=1e-6,
    )


def test_images_are_a_log_again(ours: Path, tmp_path: Path) -> None:
    run("images", ours, "-o", tmp_path / "pictures")
    log = open_log([tmp_path / "pictures"])
    assert {topic.count for topic in log.info().topics if "depth" in topic.topic} == {3}
    with open_store(ours, read_only=True) as store:
        (kept,) = store.node_data(1).images
    assert kept.depth is not None
    depths = [
        message
        for raw in log.messages()
        if isinstance(message := raw.decode(), ImageMessage) and message.is_depth
    ]
    np.testing.assert_allclose(depths[0].pixels(), kept.depth.pixels(), atol=1.1e-4)
    assert (tmp_path / "pictures/rgb").is_dir()
    truth = read_trajectory(tmp_path / "pictures/groundtruth.txt")
    assert len(truth.stamps_ns) == 2


def test_report_is_one_page_that_links_to_nothing_but_the_map(ours: Path, tmp_path: Path) -> None:
    run("report", ours, "-o", tmp_path / "map.html")
    page = (tmp_path / "map.html").read_text()
    assert page.startswith("<!doctype html>")
    assert not re.findall(r'src="(?!data:|#)', page)
    links = re.findall(r'href="(?!data:|#)([^"]*)"', page)
    assert ours.resolve() in [(tmp_path / unquote(link)).resolve() for link in links]
    assert all((tmp_path / unquote(link)).is_file() for link in links)
    assert "evidence 12 points, 30 needed" in page  # why the rejected one was
    assert page.count("<image id=") == 3
    assert "<svg" in page
    run("report", ours, "-o", tmp_path / "again.html")
    assert (tmp_path / "again.html").read_text() == page


def test_what_a_map_lacks_is_said(ours: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare.db"
    open_store(bare, create=True).close()
    for command in COMMANDS:
        with pytest.raises(MapError) as caught:
            run(command, bare)
        assert "\n" not in str(caught.value), command
    assert [path for path in tmp_path.glob("bare*") if path != bare] == []


def test_places_that_cannot_be_written_are_named(ours: Path, tmp_path: Path) -> None:
    for command in set(COMMANDS) - {"images"}:  # which makes its folder
        name = f"file{ENDINGS.get(command, '.ply')}"
        with pytest.raises(MapMyWorldError, match="cannot be written") as caught:
            run(command, ours, "-o", tmp_path / "absent" / name)
        assert "absent" in str(caught.value), command


@pytest.mark.parametrize("command", ENDINGS)
def test_a_file_of_another_kind_is_no_traceback(ours: Path, tmp_path: Path, command: str) -> None:
    with pytest.raises(MapError, match="give a name that ends in"):
        run(command, ours, "-o", tmp_path / "a.bag")
    assert not (tmp_path / "a.bag").exists()


def test_an_older_file_of_ones_own_is_replaced(ours: Path, tmp_path: Path) -> None:
    for command in set(COMMANDS) - {"images"}:  # a folder
        path = tmp_path / f"{command}{ENDINGS.get(command, '.ply')}"
        run(command, ours, "-o", path)
        before = {file: file.read_bytes() for file in tmp_path.iterdir()}
        run(command, ours, "-o", path)
        assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before, command


@pytest.mark.slow
@pytest.mark.real_log
def test_databases_of_rtabmap(data: Path, tmp_path: Path) -> None:
    laser, camera = tmp_path / "laser.db", tmp_path / "camera.db"
    shutil.copy(data / "rtabmap/fr079_laser.db", laser)
    shutil.copy(data / "rtabmap/freiburg1_rpy.db", camera)
    run("grid", laser, "--verify")
    cells = read_grid(tmp_path / "laser.yaml").trinary()
    assert (cells == 100).sum() > 3000
    assert (cells == 0).sum() > 50_000
    for path in (laser, camera):
        run("trajectory", path)
        run("graph", path)
        run("report", path)
        run("cloud", path)
        read = read_trajectory(path.with_suffix(".tum"))
        theirs = data / f"rtabmap/{'fr079_laser' if path == laser else 'freiburg1_rpy'}.poses.tum"
        expected = read_trajectory(theirs)
        order = np.argsort(expected.stamps_ns)
        np.testing.assert_array_equal(read.stamps_ns, expected.stamps_ns[order])
        np.testing.assert_allclose(read.poses, expected.poses[order], atol=1e-5)
        assert len(read_cloud(path.with_suffix(".ply")).points) > 10_000
    run("images", camera)
    assert len(list((tmp_path / "camera_images/rgb").iterdir())) == 47
    for path, name in ((laser, "fr079_laser"), (camera, "freiburg1_rpy")):
        assert path.read_bytes() == (data / f"rtabmap/{name}.db").read_bytes()


@pytest.mark.real_log
def test_an_unfinished_database_is_optimised_for_export(data: Path, tmp_path: Path) -> None:
    """Without optimised poses, as a crash leaves it, ours take their place."""
    import sqlite3

    path = tmp_path / "laser.db"
    shutil.copy(data / "rtabmap/fr079_laser.db", path)
    with closing(sqlite3.connect(path)) as sqlite, sqlite:
        sqlite.execute("UPDATE Admin SET opt_ids = NULL, opt_poses = NULL")
    sqlite.close()
    run("trajectory", path)
    read = read_trajectory(path.with_suffix(".tum"))
    theirs = read_trajectory(data / "rtabmap/fr079_laser.poses.tum")
    expected = theirs.poses[np.argsort(theirs.stamps_ns)]
    from_first = np.linalg.inv(expected[0]) @ expected
    ours = np.linalg.inv(read.poses[0]) @ read.poses
    apart = np.linalg.norm(ours[:, :3, 3] - from_first[:, :3, 3], axis=1)
    assert apart.max() < 0.5  # of a hundred metres driven; two optimisers of one graph
