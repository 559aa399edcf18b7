"""The fast filter: shared maps, scan matching, proposals, smoothing, and whole runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from plain_occupancy import SensorModel, update_occupancy_grid

from formats.logs import open_log
from formats.relation_files import read_relations
from mapmyworld.config import Config, MappingConfig, ParticlesConfig
from mapmyworld.errors import LogError
from mapmyworld.evaluation import ate, relations_score
from mapmyworld.geometry.planar import between_planar, compose_planar, planar_to_matrix
from mapmyworld.kernels.wheel_model import new_wheels
from mapmyworld.mapping.occupancy import build_grid
from mapmyworld.particles.fastslam import beams_from_scan, run_fastslam
from mapmyworld.particles.filter import ParticleFilter
from mapmyworld.particles.history import loops_reentered
from mapmyworld.particles.kernels.likelihood import log_likelihood
from mapmyworld.particles.kernels.surface_tiles import Beams
from mapmyworld.particles.motions import Motion, motions_between
from mapmyworld.particles.proposal import Proposal, improved_proposal
from mapmyworld.particles.smoothing import smooth_path
from mapmyworld.particles.tiles import TileMaps
from mapmyworld.sensing import make_plan, read_frames, survey_log
from mapmyworld.types import Frame, OccupancyGrid, Scan, Trajectory

Array = NDArray[np.float64]
SETTINGS = ParticlesConfig(count=6, count_min=6)
SIGMA = 0.04  # m, end points about surfaces


def segments(*corners: tuple[float, float]) -> Array:
    ring = np.array([*corners, corners[0]])
    return np.stack([ring[:-1], ring[1:]], axis=1)


# A ring corridor 2 m wide around a block, with niches that break its symmetry.
RING = np.concatenate(
    [
        segments((0, 0), (5, 0), (5, -0.6), (5.8, -0.6), (5.8, 0), (12, 0), (12, 9), (0, 9)),
        segments((2, 2), (10, 2), (10, 4), (9.4, 4), (9.4, 4.7), (10, 4.7), (10, 7), (2, 7)),
    ]
)
CORRIDOR = np.array([[[-30.0, -1.0], [30.0, -1.0]], [[-30.0, 1.0], [30.0, 1.0]]])


def cast(walls: Array, pose: Array, beams: int = 181, range_max: float = 12.0) -> Scan:
    """What a lidar at `pose` sees of walls (S, 2, 2): the nearest crossing of every ray."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, beams)
    d = np.stack([np.cos(angles + pose[2]), np.sin(angles + pose[2])], axis=-1)[:, None]
    a, edge = walls[None, :, 0] - pose[:2], (walls[:, 1] - walls[:, 0])[None]
    cross = d[..., 0] * edge[..., 1] - d[..., 1] * edge[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        way = (a[..., 0] * edge[..., 1] - a[..., 1] * edge[..., 0]) / cross
        share = (a[..., 0] * d[..., 1] - a[..., 1] * d[..., 0]) / cross
    way = np.where((way > 0) & (share >= 0) & (share <= 1), way, np.inf).min(axis=1)
    seen = way < range_max
    ends = way[seen, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)[seen]
    return Scan(
        ends.astype(np.float32),
        np.zeros(3),
        angles[~seen].astype(np.float32),
        range_max,
        float(angles[1] - angles[0]),
    )


def beams_at(walls: Array, pose: Array) -> Beams:
    return beams_from_scan(cast(walls, pose), ParticlesConfig(range_max=12.0))


def drive_round(laps: float, step: float = 0.12) -> Array:
    """Poses (T, 3) along the middle of the ring corridor, corners turned on the spot."""
    corners = np.array([[1.0, 1.0], [11.0, 1.0], [11.0, 8.0], [1.0, 8.0]])
    poses, heading = [], 0.0
    for side in range(int(4 * laps)):
        a, b = corners[side % 4], corners[(side + 1) % 4]
        turns = np.arange(-np.pi / 2, 0.0, 0.12) if side else [0.0]
        poses += [[*a, heading + turn] for turn in turns]
        ways = np.arange(step, np.hypot(*(b - a)), step)
        poses += [[*(a + way * (b - a) / np.hypot(*(b - a))), heading] for way in ways]
        heading += np.pi / 2
    return np.array(poses)


class Silence:
    def stage(self, name: str, total: float | None = None, unit: str = "") -> None: ...
    def update(self, done: float) -> None: ...
    def note(self, message: str) -> None: ...


def recorded(truth: Array, bias: Array, *, odometry: bool = True) -> list[Frame]:
    """Moments whose odometry errs by `bias` (3,): shares of x and y, rad of yaw a metre."""
    motions = between_planar(truth[:-1], truth[1:])
    way = np.hypot(motions[:, 0], motions[:, 1])
    motions[:, :2] *= 1.0 + bias[:2]
    motions[:, 2] += bias[2] * way
    poses = [np.zeros(3)]
    for motion in motions:
        poses.append(compose_planar(poses[-1], motion))
    return [
        Frame(k * 100_000_000, planar_to_matrix(p) if odometry else None, cast(RING, x))
        for k, (x, p) in enumerate(zip(truth, poses, strict=True))
    ]


def error(path: Array, truth: Array) -> float:
    """Absolute trajectory error (m)."""
    stamps = np.arange(len(path), dtype=np.int64)
    estimate, reference = (Trajectory(stamps, planar_to_matrix(p)) for p in (path, truth))
    return ate(estimate, reference).rmse


def test_known_poses_give_the_graph_pipelines_grid() -> None:
    poses = drive_round(1.0)[::24] + np.array([0.0137, 0.0071, 0.0031])
    scans = [cast(RING, pose) for pose in poses]
    confident = MappingConfig(clamp_probability=1.0 - 1e-12)
    expected = build_grid(zip(poses, scans, strict=True), Config(mapping=confident))
    grid = OccupancyGrid(
        np.full_like(expected.log_odds, np.nan), expected.resolution, expected.origin
    )
    sensor = SensorModel(confident.hit_probability, confident.miss_probability, limit=100.0)
    for pose, z in zip(poses, scans, strict=True):
        grid = update_occupancy_grid(z, pose, grid, sensor)
    np.testing.assert_allclose(grid.log_odds, expected.log_odds, atol=1e-4)


def test_particles_share_tiles_until_they_write() -> None:
    maps = TileMaps(4, 0.05, 1)
    pose = np.array([1.0, 1.0, 0.0])
    maps.insert(beams_at(RING, pose), np.tile(pose, (4, 1)))
    alone = len(np.unique(maps.surfaces.tables)) - 1  # all but the empty one
    maps.resample(np.zeros(4, np.int64))
    assert len(np.unique(maps.surfaces.tables)) - 1 == alone // 4
    before = [array.copy() for array in maps.surfaces[1:3]]
    tables = maps.surfaces.tables.copy()
    far = np.array([1.0, 8.0, 0.0])
    maps.insert(beams_at(RING, far), np.stack([far, far, far, pose]))
    for array, old in zip(maps.surfaces[1:3], before, strict=True):
        kept = np.unique(tables[0][np.isin(tables[0], maps.surfaces.tables)])
        np.testing.assert_array_equal(array[kept], old[kept])


def test_one_particles_map_does_not_depend_on_the_others() -> None:
    poses = drive_round(0.5)[::10]
    lone, many = TileMaps(1, 0.05, 1), TileMaps(5, 0.05, 1)
    for k, pose in enumerate(poses):
        z = beams_at(RING, pose)
        lone.insert(z, pose[None])
        others = compose_planar(pose, np.outer(np.arange(5), [0.1, -0.2, 0.3]))
        many.insert(z, others)
        if k % 3 == 2:
            many.resample(np.array([0, 2, 2, 0, 4]))
    a, b = lone.surfaces, many.surfaces
    shift = a.base - b.base
    for y, x in np.argwhere(a.tables[0]):
        slot, same = a.tables[0, y, x], b.tables[0, y + shift[0], x + shift[1]]
        np.testing.assert_array_equal(a.visits[slot], b.visits[same])
        np.testing.assert_array_equal(a.hits[slot], b.hits[same])
        np.testing.assert_array_equal(a.means[slot], b.means[same])


def mapped(walls: Array, poses: Array) -> TileMaps:
    maps = TileMaps(1, 0.05, 1)
    for pose in poses:
        maps.insert(beams_at(walls, pose), pose[None])
    return maps


def one(u: Array, covariance: Array) -> Motion:
    """A motion with a single mode."""
    return Motion(u[None], covariance[None], np.ones(1))


def test_the_proposal_finds_the_true_pose_and_knows_how_well() -> None:
    around = np.array([[1.0 + 0.1 * k, 1.0, 0.05 * k] for k in range(8)])
    truth = np.array([1.43, 1.08, 0.21])
    u = np.array([0.05, -0.04, 0.03])
    wide = np.diag([0.1, 0.1, 0.05]) ** 2
    maps = mapped(RING, around)
    z = beams_at(RING, truth)
    start = compose_planar(truth, np.array([-0.11, 0.09, -0.06]))
    proposal = improved_proposal(start[None], [one(u, wide)], [z], maps, SIGMA)
    assert np.hypot(*(proposal.mean[0, 0] - truth)[:2]) < 0.01
    assert abs(proposal.mean[0, 0, 2] - truth[2]) < 0.005
    assert np.sqrt(proposal.covariance[0, 0].diagonal()).max() < 0.02


def test_in_a_corridor_the_proposal_is_as_long_as_the_motion_leaves_it() -> None:
    poses = np.array([[0.1 * k, 0.0, 0.0] for k in range(8)])
    motion = np.diag([0.2, 0.2, 0.05]) ** 2
    maps = mapped(CORRIDOR, poses)
    z = beams_at(CORRIDOR, np.array([0.8, 0.0, 0.0]))
    u = np.array([0.1, 0.0, 0.0])
    proposal = improved_proposal(poses[-1:], [one(u, motion)], [z], maps, SIGMA)
    sigma = np.sqrt(proposal.covariance[0, 0].diagonal())
    assert sigma[0] == pytest.approx(0.2, rel=0.3)
    assert sigma[1] < 0.02


@pytest.mark.parametrize("off", [0.06, 0.07, 0.08])
def test_two_marks_of_a_corridor_draw_the_scan_however_good_the_laser_is(off: float) -> None:
    """End points lie 6 mm about surfaces, the odometry is ten times as far beside the truth."""
    marks = np.array([[[4.0, -1.0], [4.0, -0.7]], [[6.0, 0.7], [6.0, 1.0]]])
    walls = np.concatenate([CORRIDOR, marks])
    maps = mapped(walls, np.array([[0.1 * k, 0.0, 0.0] for k in range(12)]))
    truth = np.array([1.3, 0.0, 0.0])
    motion = one(np.array([0.2 + off, 0.0, 0.0]), np.diag([0.03, 0.03, 0.01]) ** 2)
    start, z = np.array([1.1, 0.0, 0.0]), beams_at(walls, truth)
    proposal = improved_proposal(start[None], [motion], [z], maps, 0.006)
    assert abs(proposal.mean[0, 0, 0] - truth[0]) < 0.01


def test_weights_prefer_the_particle_that_is_right() -> None:
    truth = np.array([1.3, 1.0, 0.1])
    maps = mapped(RING, np.array([[1.0 + 0.1 * k, 1.0, 0.0] for k in range(8)]))
    maps.resample(np.zeros(2, np.int64))
    x = np.stack([truth, truth + np.array([0.6, 0.5, 0.4])])
    u, tight = np.zeros(3), np.diag([0.005, 0.005, 0.002]) ** 2
    z = beams_at(RING, truth)
    proposal = improved_proposal(x, [one(u, tight)], [z], maps, SIGMA)
    assert proposal.log_weight[0] > proposal.log_weight[1] + 0.5


def test_a_scan_that_fits_two_places_is_placed_where_the_odometry_leads() -> None:
    """Two niches of a corridor 0.5 m apart, the odometry 0.2 m beside the one it is at."""
    niche = [(0.0, -1.0), (0.0, -1.4), (0.2, -1.4), (0.2, -1.0)]
    ends = [(-30.0, -1.0), *niche, *((x + 0.5, y) for x, y in niche), (30.0, -1.0)]
    below = np.stack([np.array(ends[:-1]), np.array(ends[1:])], axis=1)
    walls = np.concatenate([below, CORRIDOR[1:]])
    maps = mapped(walls, np.array([[-1.0 + 0.1 * k, 0.0, 0.0] for k in range(12)]))
    truth = np.array([0.1, 0.0, 0.3])
    u = np.array([0.2, 0.1, np.radians(8.0)])
    motion = one(u, np.diag([0.12, 0.12, np.radians(5.0)]) ** 2)
    z = beams_at(walls, truth)
    proposal = improved_proposal(truth[None], [motion], [z], maps, SIGMA)
    assert np.hypot(*(proposal.mean[0, 0] - truth)[:2]) < 0.02
    assert abs(proposal.mean[0, 0, 2] - truth[2]) < 0.01


def stalled() -> tuple[Array, TileMaps, Motion]:
    """A robot that stands, 400 particles with its map, wheels that count 0.8 m and 0.4 rad."""
    truth = np.array([1.3, 1.0, 0.1])
    tight = np.diag([0.01, 0.01, 0.005]) ** 2
    maps = mapped(RING, np.array([[1.0 + 0.1 * k, 1.0, 0.0] for k in range(8)]))
    maps.resample(np.zeros(400, np.int64))
    u = np.array([[0.6, 0.5, 0.4], [0.0, 0.0, 0.0]])
    return truth, maps, Motion(u, np.stack([tight, tight]), np.array([0.99, 0.01]))


def test_where_odometry_and_tracking_differ_particles_take_what_the_map_confirms() -> None:
    truth, maps, motion = stalled()
    z = beams_at(RING, truth)
    proposal = improved_proposal(np.tile(truth, (400, 1)), [motion], [z], maps, SIGMA)
    x = proposal.sample(np.random.default_rng(3))
    right = np.hypot(*(x - truth)[:, :2].T) < 0.1
    assert right.mean() == pytest.approx(proposal.chosen[0, 1], abs=0.01)
    assert right.mean() > 0.9


def test_modes_get_their_shares_of_the_particles_to_one() -> None:
    count = np.array([0.3, 0.7]) * 400
    chosen = np.tile([0.3, 0.7], (400, 1))
    mean = np.tile([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]], (400, 1, 1))
    tight = np.tile(1e-6 * np.eye(3), (400, 2, 1, 1))
    proposal = Proposal(mean, tight, np.log(chosen), chosen)
    x = proposal.sample(np.random.default_rng(3))
    assert abs(np.count_nonzero(x[:, 0] < 1.0) - count[0]) <= 1


