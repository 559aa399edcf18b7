"""Odometry that led on where scans fitted nothing: what the place afterwards makes of it."""

from __future__ import annotations

import numpy as np
import pytest
from laser_rooms import WALLS, cast
from messages_in_memory import MemoryLog, odometry_at, scan_at, transform
from numpy.typing import NDArray

from mapmyworld.api import build
from mapmyworld.config import Config
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    covariance_from_planar,
    information_to_planar,
    matrix_to_planar,
    planar_to_matrix,
)
from mapmyworld.places.laser_nodes import LaserNodes, laser_nodes
from mapmyworld.places.refuted_odometry import (
    is_unmatched,
    refuted_odometry,
)
from mapmyworld.registration.scan_matching import prepare_scan, scan_set
from mapmyworld.types import ConstraintKind, Judged, LaserTracking, Message, Why
from mapmyworld.types.wording import reason_of

CONFIG = Config()
Array = NDArray[np.float64]
LEFT = np.stack([np.linspace(-3.0, -1.0, 21), np.full(21, 1.0), np.zeros(21)], axis=-1)
RIGHT = np.stack([np.full(21, 4.5), np.linspace(-2.0, 0.0, 21), np.full(21, np.pi / 2)], axis=-1)
FORWARD = np.stack([np.linspace(0.0, 1.2, 21), np.zeros(21), np.zeros(21)], axis=-1)
FARTHER = LEFT + np.array([2.0, 0.0, 0.0])
SQUARE = np.array([[-2.0, -2, 2, -2], [2, -2, 2, 2], [2, 2, -2, 2], [-2, 2, -2, -2]])
"""A room that is the same after a quarter turn."""
COVARIANCE = covariance_from_planar(np.diag([0.02, 0.02, 0.01]) ** 2, off_plane=1e-8)


def driven(truth: Array, believed: Array, walls: Array) -> tuple[LaserNodes, list[Judged]]:
    """Nodes whose motions were matched, but for one in the middle by odometry alone."""
    scans = [prepare_scan(cast(p, walls, k), CONFIG.registration) for k, p in enumerate(truth)]
    nodes = laser_nodes(
        np.arange(1, len(truth) + 1), scan_set(scans), believed, np.zeros((len(truth), 2))
    )
    steps = planar_to_matrix(between_planar(believed[:-1], believed[1:]))
    states = np.full(len(steps), "matched", object)
    states[len(truth) // 2 - 1] = "odometry only"
    return nodes, [
        Judged(
            k + 1, k + 2, ConstraintKind.NEIGHBOUR, step, np.linalg.inv(COVARIANCE),
            LaserTracking(str(state), 0.9),
        )
        for k, (step, state) in enumerate(zip(steps, states, strict=True))
    ]  # fmt: skip


def carried(there: Array, turn: float) -> tuple[Array, Array]:
    """(N, 3) twice: the path of who was carried to the path `there`, and as wheels report it."""
    believed = compose_planar(
        compose_planar(LEFT[-1], [0.0, 0.0, turn]), between_planar(there[0], there)
    )
    return np.concatenate([LEFT, there]), np.concatenate([LEFT, believed])


def test_a_robot_carried_to_where_it_was_is_placed_by_what_it_sees() -> None:
    truth, believed = carried(LEFT, np.radians(40.0))
    nodes, constraints = driven(truth, believed, WALLS)
    judged = refuted_odometry(nodes, constraints, CONFIG)
    (refuted,) = [c for c in judged if c.verdicts]
    assert is_unmatched(refuted)
    assert refuted.is_superseded
    assert refuted.verdicts[-1].why is Why.REFUTED
    assert "odometry fault: scans place the robot 2.0" in reason_of(refuted)
    anew = judged[-1]
    assert (anew.from_id, anew.to_id, anew.kind) == (21, 22, ConstraintKind.NEIGHBOUR)
    error = between_planar(between_planar(LEFT[-1], LEFT[0]), matrix_to_planar(anew.i_from_j))
    sigmas = np.sqrt(np.linalg.inv(information_to_planar(anew.information)).diagonal())
    assert (np.abs(error) < 2.0 * sigmas).all()
    assert sigmas[0] < 0.05
    assert anew.is_relocalised


def test_sound_odometry_is_kept_whatever_did_not_fit() -> None:
    nodes, constraints = driven(*carried(FARTHER, 0.0), WALLS)
    assert refuted_odometry(nodes, constraints, CONFIG) == constraints


def test_odometry_into_a_place_never_seen_is_kept() -> None:
    truth = np.concatenate([LEFT, RIGHT + np.array([20.0, 0.0, 0.0])])
    walls = np.concatenate([WALLS, WALLS + np.array([20.0, 0.0, 20.0, 0.0])])
    nodes, constraints = driven(truth, truth, walls)
    assert refuted_odometry(nodes, constraints, CONFIG) == constraints


def test_the_path_is_lost_where_two_poses_are_as_likely() -> None:
    """After a quarter turn the room is the same, and odometry lies between the two."""
    truth = np.zeros((42, 3))
    truth[:, 2] = np.linspace(0.0, 4.0 * np.pi, 42)
    believed = truth.copy()
    believed[21:, 2] += np.pi / 4
    nodes, constraints = driven(truth, believed, SQUARE)
    judged = refuted_odometry(nodes, constraints, CONFIG)
    assert judged[-1].is_tracking_loss
    assert not judged[-1].is_relocalised
    sigmas = np.sqrt(np.linalg.inv(information_to_planar(judged[-1].information)).diagonal())
    assert sigmas == pytest.approx([5.0, 5.0, 1.5], rel=1e-3)


def test_a_build_places_a_robot_that_was_carried_by_the_scans_that_follow() -> None:
    """Its wheels stand while it is put back to where it began, turned by 60 degrees."""
    there = compose_planar(LEFT[0], compose_planar(np.array([0.0, 0.0, np.pi / 3]), FORWARD))
    truth, believed = carried(there, 0.0)
    messages: list[tuple[str, Message, int]] = []
    for k, (pose, odometry) in enumerate(zip(truth, believed, strict=True)):
        stamp = (k + 1) * 200_000_000
        messages.append(("/odom", odometry_at(stamp, odometry.tolist()), stamp))
        points = cast(pose, WALLS, k).points
        ranges = np.full(361, np.inf)
        ranges[np.rint(np.degrees(np.arctan2(*points.T[::-1])) / 0.5 + 180.0).astype(int)] = (
            np.hypot(*points.T)
        )
        messages.append(("/scan", scan_at(stamp, ranges), stamp))
    built = build(
        MemoryLog([("/tf_static", transform("base_link", "laser", [0, 0, 0]), 1), *messages])
    )
    frames = built.map.frame_poses()
    assert frames is not None
    error = between_planar(between_planar(truth[0], truth[-1]), matrix_to_planar(frames[-1]))
    assert np.abs(error).max() < 0.05
    (note,) = [line for line in built.map.get("track")["notes"] if "odometry fault" in line]
    assert note.startswith(
        "odometry fault after 4 s: later scans place the robot elsewhere, up to 2."
    )
