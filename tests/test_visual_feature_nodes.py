"""Features as nodes of the graph: asked for, and refused where a laser tells more."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from click.testing import CliRunner
from sample_maps import APARTMENT, apartment  # noqa: F401

from cli.main import group
from formats.database import open_store
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