def test_the_scans_after_one_that_lies_decide_between_it_and_the_odometry() -> None:
    """One scan has the robot turned by 20 degrees, the two after it have it not."""
    truth = np.array([1.3, 1.0, 0.1])
    tight = np.diag([0.01, 0.01, 0.01]) ** 2
    maps = mapped(RING, np.array([[1.0 + 0.1 * k, 1.0, 0.0] for k in range(8)]))
    u = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.35]])
    fork = Motion(u, np.stack([tight, tight]), np.array([0.99, 0.01]))
    still = one(np.zeros(3), tight)
    lie, z = beams_at(RING, truth + np.array([0.0, 0.0, 0.35])), beams_at(RING, truth)
    alone = improved_proposal(truth[None], [fork], [lie], maps, SIGMA)
    proposal = improved_proposal(truth[None], [fork, still, still], [lie, z, z], maps, SIGMA)
    assert alone.chosen[0, 1] > 0.99
    assert proposal.chosen[0, 0] > 0.99


def test_odometry_that_contradicts_the_tracked_motion_is_a_mode_of_its_own() -> None:
    """Four steps of 0.1 m, the third with stalled wheels; the fourth without odometry."""
    poses = np.array([[0.1 * k, 0.0, 0.0] for k in range(5)])
    recorded = np.array([[np.nan] * 3, [0.1, 0, 0], [0.1, 0, 0], [0, 0, 0], [np.nan] * 3])
    covariances = np.tile(np.diag([1e-4, 1e-4, 1e-4]), (5, 1, 1))
    tracked = poses, covariances, recorded, new_wheels()
    motions = motions_between([0, 1, 2, 3, 4], *tracked, Config().odometry)
    assert [len(motion.u) for motion in motions] == [1, 1, 2, 1]
    np.testing.assert_allclose(motions[2].u, [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]], atol=1e-12)
    assert motions[2].nearest(np.array([0.09, 0.0, 0.0])) == 1
    np.testing.assert_allclose(motions[2].probability, [4 / 6, 2 / 6])


