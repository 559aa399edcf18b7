"""Clouds of a 3D lidar registered in six degrees of freedom, in the back end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from formats.logs import open_log
from formats.trajectory_files import read_trajectory
from mapmyworld.backend.descent import optimised_roughly
from mapmyworld.backend.information import information_of
from mapmyworld.backend.system import System
from mapmyworld.evaluation.relations_metric import poses_at
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_angle

FIRST, COUNT = 20, 20  # key scans: 4.7 m and several turns
APART = (1, 2, 3)  # scans ahead that each is registered with


def registered(clouds: list[Array], tail: int, head: int, guess: Array) -> tuple[Array, Array]:
    """tail_from_head (4, 4), and its information (6, 6) of the right perturbation."""
    small_gicp = pytest.importorskip("small_gicp")
    for reach in (2.0, 0.5):
        found = small_gicp.align(
            clouds[tail], clouds[head], guess, downsampling_resolution=0.2,
            max_correspondence_distance=reach,
        )  # fmt: skip
        guess = found.T_target_source
    return guess, found.H


def registrations(clouds: list[Array]) -> System:
    """Every cloud with the next few; the first one stays."""
    ends, steps, known = [], [], []
    for head in range(1, len(clouds)):
        for tail in range(head - 1, max(-1, head - 1 - len(APART)), -1):
            guess = steps[ends.index((head - 2, head - 1))] if tail == head - 1 > 0 else np.eye(4)
            if tail < head - 1:  # by way of the scan between
                guess = steps[ends.index((tail, head - 1))] @ steps[ends.index((head - 1, head))]
            step, information = registered(clouds, tail, head, guess)
            ends.append((tail, head))
            steps.append(step)
            known.append(information)
    tails, heads = np.array(ends).T
    free = np.arange(len(clouds)) - 1
    return System(False, tails, heads, np.array(steps), np.array(known), free)


def test_registered_clouds_are_edges_like_any_other(data: Path) -> None:
    log = open_log([data / "lidar3d" / "hku_1.mcap"])
    messages = [m.decode() for m in log.messages(["/livox/points"])][FIRST : FIRST + COUNT]
    reference = read_trajectory(data / "lidar3d" / "hku_1.fastlio2.tum")
    true = poses_at(reference, np.array([m.stamp_ns for m in messages], np.int64))
    system = registrations([np.asarray(m.points, np.float64) for m in messages])
    start = np.tile(true[0], (COUNT, 1, 1))
    for k in range(1, COUNT):  # along the registrations of neighbours
        step = np.flatnonzero((system.tails == k - 1) & (system.heads == k))[0]
        start[k] = start[k - 1] @ system.measured[step]
    poses = optimised_roughly(system, start, tolerance=1e-6)
    chained, missed = (np.linalg.norm(between(true, found)[:, :3, 3], axis=1).max()
                       for found in (start, poses))  # fmt: skip
    assert np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1).sum() > 4.0
    assert missed < 0.04 < chained
    assert np.degrees(rotation_angle(between(true, poses))).max() < 1.0
    spread = np.array(information_of(system, poses).marginals(np.arange(1, COUNT)))
    assert (np.diff(np.sqrt(spread.trace(0, 1, 2))) > 0.0).mean() > 0.7  # it grows with the walk
