"""What FastSLAM reports of a map that it should not vouch for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from laser_rooms import WALLS, cast
from room_drive import START_NS, STEP_NS, drive

from cli.main import group
from mapmyworld.api import Silent
from mapmyworld.config import Config, ParticlesConfig
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.particles.fastslam import run_fastslam
from mapmyworld.types import Frame, LaserScanMessage

LEFT = np.stack([np.linspace(-3.0, -1.0, 21), np.full(21, 1.0), np.zeros(21)], axis=-1)
RIGHT = np.stack([np.full(21, 4.5), np.linspace(-2.0, 0.0, 21), np.full(21, np.pi / 2)], axis=-1)
CONFIG = Config(particles=ParticlesConfig(count=3, count_min=3))


def carried(*, odometry: bool) -> list[Frame]:
    """From one room into the other within 3 s; odometry, if any, goes on as it should."""
    poses = np.concatenate([LEFT, RIGHT])
    stamps = np.arange(len(poses)) * 100_000_000
    stamps[len(LEFT) :] += 3_000_000_000
    return [
        Frame(int(t), planar_to_matrix(x) if odometry else None, cast(x, WALLS, k))
        for k, (t, x) in enumerate(zip(stamps, poses, strict=True))
    ]


@pytest.mark.parametrize(("odometry", "times"), [(False, 1), (True, 0)])
def test_a_robot_is_lost_where_neither_scans_nor_odometry_lead_on(
    odometry: bool, times: int
) -> None:
    assert run_fastslam(carried(odometry=odometry), CONFIG, Silent()).times_lost == times


def build(log: Path, out: Path) -> Result:
    few = ("--set", "particles.count=3")
    arguments = ["build", str(log), "-o", str(out), "--method", "fastslam", "-q", *few]
    return CliRunner().invoke(group, arguments, catch_exceptions=False)


def test_a_lost_robot_ends_with_exit_code_3(tmp_path: Path) -> None:
    """From half of the drive on the laser stands in another room: everything is nearer."""

    def elsewhere(message: Any) -> LaserScanMessage:
        moved = message.stamp_ns > START_NS + 40 * STEP_NS
        return replace(message, ranges=0.4 * message.ranges[::-1]) if moved else message

    log = tmp_path / "carried.mcap"
    drive().without("/odom").changed("/scan", elsewhere).write(log)
    built = build(log, tmp_path / "map.db")
    assert built.exit_code == 3
    assert "no global search" in built.stderr