def test_the_odometry_is_as_uncertain_as_tracking_shows_and_faults_do_not_count() -> None:
    """Steps of 1 m in which the wheels err by 0.06 m and 0.05 rad, and each tenth stalls."""
    random = np.random.default_rng(4)
    steps = np.tile([1.0, 0.0, 0.0], (400, 1))
    poses = np.cumsum(np.concatenate([np.zeros((1, 3)), steps]), axis=0)
    recorded = steps + random.normal(size=(400, 3)) * [0.06, 0.06, 0.05]
    recorded[::10] = 0.0
    recorded = np.concatenate([np.full((1, 3), np.nan), recorded])
    covariances = np.tile(np.diag([1e-6, 1e-6, 1e-6]), (401, 1, 1))
    tracked = poses, covariances, recorded, new_wheels()
    motions = motions_between(list(range(401)), *tracked, Config().odometry)
    moved = [motion.covariance[0].diagonal() for motion in motions if len(motion.u) == 1]
    np.testing.assert_allclose(np.sqrt(np.mean(moved, axis=0)), [0.06, 0.06, 0.05], rtol=0.1)
    assert sum(len(motion.u) == 2 for motion in motions) == 40


def test_what_was_never_seen_speaks_neither_for_a_pose_nor_against_it() -> None:
    """A scan of a wall that is mapped, of one in the open, and of one beyond the map."""
    maps = mapped(RING, np.array([[1.0, 1.0, 0.0]]))
    pose = np.zeros(3)
    at = [np.array([[2.0 + 0.1 * k, y] for k in range(20)]) for y in (0.0, 1.0, 50.0)]
    beams = [Beams(some, np.zeros((20, 2)), np.ones(2)) for some in at]
    wall, free, unseen = (log_likelihood(maps.surfaces, 0, some, pose, 2, SIGMA) for some in beams)
    assert free < unseen < wall
    assert unseen == pytest.approx(10.0 * np.log(0.1))


