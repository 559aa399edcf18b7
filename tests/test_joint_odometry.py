"""What scans show of the odometry between them: its systematic errors, its noise, its faults."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from mapmyworld.alignment import joint_alignment
from mapmyworld.alignment.joint_alignment import align_in_rounds
from mapmyworld.alignment.joint_odometry import calibrated_odometry
from mapmyworld.api import Silent
from mapmyworld.backend.system import System, with_edges
from mapmyworld.config import Config
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import between_planar, compose_planar, planar_to_matrix
from mapmyworld.kernels.wheel_model import METRES_PER_RADIAN, RADIANS_PER_METRE
from mapmyworld.odometry.motion_calibration import CalibratedMotions
from mapmyworld.registration.scan_matching import scan_set
from mapmyworld.types import Node

COUNT = 800
ERRORS = np.array([-0.02, 0.006, 0.02, -0.015, 0.01, 0.03])
NOISE = np.array([0.02, 0.015, np.radians(1.5)])
EXACT = np.diag([1e8, 1e8, 1e9])
NO_EDGES = System(
    True, *np.zeros((2, 0), np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.arange(COUNT) - 1
)


def chained(steps: Array) -> Array:
    """(N + 1, 3) the poses that steps (N, 3) lead to."""
    poses = [np.zeros(3)]
    for step in steps:
        poses.append(compose_planar(poses[-1], step))
    return np.array(poses)


class Drive:
    """A drive along a way of bends, with odometry that errs as `ERRORS` and `NOISE` say."""

    def __init__(
        self, faults: int = 0, slower: float = 0.0, noise: float = 1.0, seed: int = 5
    ) -> None:
        random = np.random.default_rng(seed)
        ahead, turn = random.uniform(0.3, 0.6, COUNT - 1), random.uniform(-0.3, 0.5, COUNT - 1)
        steps = np.stack([ahead, np.zeros(COUNT - 1), turn], axis=1)
        position = ahead + METRES_PER_RADIAN * np.abs(turn)
        heading = np.abs(turn) + RADIANS_PER_METRE * ahead
        lengths = np.stack([position, position, heading], axis=1)
        self.steps = steps
        recorded = steps + random.normal(size=steps.shape) * noise * NOISE * np.sqrt(lengths)
        recorded[:, 2] = (1.0 - ERRORS[5]) * recorded[:, 2] - ERRORS[4] * recorded[:, 0]
        recorded[:, :2] /= 1.0 + ERRORS[0] + slower
        self.faults = np.linspace(5, COUNT - 5, faults).astype(np.int64)
        recorded[self.faults, 0] = 0.0
        self.scans = compose_planar(chained(steps), ERRORS[[2, 3, 1]])
        odometry = planar_to_matrix(chained(recorded))
        self.nodes = [Node(k + 1, 1, k, pose, pose) for k, pose in enumerate(odometry)]

    def motions(self) -> tuple[Index, Index, Array, Array]:
        """From scan to scan, as they were tracked: two nodes, the pose, its information."""
        ends = np.arange(COUNT - 1), np.arange(1, COUNT)
        information = np.tile(EXACT, (COUNT - 1, 1, 1))
        return *ends, between_planar(self.scans[:-1], self.scans[1:]), information

    def calibrated(self) -> CalibratedMotions:
        """The odometry, by the scans."""
        *ends, found, _ = self.motions()
        return CalibratedMotions(self.nodes, tuple(ends), found, np.ones(COUNT - 1, np.bool_))


def test_the_odometry_s_noise_and_its_systematic_errors_are_told_apart() -> None:
    found = Drive().calibrated()
    np.testing.assert_allclose(np.sqrt(found.noise[0]), NOISE, rtol=0.2)
    missed = np.abs(found.errors[0] - ERRORS)
    assert (missed < [0.006, 0.006, 0.01, 0.01, 0.006, 0.006]).all()
    assert found.trusted.mean() > 0.98


def test_what_scans_err_by_is_no_noise_of_the_odometry() -> None:
    """Scans are off by a centimetre each: odometry of 10 mm a root of a metre looked like 24 mm."""
    drive, random, sigmas = Drive(noise=0.5), np.random.default_rng(6), [0.01, 0.01, 0.001]
    drive.scans = compose_planar(drive.scans, random.normal(0.0, sigmas, (COUNT, 3)))
    found = drive.calibrated()
    np.testing.assert_allclose(np.sqrt(found.noise[0]), 0.5 * NOISE, rtol=0.35)
    assert found.trusted.mean() > 0.98


def test_noise_of_the_odometry_makes_its_scale_neither_larger_nor_smaller() -> None:
    """Of 0.05 m a root of a metre and steps of 0.3 to 0.6 m it is half a percent, squared."""
    missed = [Drive(noise=2.5, seed=k).calibrated().errors[0, 0] - ERRORS[0] for k in range(16)]
    assert abs(np.mean(missed)) < 0.0025


def test_what_was_tracked_counts_where_odometry_is_at_fault() -> None:
    drive = Drive(faults=20)
    found = drive.calibrated()
    assert not found.trusted[drive.faults].any()
    assert found.trusted.mean() > 0.93
    np.testing.assert_allclose(np.sqrt(found.noise[0]), NOISE, rtol=0.5)
    matched = np.ones(COUNT - 1, np.bool_)
    edges, known = calibrated_odometry(drive.nodes, np.arange(COUNT), drive.motions(), matched)
    for information in (edges[3], known):
        np.testing.assert_array_equal(information[drive.faults], np.tile(EXACT, (20, 1, 1)))
    np.testing.assert_array_equal(edges[0], np.arange(COUNT - 1))


def test_motions_that_walls_leave_open_show_no_scale_along_them() -> None:
    """They are the odometry's own, by the scale that was known at their time: 5 % too large."""
    drive = Drive()
    tails, heads, true, information = drive.motions()
    found = true.copy()
    found[::2, 0] *= 1.05
    information[::2] = np.diag([1.0, 1e8, 1e9])
    matched = np.ones(COUNT - 1, np.bool_)
    tracked = tails, heads, found, information
    edges, known = calibrated_odometry(drive.nodes, np.arange(COUNT), tracked, matched)
    measured, weights = edges[2:]
    by_wheels = np.abs(measured - found).max(axis=1) > 1e-9
    assert by_wheels.mean() > 0.9
    ahead = measured[by_wheels, 0].sum() / true[by_wheels, 0].sum()
    assert ahead == pytest.approx(1.0, abs=0.006)
    is_open = by_wheels & (np.arange(COUNT - 1) % 2 == 0)
    np.testing.assert_allclose(known[is_open, 0, 0], 1.0)
    np.testing.assert_array_equal(known[~is_open], weights[~is_open])


