"""Nodes between aligned scans: what these were moved by is shared out as the motions may err."""

from __future__ import annotations

import numpy as np
import pytest
from sample_verdicts import REJECTED
from test_joint_system import GIVEN, NODES

from mapmyworld.alignment.joint_system import step_covariances
from mapmyworld.alignment.laser_refinement import carry_along
from mapmyworld.geometry.planar import between_planar

PATH = np.array([[0.0, 0.0, 0.0], [0.15, 0.0, 0.0], [0.153, 0.0, 0.0], [0.3, 0.0, 0.0]])
ENDS = np.array([0, 3])
MOVED = PATH[ENDS] + np.array([[0.0, 0.0, 0.0], [0.3, 0.15, 0.06]])


def test_a_motion_of_which_all_is_known_stays_as_it_is() -> None:
    """Three millimetres by odometry, between two steps that scans measured."""
    drift = np.cumsum([0.0, 0.02**2, 0.0008**2, 0.02**2])
    poses = carry_along(PATH, ENDS, MOVED, drift)
    assert poses[ENDS] == pytest.approx(MOVED)
    step = between_planar(poses[1], poses[2])
    assert np.hypot(*(step[:2] - PATH[2, :2] + PATH[1, :2])) < 0.001
    assert abs(step[2]) < 0.001


def test_motions_that_err_alike_share_alike() -> None:
    poses = carry_along(PATH, ENDS, MOVED, np.arange(4.0))
    assert poses[1:3, 2] == pytest.approx([0.02, 0.04])


def test_where_nothing_errs_the_nodes_after_a_scan_go_with_it() -> None:
    poses = carry_along(PATH, ENDS, MOVED, np.zeros(4))
    assert poses[:3] == pytest.approx(PATH[:3])
    assert poses[3] == pytest.approx(MOVED[1])


def test_a_motion_errs_as_its_neighbour_states_and_much_where_that_was_refuted() -> None:
    first = GIVEN[0]
    known = step_covariances(NODES, [first])
    assert known[0] == pytest.approx(np.linalg.inv(first.information)[:3, :3], rel=1e-6)
    assert (np.diag(known[1]) > np.diag(known[0])).all()
    lost = step_covariances(NODES, [first.judged(REJECTED)])
    assert lost[0].trace() > 50.0