@pytest.mark.parametrize("noise", [0.005, 0.03])
def test_how_far_end_points_lie_from_surfaces_is_learnt_from_the_scans(noise: float) -> None:
    random = np.random.default_rng(5)
    truth = drive_round(0.25)
    particles = ParticleFilter(SETTINGS, 1, 0)
    steps = between_planar(truth[:-1], truth[1:])
    motions = [one(u, np.diag([0.01, 0.01, 0.005]) ** 2) for u in steps]
    for k, pose in enumerate(truth):
        exact = beams_at(RING, pose)
        ranges = np.hypot(*exact.points.T)
        off = 1.0 + noise * random.standard_normal(len(ranges)) / ranges
        z = Beams(exact.points * off[:, None], exact.normals, exact.origin)
        particles.step(motions[k - 1 : k] if k else [], [z])
    assert particles.surface_sigma == pytest.approx(3.0 * noise, rel=0.5)


def drifted(yaw: float) -> tuple[Array, Array, Array]:
    """A lap and a quarter that turned `yaw` rad a metre too much: truth, motions and path."""
    truth = drive_round(1.25, step=0.4)
    motions = between_planar(truth[:-1], truth[1:])
    motions[:, 2] += yaw * np.hypot(*motions[:, :2].T)
    path = truth[:1]
    for motion in motions:
        path = np.append(path, compose_planar(path[-1:], motion), axis=0)
    return truth, motions, path


