"""Every export of a database that RTAB-Map wrote, by the command line."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from cli.main import group
from formats.trajectory_files import read_trajectory

LOGS = {"fr079_laser": 252, "freiburg1_rpy": 47}


def run(*arguments: object) -> str:
    done = CliRunner().invoke(group, [str(argument) for argument in arguments])
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.mark.slow
@pytest.mark.real_log
@pytest.mark.parametrize("name", LOGS)
def test_inspected_and_exported(data: Path, tmp_path: Path, name: str) -> None:
    source, out = data / "rtabmap" / f"{name}.db", tmp_path / "map"
    facts = json.loads(run("inspect", "graph", source, "--format", "json"))
    assert facts["nodes"] == LOGS[name]
    for what, ending in (("trajectory", ".tum"), ("cloud", ".ply"), ("report", ".html")):
        run("export", what, source, "-o", out.with_suffix(ending))
    run("export", "grid", source, "-o", out)
    theirs = read_trajectory(data / "rtabmap" / f"{name}.poses.tum")
    ours = read_trajectory(out.with_suffix(".tum"))
    np.testing.assert_allclose(ours.poses, theirs.poses, atol=2e-6)
    pixels = cv2.imread(str(out.with_suffix(".pgm")), cv2.IMREAD_UNCHANGED)
    assert pixels is not None
    assert np.mean(pixels == 0) > 1e-3  # walls
    assert np.mean(pixels > 250) > 0.02  # floor
    assert out.with_suffix(".ply").stat().st_size > 100_000
    assert name in out.with_suffix(".html").read_text()


@pytest.mark.slow
@pytest.mark.real_log
def test_images_can_be_read_as_a_tum_folder(data: Path, tmp_path: Path) -> None:
    """The layout of the TUM benchmark, which our own reader takes as a log."""
    folder = tmp_path / "pictures"
    run("export", "images", data / "rtabmap" / "freiburg1_rpy.db", "-o", folder)
    for name in ("rgb", "depth"):
        lines = (folder / f"{name}.txt").read_text().splitlines()
        rows = [line.split() for line in lines if not line.startswith("#")]
        assert len(rows) == 47
        assert all((folder / path).is_file() for _, path in rows)
    depth = cv2.imread(str(folder / rows[0][1]), cv2.IMREAD_UNCHANGED)
    assert depth is not None
    assert depth.dtype == np.uint16
    assert 0.5 < np.median(depth[depth > 0]) / 5000 < 5.0  # m, by TUM's factor
    reported = json.loads(run("inspect", "log", folder, "--format", "json"))
    assert "TUM" in json.dumps(reported)