def test_every_session_has_wheels_of_its_own() -> None:
    drives = [Drive(), Drive(slower=0.1)]
    nodes = [replace(n, session=k) for k, drive in enumerate(drives) for n in drive.nodes]
    scans = np.concatenate([drive.scans for drive in drives])
    ends = np.concatenate([np.arange(COUNT - 1), np.arange(COUNT, 2 * COUNT - 1)])
    steps = between_planar(scans[ends], scans[ends + 1])
    found = CalibratedMotions(nodes, (ends, ends + 1), steps, np.ones(len(ends), np.bool_))
    np.testing.assert_allclose(found.errors[:, 0], [ERRORS[0], ERRORS[0] + 0.1], atol=0.006)
    np.testing.assert_allclose(np.sqrt(found.noise), [NOISE, NOISE], rtol=0.25)


@pytest.mark.parametrize("matched", [True, False])
def test_a_robot_that_stands_and_motions_that_nothing_matched_are_as_tracked(matched: bool) -> None:
    pose = planar_to_matrix(np.zeros((3, 3)))
    nodes = [Node(k + 1, 1, k, pose[k], pose[k]) for k in range(3)]
    ends = np.arange(2), np.arange(1, 3)
    tracked = *ends, np.tile([0.5, 0.0, 0.0], (2, 1)), np.tile(EXACT, (2, 1, 1))
    poses = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [1.0, 0.0, 0.0]])
    if not matched:
        steps = planar_to_matrix(poses)
        nodes = [Node(k + 1, 1, k, steps[k], steps[k]) for k in range(3)]
    which = np.full(2, matched)
    edges, known = calibrated_odometry(nodes, np.arange(3), tracked, which)
    for found, expected in zip((*edges, known), (*tracked, tracked[3]), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("pull", [0.001, 0.003])
def test_what_all_pairs_have_in_common_shortens_no_path_round_by_round(
    pull: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Odometry that was fitted again to poses which it holds itself yielded a little every time."""
    drive, known = Drive(), np.diag([4.0, 400.0, 400.0])
    pairs = np.array([(k, k + d) for d in (1, 2, 3) for k in range(COUNT - d)], np.int64)

    def measure(first: int, last: int, *given: NDArray[np.generic] | float) -> None:
        """Pairs as they are, but nearer by the `pull`: weakly along the way, well across it."""
        poses, systems = given[4], given[-1]
        assert isinstance(poses, np.ndarray)
        assert isinstance(systems, np.ndarray)
        tails, heads = pairs[first:last].T
        true = between_planar(drive.scans[tails], drive.scans[heads])
        true[:, 0] -= pull
        off = between_planar(true, between_planar(poses[tails], poses[heads]))
        systems[first:last, [0, 3, 5]] = known.diagonal()
        systems[first:last, 6:9] = off @ known
        systems[first:last, 9:11] = 100.0, 100.0 * 0.01**2

    monkeypatch.setattr(joint_alignment, "pair_systems", measure)
    matched = np.ones(COUNT - 1, np.bool_)
    edges, _ = calibrated_odometry(drive.nodes, np.arange(COUNT), drive.motions(), matched)
    odometry = with_edges(NO_EDGES, *edges)
    ways = []
    for rounds in (3, 6, 24):
        rest = (lambda _: pairs), Config(threads=1), Silent(), np.full(rounds, 0.12)
        solved = align_in_rounds(scan_set([]), odometry, drive.scans, *rest)
        steps = np.diff(solved.poses[:, :2], axis=0)
        ways.append(float(np.hypot(*steps.T).sum()))
        np.testing.assert_array_equal(solved.joint.measured[: COUNT - 1], odometry.measured)
        np.testing.assert_array_equal(solved.joint.information[: COUNT - 1], odometry.information)
    assert ways[2] == pytest.approx(ways[1], rel=1e-5)
