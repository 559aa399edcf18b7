"""Local grids that RTAB-Map's tools assemble into a map: of depth images."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest
import rtabmap_decoder as decode
from local_grids import read_local_grid

from formats.database import open_store
from mapmyworld.types import CameraModel, ImageMessage, Node, NodeData, RgbdImage

_OPTICAL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # base_from_camera of a level camera


def room_seen(height: float, wall: float) -> RgbdImage:
    """A level camera over a floor, a wall ahead: z of pixel v is the nearer of both planes."""
    intrinsics = np.array([[80.0, 0, 80], [0, 80, 60], [0, 0, 1]])
    mount = np.eye(4)
    mount[:3, :3], mount[:3, 3] = _OPTICAL, [0.2, 0.0, height]
    down = (np.arange(120.0) - 60.0) / 80.0
    floor = np.where(down > 1e-6, height / np.maximum(down, 1e-6), np.inf)
    depth = np.repeat(np.minimum(floor, wall)[:, None], 160, axis=1).astype(np.float32)
    camera = CameraModel(160, 120, intrinsics, "", np.zeros(0), mount)
    return RgbdImage(camera, None, ImageMessage(0, "", "32FC1", 160, 120, lambda: depth))


def test_floor_and_wall_of_a_depth_image(tmp_path: Path) -> None:
    """The wall stands 2 m ahead of the camera, which is 0.2 m ahead of the base."""
    data = NodeData(images=(room_seen(height=0.9, wall=2.0),))
    with open_store(tmp_path / "m.db", create=True) as store:
        store.add_node(Node(1, 0, 10**9, np.eye(4), np.eye(4)), data)
    sqlite = sqlite3.connect(tmp_path / "m.db")
    sqlite.row_factory = sqlite3.Row
    row = sqlite.execute("SELECT * FROM Data").fetchone()
    sqlite.close()
    ground, obstacle = decode.matrix(row["ground_cells"]), decode.matrix(row["obstacle_cells"])
    assert ground.shape[0] == obstacle.shape[0] == 1
    assert ground.shape[2] == obstacle.shape[2] == 2
    assert row["empty_cells"] is None
    assert row["cell_size"] == 0.05
    np.testing.assert_allclose([row[f"view_point_{axis}"] for axis in "xyz"], [0.2, 0, 0.9])
    np.testing.assert_allclose(obstacle[0, :, 0], 2.2, atol=0.026)
    # The lowest ray, 59 / 80 down, meets the floor 0.9 * 80 / 59 m before the camera.
    assert abs(ground[0, :, 0].min() - (0.2 + 0.9 * 80 / 59)) < 0.05
    assert ground[0, :, 0].max() < 2.2 + 0.026
    # The width that is seen grows with the distance: 2 m of wall at 90 degrees of view.
    assert abs(np.ptp(obstacle[0, :, 1]) - 4.0) < 0.11
    both = {tuple(c) for c in ground[0].round(3)} & {tuple(c) for c in obstacle[0].round(3)}
    assert not both


@pytest.mark.parametrize("name", ["fr079_laser", "freiburg1_rpy"])
def test_local_grids_that_rtabmap_wrote(data: Path, name: str) -> None:
    """Every cell of every node, against an independent decoder."""
    path = data / "rtabmap" / f"{name}.db"
    decoder = decode.Decoder(path)
    found = 0
    with open_store(path, read_only=True) as store:
        for row in decoder.rows("Data"):
            grid = read_local_grid(store._db, row["id"])
            if row["obstacle_cells"] is None:
                assert grid is None
                continue
            assert grid is not None
            found += 1
            for kind in ("obstacle", "empty"):
                expected = decode.matrix(row[f"{kind}_cells"])[0]
                np.testing.assert_array_equal(getattr(grid, kind)[:, :2], expected)
            assert len(grid.ground) == 0
            assert grid.cell_size == row["cell_size"]
            assert grid.view_point.tolist() == [row[f"view_point_{axis}"] for axis in "xyz"]
    decoder.close()
    assert found == {"fr079_laser": 260, "freiburg1_rpy": 0}[name]


def test_cells_are_kept_of_nodes_that_see_the_ground(tmp_path: Path) -> None:
    with open_store(tmp_path / "m.db", create=True) as store:
        store.add_node(Node(1, 0, 10**9, np.eye(4), np.eye(4)), NodeData(images=(room_seen(1, 2),)))
        store.nodes()
        kept = read_local_grid(store._db, 1)
        assert kept is not None
        assert len(kept.ground) > 0
        assert read_local_grid(store._db, 2) is None
