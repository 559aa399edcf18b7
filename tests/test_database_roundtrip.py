"""A map built from a map, and from a database of RTAB-Map's, is the map."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest
import rtabmap_decoder as decode
from numpy.typing import NDArray

from cli.storing import storage_arguments
from formats.database import RtabmapStore, open_store
from formats.logs import open_log
from mapmyworld.api import Silent
from mapmyworld.config import Config, GraphConfig
from mapmyworld.geometry.planar import between_planar
from mapmyworld.graph.canonical_graph import graph_from_constraints
from mapmyworld.graph.optimisation import optimise
from mapmyworld.pipeline import build_map
from mapmyworld.types import MapStore, OccupancyGrid, Poses

pytestmark = [pytest.mark.slow, pytest.mark.real_log]


def built(log: Path, path: Path) -> tuple[Poses, OccupancyGrid]:
    config = Config()
    with open_store(path, create=True, **storage_arguments(config)) as store:
        build_map(open_log([log]), store, config, Silent())
        poses, grid = store.poses(), store.grid()
    assert poses is not None
    assert grid is not None
    return poses, grid


def test_build_read_as_log_build_again(data: Path, tmp_path: Path) -> None:
    first, grid = built(data / "rtabmap/fr079_laser.db", tmp_path / "first.db")
    again, same = built(tmp_path / "first.db", tmp_path / "again.db")
    np.testing.assert_array_equal(again.ids, first.ids)
    np.testing.assert_allclose(again.map_from_node, first.map_from_node, rtol=0, atol=1e-5)
    np.testing.assert_array_equal(same.origin, grid.origin)
    differing = np.count_nonzero(same.trinary() != grid.trinary())
    assert differing <= 1e-4 * grid.log_odds.size

    # What a build leaves in RTAB-Map's tables is what we hold, to float32.
    decoder = decode.Decoder(tmp_path / "first.db")
    optimised = decoder.optimised()
    for node_id, pose in zip(first.ids, first.map_from_node, strict=True):
        np.testing.assert_allclose(optimised[int(node_id)], pose, atol=2e-6)
    cells = decode.matrix(decoder.only("Admin")["opt_map"])[:, :, 0]
    np.testing.assert_array_equal(cells, grid.trinary())
    nodes, links = decoder.rows("Node"), decoder.rows("Link")
    assert [row["label"] for row in nodes] == ["map0"] + [None] * (len(nodes) - 1)
    both = {(row["from_id"], row["to_id"], row["type"]) for row in links}
    assert all((b, a, kind) in both for a, b, kind in both)
    assert all((np.diag(decode.information(row["information_matrix"])) > 0).all() for row in links)
    decoder.close()


def optimum(store: MapStore) -> NDArray[np.float64]:
    """The solved graph (N, 3) of a map's nodes and constraints, from its odometry."""
    nodes = store.nodes()
    ids, start = np.array([n.id for n in nodes]), np.stack([n.odom_from_base for n in nodes])
    graph = graph_from_constraints(ids, start, store.constraints(), planar=True)
    return optimise(graph, GraphConfig()).graph.map_from_node


def test_read_as_a_map_of_rtabmaps_and_optimised(data: Path, tmp_path: Path) -> None:
    """Without our own tables the file is one of RTAB-Map's; its graph has the same optimum.

    RTAB-Map's links hold motions in float32: 1e-7 of the 30 m that a pose is away.
    """
    path = tmp_path / "map.db"
    first, _ = built(data / "rtabmap/fr079_laser.db", path)
    with open_store(path, read_only=True) as store:
        expected = optimum(store)
    sqlite = sqlite3.connect(path)
    names = "SELECT name FROM sqlite_master WHERE type = 'table' AND name LIKE 'mapmyworld%'"
    for (name,) in sqlite.execute(names).fetchall():
        sqlite.execute(f"DROP TABLE {name}")
    sqlite.commit()
    sqlite.close()
    with open_store(path, read_only=True) as store:
        assert isinstance(store, RtabmapStore)
        stored, found = store.poses(), optimum(store)
    assert stored is not None
    np.testing.assert_array_equal(stored.ids, first.ids)
    np.testing.assert_allclose(stored.map_from_node, first.map_from_node, atol=2e-6)
    apart = between_planar(expected, found)
    np.testing.assert_allclose(apart, 0.0, atol=2e-5)
