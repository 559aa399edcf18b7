"""Fixes of an antenna beside the robot's own frame, in the back end."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np

from formats.trajectory_files import read_trajectory
from mapmyworld.backend.descent import solved
from mapmyworld.backend.factors import FactorGraph, factor_graph, poses_of
from mapmyworld.backend.information import Information
from mapmyworld.backend.residuals import retract
from mapmyworld.backend.system import System
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between

ARM = np.array([-0.4, 0.25, 0.6])  # m, of the antenna in the robot's frame
FIX = 0.05  # m, of a fix
DRIFT = np.array([0.01] * 3 + [0.02] * 3)  # rad and m a step of odometry


def add_fixes(graph: FactorGraph, nodes: list[int], antenna: Array, arm: Array) -> None:
    """Positions (K, 3) of the antenna, metres east, north, up, seen at these nodes."""
    noise = gtsam.noiseModel.Isotropic.Sigma(3, FIX)
    for node, place in zip(nodes, antenna, strict=True):
        graph.factors.add(gtsam.GPSFactorArm(node, place, arm, noise))


def drifting(true: Array, random: np.random.Generator) -> tuple[System, Array]:
    """Odometry along true poses (N, 4, 4) with noise, nothing held; and where it leads to."""
    steps = retract(
        False, between(true[:-1], true[1:]), random.normal(size=(len(true) - 1, 6)) * DRIFT
    )
    reckoned = [true[0]]
    for step in steps:
        reckoned.append(reckoned[-1] @ step)
    ends, known = np.arange(len(true)), np.tile(np.diag(DRIFT**-2.0), (len(steps), 1, 1))
    return System(False, ends[:-1], ends[1:], steps, known, ends), np.array(reckoned)


def test_fixes_hold_a_drifting_path_by_their_lever_arm(data: Path) -> None:
    """Also its headings, which a single fix indicates nothing about."""
    truth = read_trajectory(data / "imu" / "euroc_v1_01.truth.tum")
    true = truth.poses[400:2600:10]  # every half second of a flight in all directions
    random = np.random.default_rng(2)
    system, reckoned = drifting(true, random)
    seen = list(range(0, len(true), 2))
    antenna = (true[seen] @ np.append(ARM, 1.0))[:, :3] + random.normal(size=(len(seen), 3)) * FIX

    def missed(arm: Array) -> Array:
        graph = factor_graph(system, reckoned)
        add_fixes(graph, seen, antenna, arm)
        found = solved(graph)
        spread = np.array(Information.of(found).marginals(np.arange(len(true))))
        error = between(poses_of(system, found.values, reckoned), true)
        return np.stack([np.linalg.norm(error[:, :3, 3], axis=1),
                         np.sqrt(spread[:, 3:, 3:].trace(0, 1, 2))])  # fmt: skip

    drifted = np.linalg.norm(reckoned[:, :3, 3] - true[:, :3, 3], axis=1)
    metres, sigmas = missed(ARM)
    assert drifted.max() > 0.5
    assert np.sqrt(np.mean(metres**2)) < 0.06
    assert 0.5 < np.mean((metres / sigmas) ** 2) < 2.0  # as confident as it is
    assert np.sqrt(np.mean(missed(np.zeros(3))[0] ** 2)) > 0.3