def comb(count: int, spacing: float) -> Array:
    """Walls of equal niches along the ring's lower corridor, one every `spacing` metres."""
    corners = [(0.0, 0.0)]
    for k in range(count):
        x = 1.0 + spacing * k
        corners += [(x, 0.0), (x, -0.4), (x + 0.5, -0.4), (x + 0.5, 0.0)]
    outer = segments(*corners, (12.0, 0.0), (12.0, 9.0), (0.0, 9.0))
    return np.concatenate([outer, segments((2, 2), (10, 2), (10, 7), (2, 7))])


@pytest.mark.parametrize("walls", [RING, comb(8, 1.3)], ids=["niches", "equal doors"])
@pytest.mark.parametrize(("yaw", "off"), [(0.0035, 0.15), (0.012, 0.5), (0.025, 1.0)])
def test_smoothing_closes_a_loop_that_no_particle_closed(
    yaw: float, off: float, walls: Array
) -> None:
    truth, motions, path = drifted(yaw)
    covariances = np.tile(np.diag([0.02, 0.02, max(yaw, 0.01)]) ** 2, (len(motions), 1, 1))
    scans = [cast(walls, pose) for pose in truth]
    stamps = np.arange(len(truth)) * 100_000_000
    given = covariances, np.full(truth.shape, np.nan), stamps, scans
    smoothed = smooth_path(path, motions, *given, Config(), Silence())
    assert error(path, truth) > off
    assert error(smoothed, truth) < 0.02


