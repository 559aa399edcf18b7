"""A map built from a map, and from a database of RTAB-Map's, is the map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rtabmap_decoder as decode

from cli.progress import StderrProgress
from cli.storing import storage_arguments
from formats.database import open_store
from formats.logs import open_log
from mapmyworld.config import Config
from mapmyworld.pipeline import build_map
from mapmyworld.types import OccupancyGrid, Poses

pytestmark = [pytest.mark.slow, pytest.mark.real_log]


def built(log: Path, path: Path) -> tuple[Poses, OccupancyGrid]:
    config = Config()
    with open_store(path, create=True, **storage_arguments(config)) as store:
        build_map(open_log([log]), store, config, StderrProgress(quiet=True))
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
    assert len(decoder.rows("Statistics")) == len(nodes)
    decoder.close()
