"""Nodes by motion, poses of all frames, and stages that are not done twice."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest
from memory_store import MemoryStore

from mapmyworld.config import SensingConfig
from mapmyworld.geometry.planar import matrix_to_planar, planar_to_matrix
from mapmyworld.graph.frame_poses import pose_every_frame
from mapmyworld.stages.nodes import Motion, NodeSelector, neighbours
from mapmyworld.stages.record import StageRecord
from mapmyworld.types import (
    Frame,
    Judged,
    LaserTracking,
    Node,
    Odometry,
    Poses,
    TrackedFrames,
)


def frame_at(stamp_ns: int, pose: np.ndarray) -> Frame:
    return Frame(stamp_ns, pose)


def select(path: list[list[float]]) -> tuple[list[Node], list[Judged]]:
    selector = NodeSelector(SensingConfig(), wants_images=False)
    nodes, steps = [], []
    for i, planar in enumerate(path):
        pose = planar_to_matrix(planar)
        node, step, _ = selector.consider(
            frame_at(i, pose), Motion(pose, np.eye(6) * 1e-4, Odometry())
        )
        nodes += [node] if node else []
        steps += [step] if step else []
    return nodes, neighbours(steps)


def test_a_node_comes_after_a_gap_of_the_log_however_little_the_robot_moved() -> None:
    """Frames after it lie with it, not with the node before, if the robot was carried meanwhile."""
    selector = NodeSelector(SensingConfig(), wants_images=False)
    made = []
    for stamp in (0, 100, 200, 300, 5300, 5400):
        motion = Motion(np.eye(4), 1e-4 * np.eye(6), LaserTracking("matched", 0.9))
        made.append(selector.consider(frame_at(stamp * 1_000_000, np.eye(4)), motion))
    assert [node.stamp_ns for node, _, _ in made if node] == [0, 5_300_000_000]
    (step,) = [step for _, step, _ in made if step]
    assert step.source == LaserTracking("matched", 0.9, after_gap=True)


def test_a_node_comes_with_every_tenth_of_a_metre_and_of_a_radian() -> None:
    straight, _ = select([[0.02 * i, 0.0, 0.0] for i in range(51)])
    assert [node.stamp_ns for node in straight] == list(range(0, 51, 5))
    turning, _ = select([[0.0, 0.0, 0.03 * i] for i in range(41)])
    assert [node.stamp_ns for node in turning] == list(range(0, 41, 4))


def test_neighbour_constraints_carry_the_motion_and_all_its_uncertainty() -> None:
    """Five steps of standard deviation 0.01 m along the path: sqrt(5) times as uncertain along x.

    Sideways the turns of the earlier steps add to it: more than sqrt(5).
    """
    _, constraints = select([[0.02 * i, 0.0, 0.0] for i in range(11)])
    assert len(constraints) == 2
    first = constraints[0]
    assert (first.from_id, first.to_id) == (1, 2)
    assert matrix_to_planar(first.i_from_j) == pytest.approx([0.1, 0.0, 0.0])
    sigmas = np.sqrt(np.diag(np.linalg.inv(first.information)))
    assert sigmas[3] == pytest.approx(0.01 * np.sqrt(5), rel=1e-6)
    assert sigmas[4] > 0.01 * np.sqrt(5)


def test_frames_between_nodes_share_out_what_solving_moved() -> None:
    """Two nodes 1 m apart; solving stretched that to 1.2 m: the frame half way moves 0.1 m."""
    nodes = [
        Node(1, 0, 0, np.eye(4), np.eye(4)),
        Node(2, 0, 4, planar_to_matrix([1.0, 0, 0]), planar_to_matrix([1.0, 0, 0])),
    ]
    solved = planar_to_matrix([[0.0, 0, 0], [1.2, 0, 0]])
    moved = planar_to_matrix([[0, 0, 0], [0.25, 0, 0], [0.5, 0, 0], [0.75, 0, 0], [0, 0, 0]])
    frames = TrackedFrames(
        np.arange(5), np.array([1, 1, 1, 1, 2]), moved, np.array([1, 0, 0, 0, 1], bool)
    )
    posed = pose_every_frame(nodes, Poses(np.array([1, 2]), solved), frames)
    assert posed[:, 0, 3] == pytest.approx([0.0, 0.3, 0.6, 0.9, 1.2])


def test_frames_follow_their_node_when_nothing_was_stretched() -> None:
    """A rigid motion of all nodes moves all frames the same way."""
    rng = np.random.default_rng(5)
    tracked = planar_to_matrix(np.cumsum(rng.normal(0, 0.3, (4, 3)), axis=0))
    world = planar_to_matrix([3.0, -2.0, 1.0])
    nodes = [Node(i + 1, 0, i, pose, pose) for i, pose in enumerate(tracked)]
    moved = planar_to_matrix(rng.normal(0, 0.1, (12, 3)))
    ids = np.repeat([1, 2, 3, 4], 3)
    frames = TrackedFrames(np.arange(12), ids, moved, np.zeros(12, bool))
    posed = pose_every_frame(nodes, Poses(np.arange(1, 5), world @ tracked), frames)
    assert posed == pytest.approx(world @ tracked[ids - 1] @ moved)


def test_a_stage_is_done_once_and_again_only_when_something_before_it_changed() -> None:
    store, done = MemoryStore(), []

    def build(settings: SensingConfig, resolution: float, log_hash: str = "log") -> list[str]:
        done.clear()
        record = StageRecord(store, log_hash)
        record.run("track", (asdict(settings),), lambda: done.append("track"))
        record.run("map", (resolution,), lambda: done.append("map"))
        return list(done)

    settings = SensingConfig()
    assert build(settings, 0.05) == ["track", "map"]
    assert build(settings, 0.05) == []
    assert build(settings, 0.10) == ["map"]
    assert build(SensingConfig(node_distance=0.2), 0.10) == ["track", "map"]
    assert build(SensingConfig(node_distance=0.2), 0.10, "another log") == ["track", "map"]


def test_a_stage_that_fails_is_not_done() -> None:
    store = MemoryStore()

    def fail() -> None:
        raise RuntimeError("power cut")

    with pytest.raises(RuntimeError):
        StageRecord(store, "log").run("track", (), fail)
    done: list[str] = []
    StageRecord(store, "log").run("track", (), lambda: done.append("track"))
    assert done == ["track"]
