"""Trajectory and relations scores: evo as the judge, laws, and hand-made cases."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formats.relation_files import read_relations
from mapmyworld.errors import MapError
from mapmyworld.evaluation import ate, relations_score, rpe
from mapmyworld.evaluation.relations_metric import poses_at
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.geometry.rigid import between, se3_exp
from mapmyworld.types import Trajectory
from mapmyworld.types.maps import Relations


def wandering(seed: int, count: int = 60, rate_hz: float = 10.0) -> Trajectory:
    """A random walk in space, each step a small motion."""
    steps = se3_exp(np.random.default_rng(seed).normal(0.02, 0.1, (count, 6)))
    poses = [np.eye(4)]
    for step in steps[1:]:
        poses.append(poses[-1] @ step)
    stamps = 1_700_000_000_000_000_000 + np.arange(count) * round(1e9 / rate_hz)
    return Trajectory(stamps.astype(np.int64), np.stack(poses))


def disturbed(truth: Trajectory, seed: int, size: float = 0.05) -> Trajectory:
    noise = se3_exp(np.random.default_rng(seed).normal(0.0, size, (len(truth.stamps_ns), 6)))
    return Trajectory(truth.stamps_ns, truth.poses @ noise)


def thinned(trajectory: Trajectory, step: int, shift_ns: int = 0) -> Trajectory:
    return Trajectory(trajectory.stamps_ns[::step] + shift_ns, trajectory.poses[::step])


def as_evo(trajectory: Trajectory):
    from evo.core.trajectory import PoseTrajectory3D

    seconds = (trajectory.stamps_ns - trajectory.stamps_ns[0]) * 1e-9
    return PoseTrajectory3D(poses_se3=list(trajectory.poses), timestamps=seconds)


@pytest.mark.parametrize("align", [True, False])
@pytest.mark.parametrize("step", [1, 3])
def test_absolute_error_is_evos(align: bool, step: int) -> None:
    from evo.core import metrics, sync

    truth = wandering(1)
    estimate = thinned(disturbed(truth, 2), step)
    reference_evo, estimate_evo = sync.associate_trajectories(as_evo(truth), as_evo(estimate))
    if align:
        estimate_evo.align(reference_evo)
    score = ate(estimate, truth, align=align)
    for relation, ours in [
        (metrics.PoseRelation.translation_part, score.translation),
        (metrics.PoseRelation.rotation_angle_deg, score.rotation_deg),
    ]:
        judge = metrics.APE(relation)
        judge.process_data((reference_evo, estimate_evo))
        theirs = judge.get_all_statistics()
        for name, value in [("rmse", ours.rmse), ("mean", ours.mean), ("median", ours.median)]:
            assert value == pytest.approx(theirs[name], abs=1e-6)
        for name, value in [("std", ours.std), ("min", ours.minimum), ("max", ours.maximum)]:
            assert value == pytest.approx(theirs[name], abs=1e-6)


@pytest.mark.parametrize(("frames", "distance"), [(1, 0.0), (5, 0.0), (1, 1.0)])
def test_relative_error_is_evos(frames: int, distance: float) -> None:
    from evo.core import metrics

    truth = wandering(3, 120)
    estimate = disturbed(truth, 4)
    unit = metrics.Unit.meters if distance else metrics.Unit.frames
    score = rpe(estimate, truth, frames=frames, distance=distance)
    for relation, ours in [
        (metrics.PoseRelation.translation_part, score.translation),
        (metrics.PoseRelation.rotation_angle_deg, score.rotation_deg),
    ]:
        judge = metrics.RPE(relation, distance or frames, unit)
        judge.process_data((as_evo(truth), as_evo(estimate)))
        assert ours.rmse == pytest.approx(judge.get_statistic(metrics.StatisticsType.rmse), 1e-6)
        assert ours.count == len(judge.error)


@settings(max_examples=25)
@given(st.integers(0, 1000), st.floats(-50, 50), st.floats(-3, 3))
def test_moving_the_estimate_as_a_whole_changes_no_aligned_score(
    seed: int, shift: float, turn: float
) -> None:
    truth = wandering(seed)
    estimate = disturbed(truth, seed + 1)
    moved_poses = planar_to_matrix([shift, -shift, turn]) @ estimate.poses
    moved = Trajectory(estimate.stamps_ns, moved_poses)
    assert ate(moved, truth).rmse == pytest.approx(ate(estimate, truth).rmse, abs=1e-9)
    assert rpe(moved, truth).rmse == pytest.approx(rpe(estimate, truth).rmse, abs=1e-9)


def test_a_straight_drive_can_be_aligned() -> None:
    """Along a line, three-dimensional alignment is open about it; heading still counts."""
    stamps = np.arange(10, dtype=np.int64) * 10**9
    line = np.stack([np.arange(10.0), np.zeros(10), np.zeros(10)], axis=1)
    truth = Trajectory(stamps, planar_to_matrix(line))
    turned = Trajectory(stamps, planar_to_matrix([2.0, 1.0, 0.7]) @ truth.poses)
    score = ate(turned, truth)
    assert score.rmse == pytest.approx(0.0, abs=1e-9)
    assert score.rotation_deg.maximum == pytest.approx(0.0, abs=1e-5)


def test_trajectories_of_different_times_are_refused() -> None:
    truth = wandering(1)
    later = Trajectory(truth.stamps_ns + 10**12, truth.poses)
    with pytest.raises(MapError, match="same log"):
        ate(later, truth)


def test_stamps_that_lie_between_one_anothers_are_reported_what_to_allow() -> None:
    truth = wandering(1)
    between = Trajectory(truth.stamps_ns + 30_000_000, truth.poses)
    with pytest.raises(MapError, match="--max-difference"):
        ate(between, truth)


def test_unsorted_stamps_find_their_own_poses() -> None:
    """Where stamps step back, a pose recorded with the wanted stamp wins over any mixture."""
    truth = wandering(5)
    shuffled = np.random.default_rng(0).permutation(len(truth.stamps_ns))
    scrambled = Trajectory(truth.stamps_ns[shuffled], truth.poses[shuffled])
    assert poses_at(scrambled, truth.stamps_ns) == pytest.approx(truth.poses)


def test_between_two_poses_the_robot_is_half_way() -> None:
    stamps = np.array([0, 100], np.int64)
    pair = Trajectory(stamps, planar_to_matrix([[0.0, 0.0, 0.0], [1.0, 0.0, 0.5]]))
    middle = poses_at(pair, np.array([50, -5, 500], np.int64) * 1)
    assert middle[1] == pytest.approx(pair.poses[0])
    assert middle[2] == pytest.approx(pair.poses[1])
    far = Trajectory(stamps * 10**6, pair.poses)
    assert poses_at(far, np.array([50 * 10**6]))[0] == pytest.approx(
        planar_to_matrix([0.5, 0.0, 0.25])
    )


def test_relations_of_the_true_trajectory_have_no_error() -> None:
    truth = wandering(6)
    pairs = np.array([[3, 40], [50, 10], [0, 59]])
    relations = Relations(
        truth.stamps_ns[pairs], between(truth.poses[pairs[:, 0]], truth.poses[pairs[:, 1]])
    )
    score = relations_score(truth, relations)
    assert score.translation.mean == pytest.approx(0.0, abs=1e-9)
    assert score.rotation_deg.mean == pytest.approx(0.0, abs=1e-5)
    assert score.outside == 0


def test_one_relation_by_hand() -> None:
    """Estimated 2 m ahead, expected 1.9 m ahead and turned by 10 degrees: off by 0.1 m, 10 deg."""
    stamps = np.array([0, 10**9], np.int64)
    estimate = Trajectory(stamps, planar_to_matrix([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]))
    expected = planar_to_matrix([[1.9, 0.0, np.radians(10.0)]])
    score = relations_score(estimate, Relations(stamps[None], expected))
    other = estimate.poses[1] @ np.linalg.inv(expected[0])
    assert score.translation.mean == pytest.approx(0.1)
    assert score.cartographer_translation.mean == pytest.approx(np.hypot(other[0, 3], other[1, 3]))
    assert score.rotation_deg.mean == pytest.approx(10.0)


def test_a_relations_file_is_read_exactly(tmp_path: Path) -> None:
    path = tmp_path / "a.relations"
    path.write_text("976052905.167303 976052911.885496 -0.05699 -0.12843 0 0 0 -1.68221\n\n")
    relations = read_relations(path)
    assert relations.stamps_ns.tolist() == [[976052905167303000, 976052911885496000]]
    assert relations.first_from_second[0] == pytest.approx(
        planar_to_matrix([-0.05699, -0.12843, -1.68221])
    )


@pytest.mark.parametrize(
    "line", ["1 2 3", "a b 0 0 0 0 0 0", "1 2 nan 0 0 0 0 0", "1 2 1e300 0 0 0 0 0", ""]
)
def test_a_bad_relations_file_is_refused_with_its_line(tmp_path: Path, line: str) -> None:
    path = tmp_path / "bad.relations"
    path.write_text(line + "\n")
    with pytest.raises(MapError, match=r"bad\.relations"):
        read_relations(path)


@pytest.mark.real_log
@pytest.mark.parametrize(
    ("name", "metres", "degrees"), [("intel", 7.370, 39.2), ("fr079", 6.504, 30.3)]
)
def test_raw_odometry_scores_as_published(
    data: Path, name: str, metres: float, degrees: float
) -> None:
    """Mean errors of the recorded odometry, known from the data's own description."""
    import bz2
    from decimal import Decimal

    stamps, poses = [], []
    with bz2.open(data / "laser" / f"{name}.clf.bz2", "rt") as lines:
        for line in lines:
            if line.startswith("FLASER"):
                fields = line.split()
                stamps.append(int(Decimal(fields[-3]).scaleb(9)))
                poses.append([float(value) for value in fields[-6:-3]])
    odometry = Trajectory(np.array(stamps, np.int64), planar_to_matrix(poses))
    score = relations_score(odometry, read_relations(data / "laser" / f"{name}.relations"))
    assert score.translation.mean == pytest.approx(metres, abs=6e-4)
    assert score.rotation_deg.mean == pytest.approx(degrees, abs=0.06)