def test_loops_are_counted_once_each() -> None:
    """Three laps of a circle of 63 m around: back at the start once, then never away again."""
    angle = np.linspace(0.0, 6 * np.pi, 600)
    circle = 10.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    found = loops_reentered(circle)
    assert len(found) == 1
    assert angle[found[0]] == pytest.approx(2 * np.pi - 0.2, abs=0.05)
    assert loops_reentered(np.stack([np.linspace(0, 100, 500), np.zeros(500)], axis=-1)) == []


def test_a_log_without_scans_is_refused() -> None:
    with pytest.raises(LogError, match="laser"):
        run_fastslam([Frame(0, np.eye(4), None)], Config(), Silence())


def test_scans_without_a_return_between_others_do_no_harm() -> None:
    truth = drive_round(0.25, step=0.2)[:12]
    moments = recorded(truth, np.zeros(3))
    blind = replace(moments[2].scan, points=np.zeros((0, 2), np.float32))
    moments[2] = replace(moments[2], scan=blind)
    result = run_fastslam(moments, Config(particles=SETTINGS), Silence())
    assert error(result.path, truth) < 0.03


def test_one_scan_makes_a_path() -> None:
    result = run_fastslam(
        [Frame(5, None, cast(RING, np.array([1.0, 1.0, 0.0])))], Config(), Silence()
    )
    np.testing.assert_array_equal(result.path, np.zeros((1, 3)))


def test_the_same_bytes_for_any_number_of_threads_and_others_for_other_seeds() -> None:
    moments = recorded(drive_round(0.5, step=0.2), np.array([0.05, 0.0, 0.03]))
    runs = [
        run_fastslam(moments, Config(seed=seed, threads=threads, particles=SETTINGS), Silence())
        for seed, threads in ((3, 1), (3, 3), (4, 1))
    ]
    assert runs[0].path.tobytes() == runs[1].path.tobytes()
    assert runs[0].covariances.tobytes() == runs[1].covariances.tobytes()
    assert runs[0].covariances.tobytes() != runs[2].covariances.tobytes()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bias", "odometry"), [([0.05, 0.05, 0.05], True), ([0.0, 0.0, 0.0], False)]
)
def test_a_ring_closes_whatever_odometry_says(bias: list[float], odometry: bool) -> None:
    """A lap and a quarter of 34 m; odometry 5 % too long, turning 3 degrees a metre, or none."""
    truth = drive_round(1.25)
    moments = recorded(truth, np.array(bias), odometry=odometry)
    result = run_fastslam(moments, Config(particles=SETTINGS), Silence())
    assert error(result.path, truth) < 0.05
    assert result.summary["loops_reentered"] == 1
    assert len(result.stamps_ns) == len(result.path) == len(result.covariances) == len(truth)
    assert np.linalg.eigvalsh(result.covariances).min() > -1e-12


@pytest.mark.slow
def test_odometry_that_counts_forwards_while_reversing_is_outvoted() -> None:
    """Forwards, 1.5 m back, forwards again, with a niche in view; all forwards by odometry."""
    x = np.concatenate(
        [np.arange(2.0, 5.0, 0.1), np.arange(5.0, 3.5, -0.1), np.arange(3.5, 5, 0.1)]
    )
    truth = np.column_stack([x, np.full(len(x), 1.0), np.zeros(len(x))])
    moments = recorded(truth, np.zeros(3))
    forwards = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(x)))])
    lies = [
        Frame(m.stamp_ns, planar_to_matrix(np.array([way, 0.0, 0.0])), m.scan)
        for m, way in zip(moments, forwards, strict=True)
    ]
    result = run_fastslam(lies, Config(particles=SETTINGS), Silence())
    assert error(result.path, truth) < 0.03


@pytest.mark.slow
@pytest.mark.real_log
def test_fr079_as_recorded(data: Path) -> None:
    """A log on which GMapping is a metre off, because odometry counts reversing as driving on.

    Eight particles, for speed; the figures in the documentation are for thirty.
    """
    log = open_log([data / "laser" / "fr079.clf.bz2"])
    config = Config(particles=ParticlesConfig(count=8, count_min=8))
    plan = make_plan(survey_log(log), config.sensing)
    result = run_fastslam(read_frames(log, plan, config.sensing), config, Silence())
    path = Trajectory(result.stamps_ns, planar_to_matrix(result.path))
    score = relations_score(path, read_relations(data / "laser" / "fr079.relations"))
    assert score.translation.mean < 0.044
    assert score.rotation_deg.mean < 0.8
