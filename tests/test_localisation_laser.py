"""A laser in a known place: recognised, tracked, carried away, and lost where it must be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from known_rooms import SQUARE, frames_of, grid_of, tour
from laser_rooms import WALLS, cast
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.errors import MapError
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    matrix_to_planar,
    wrap_angle,
)
from mapmyworld.kernels.map_search import cast_rays
from mapmyworld.localisation.global_localisation import Discovery, GlobalLocalisation
from mapmyworld.localisation.known_place import KnownPlace, known_place_from_grid
from mapmyworld.localisation.laser_localisation import LaserLocaliser
from mapmyworld.localisation.observation import Moment
from mapmyworld.places.refuted_odometry import FAULT_ODDS
from mapmyworld.registration.place_evidence import Place
from mapmyworld.registration.scan_matching import prepare_scan
from mapmyworld.registration.submaps import Submap
from mapmyworld.types import OccupancyGrid
from mapmyworld.types.localisation import Estimate, State

Array = NDArray[np.float64]
MAPPED = tour([(-2, -1.5), (0, -1.5), (0, 0.6), (2, 0.6), (4.8, -1.5), (4.8, 3), (2, 3), (2, 0.6),
               (-2, 0.6), (-2, 2), (-2, -1.5)])  # fmt: skip
DRIVEN = tour([(2, 3), (4.6, 2.8), (4.6, -1.2), (2, 0.5), (-1, 0.6), (-1.5, -1.5)])
HALL_SIZE = 12.0, 7.0
HALL = np.array([[0, 0, 12, 0], [12, 0, 12, 7], [12, 7, 0, 7], [0, 7, 0, 0]], np.float64)


@pytest.fixture(scope="module")
def place() -> KnownPlace:
    return known_place_from_grid(grid_of(MAPPED[::3]), Config())


def errors(found: list[Estimate], truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Metres and radians (N, 2)."""
    poses = matrix_to_planar(np.stack([e.map_from_base for e in found]))
    off = poses - truth
    return np.stack([np.hypot(off[:, 0], off[:, 1]), np.abs(wrap_angle(off[:, 2]))], axis=-1)


def claims(found: list[Estimate]) -> NDArray[np.bool_]:
    return np.array([e.state != State.LOST for e in found])


def test_an_unknown_start_is_found_and_tracked(place: KnownPlace) -> None:
    """To a cell of 5 cm of the grid at most; the moments before are worked out backwards."""
    found = LaserLocaliser(place, Config()).follow(frames_of(DRIVEN))
    error, claimed = errors(found, DRIVEN), claims(found)
    assert len(found) == len(DRIVEN)
    assert np.flatnonzero(claimed)[0] < 50  # 2.5 m at most
    assert np.median(error[claimed, 0]) < 0.03
    assert np.percentile(error[claimed, 0], 95) < 0.08
    assert np.median(np.degrees(error[claimed, 1])) < 0.5
    assert all(e.known for e in found)
    assert error[:, 0].max() < 0.15


def test_poses_lie_within_their_covariance(place: KnownPlace) -> None:
    found = LaserLocaliser(place, Config()).follow(frames_of(DRIVEN))
    error, claimed = errors(found, DRIVEN), claims(found)
    sigma = np.sqrt([np.trace(e.covariance[3:5, 3:5]) for e in found])
    assert np.mean(error[claimed, 0] < 4.0 * sigma[claimed]) > 0.9
    assert np.all([np.all(np.linalg.eigvalsh(e.covariance) > 0) for e in found])


def test_being_carried_away_is_noticed_and_the_place_found_again(place: KnownPlace) -> None:
    """The wheels stand still while the robot is carried from one room to the other."""
    first = tour([(2, 3), (4.6, 2.8), (4.6, 0)])
    second = tour([(-2.5, 0.5), (0.2, 0.6), (0, -1.5), (-2, -1.5)])
    truth = np.concatenate([first, second])
    carried = len(first)
    found = LaserLocaliser(place, Config()).follow(frames_of(truth, jumps=[carried]))
    error, claimed = errors(found, truth), claims(found)
    lost = np.flatnonzero(~claimed[carried:])
    assert len(lost)
    assert lost[0] < 5
    assert claimed[-1]
    assert error[claimed, 0].max() < 0.3
    assert error[-1, 0] < 0.08


def test_what_was_seen_before_a_loss_does_not_hold_the_search_there(place: KnownPlace) -> None:
    """The motion by scans and odometry agree that the robot stands still, and it is elsewhere."""
    before, after = tour([(2, 3), (4.6, 2.8)]), tour([(-2.5, 0.5), (0.2, 0.6)])
    seeker = GlobalLocalisation(place, Config())
    for k in range(len(before)):
        step = between_planar(before[k - 1], before[k]) if k else np.zeros(3)
        seeker.follow(moment_at(before[k], before[k], step, k))
    found = None
    for k in range(len(after)):
        step = between_planar(after[k - 1], after[k]) if k else np.zeros(3)
        tracked = compose_planar(before[-1], between_planar(after[0], after[k]))
        moment = moment_at(after[k], tracked, step, k, shaken=k == 0)
        seeker.follow(moment)
        if k == 0:
            seeker.begin(moment, before[-1])
        found = seeker.look(moment)
        if found is not None:
            break
    assert found is not None
    assert np.hypot(*(found.match.pose - after[k])[:2]) < 0.1


def test_where_motions_led_on_another_place_takes_the_odds_of_a_fault(
    place: KnownPlace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Recognised by a little more than chance: enough where nothing is known of the robot."""
    pose = DRIVEN[45]
    moment = moment_at(pose, pose, np.zeros(3), 0)
    whole = place.whole
    view = Place.seen_by(moment.scan)
    there = whole.find(view)
    assert there is not None
    odds = whole.judge(view, there).log_odds

    def found(reckoned: Array | None, share: float, then: Array) -> list[Discovery | None]:
        """Here, and by the scan that is taken half a metre on at the pose `then` (3,)."""
        monkeypatch.setattr(type(whole), "needed_odds", lambda *_: odds - share * FAULT_ODDS)
        seeker = GlobalLocalisation(place, Config())
        seeker.begin(moment, reckoned)
        first, step = seeker.look(moment), between_planar(pose, DRIVEN[56])
        seeker.follow(onward := moment_at(then, DRIVEN[56], step, 1))
        return [first, seeker.look(onward)]

    assert found(None, 0.5, DRIVEN[56])[0] is not None
    elsewhere = np.array([-3.0, 0.0, 1.5])
    assert found(elsewhere, 0.5, DRIVEN[56]) == [None, None]
    first, second = found(elsewhere, 2.0, DRIVEN[56])
    assert first is None  # a room that the map lacks may look like this one
    assert second is not None
    assert not second.supported
    assert found(elsewhere, 2.0, DRIVEN[200]) == [None, None]


def test_two_images_agree_by_the_motion_between_them_and_not_by_that_before(
    place: KnownPlace,
) -> None:
    seeker, poses = GlobalLocalisation(place, Config()), DRIVEN[20:61:20]
    moments = [
        moment_at(pose, pose, between_planar(before, pose), k)
        for k, (before, pose) in enumerate(zip([poses[0], *poses], poses, strict=False))
    ]
    for moment in moments[:2]:
        seeker.follow(moment)
    assert seeker.add_match(moments[1], poses[1]) is None
    seeker.follow(moments[2])
    assert seeker.add_match(moments[2], poses[2]) is not None
    assert seeker.add_match(moments[1], poses[1]) is not None  # the way back
    assert seeker.add_match(moments[1], DRIVEN[200]) is None


def test_a_recognition_that_was_none_leaves_the_pose_as_it_was_reckoned(place: KnownPlace) -> None:
    """Given up unconfirmed, the robot is looked for again where motions led it before."""
    pose = DRIVEN[45]
    moment = moment_at(pose, pose, np.zeros(3), 0)
    seeker = GlobalLocalisation(place, Config())
    seeker.begin(moment, pose)
    seeker.begin(moment, None)
    found = seeker.look(moment)
    assert found is not None
    assert found.supported


def moment_at(
    pose: Array, tracked: Array, step: Array, seed: int, *, shaken: bool = False
) -> Moment:
    """What is seen from a pose, while the tracker believes another one."""
    scan = prepare_scan(cast(pose, WALLS, seed), Config().registration)
    return Moment(seed, scan, tracked, step, np.zeros((3, 3)), shaken, motion_lost=False)


def test_a_motion_swings_the_position_by_what_the_heading_errs() -> None:
    """2 m on, then a quarter turn: what lay across lies along the robot."""
    step = np.array([2.0, 0.0, np.pi / 2.0])
    moment = replace(moment_at(np.zeros(3), np.zeros(3), step, 0), covariance=0.01 * np.eye(3))
    pose, covariance = moment.moved(np.array([1.0, 1.0, 0.0]), np.diag([0.0, 0.0, 0.04]))
    assert pose == pytest.approx([3.0, 1.0, np.pi / 2.0])
    assert np.diag(covariance) == pytest.approx([0.04 * 2.0**2 + 0.01, 0.01, 0.05])


def test_a_room_with_four_equal_corners_is_never_recognised() -> None:
    """Every pose has three others that see the same: to claim one would be to guess."""
    around = tour([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)])
    square = known_place_from_grid(grid_of(around[::3], SQUARE), Config())
    found = LaserLocaliser(square, Config()).follow(frames_of(around, SQUARE))
    assert not claims(found).any()


def test_another_building_is_not_believed_for_long(place: KnownPlace) -> None:
    """Its walls may look like some of the map's for a metre; the next ones then contradict."""
    walls = np.array([[0, 0, 9, 0], [9, 0, 9, 5], [9, 5, 4, 5], [4, 5, 4, 2], [4, 2, 0, 2],
                      [0, 2, 0, 0]], np.float64)  # fmt: skip
    path = tour([(1, 1), (7, 1), (7, 4), (5, 4), (5, 1), (1, 1)])
    found = LaserLocaliser(place, Config()).follow(frames_of(path, walls))
    assert np.mean(claims(found)) < 0.1
    assert not claims(found)[-1]


def test_a_room_that_was_seen_from_outside_alone_is_not_believed() -> None:
    """Its walls lie where the map has them, and are other surfaces all the same."""
    corners = np.array([(0, 0), (5, 0), (5, 2), (3.4, 2), (3.4, 4), (1, 4), (1, 3), (0, 3)], float)
    walls = np.hstack([corners, np.roll(corners, -1, axis=0)])
    around = tour([(-1, -1), (6, -1), (6, 3), (4.4, 3), (4.4, 5), (-1, 5), (-1, -1)])
    outside = known_place_from_grid(grid_of(around[::3], walls), Config())
    within = tour([(1, 1), (4, 1), (2, 1), (2, 3)])
    seen = one_scan(within[10], walls, 0)
    found = outside.whole.judge(seen, within[10])
    assert not found.forth.any()
    assert found.log_odds == 0.0
    assert not claims(LaserLocaliser(outside, Config()).follow(frames_of(within, walls))).any()


def test_blind_moments_are_followed_by_odometry_and_then_given_up(place: KnownPlace) -> None:
    frames = list(frames_of(DRIVEN))
    empty = np.zeros((0, 2), np.float32)
    for k in range(120, len(frames)):
        scan = frames[k].scan
        assert scan is not None
        frames[k] = replace(frames[k], scan=replace(scan, points=empty))
    found = LaserLocaliser(place, Config()).follow(frames)
    assert found[119].state != State.LOST
    # A scan that fails while the wheels roll on is no evidence; the pose is not claimed for long.
    assert not claims(found)[-1]


def test_threads_change_nothing(place: KnownPlace) -> None:
    few = DRIVEN[:60]
    one = LaserLocaliser(place, replace(Config(), threads=1)).follow(frames_of(few))
    three = LaserLocaliser(place, replace(Config(), threads=3)).follow(frames_of(few))
    assert [e.map_from_base.tobytes() for e in one] == [e.map_from_base.tobytes() for e in three]
    assert [e.state for e in one] == [e.state for e in three]


def test_a_place_is_found_in_the_whole_map(place: KnownPlace) -> None:
    """From one scan, anywhere and in any heading, beyond chance; in a square in four poses."""
    for k in range(5, len(DRIVEN), 90):
        seen = one_scan(DRIVEN[k], WALLS, k)
        pose = place.whole.find(seen)
        assert pose is not None
        assert np.hypot(*(pose - DRIVEN[k])[:2]) < 0.15
        assert abs(wrap_angle(pose[2] - DRIVEN[k][2])) < 0.05
        assert place.whole.judge(seen, pose).log_odds > place.whole.needed_odds(1)
        assert place.whole.is_elsewhere(seen, pose) is False
        assert place.whole.is_elsewhere(seen, pose + np.array([1.5, 0.5, 2.0])) is True


def test_a_place_that_fits_in_two_poses_lies_in_neither_for_certain() -> None:
    around = tour([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)])
    square = known_place_from_grid(grid_of(around[::3], SQUARE), Config()).whole
    seen = one_scan(around[10], SQUARE, 0)
    assert square.is_elsewhere(seen, around[10]) is None


@pytest.mark.parametrize("resolution", [0.02, 0.07, 0.1, 0.15, 0.2])
def test_nor_does_it_on_a_grid_of_any_resolution(resolution: float) -> None:
    """In a bare hall turned by half a turn, however its walls lie in the cells of the search."""
    hall = known_place_from_grid(hall_of(resolution), Config()).whole
    for k, pose in enumerate(np.array([[2.0, 1.5, 0.0], [7.3, 1.1, 2.0], [5.2, 4.7, -1.8]])):
        seen = one_scan(pose, HALL, k)
        found = hall.find(seen)
        assert found is not None
        assert hall.is_elsewhere(seen, found) is None


def hall_of(resolution: float) -> OccupancyGrid:
    """The hall as a mapper leaves it: free, with the cells that its walls cross."""
    width, height = (int(size / resolution) for size in HALL_SIZE)
    cells = np.full((height + 3, width + 3), 3.0, np.float32)
    cells[2:-2, 2:-2] = -3.0
    cells[[0, -1]] = cells[:, [0, -1]] = np.nan
    return OccupancyGrid(cells, resolution, np.full(2, -resolution - 0.5 * resolution))


def one_scan(pose: NDArray[np.float64], walls: NDArray[np.float64], seed: int) -> Place:
    """What is seen from a pose."""
    scan = prepare_scan(cast(pose, walls, seed), Config().registration)
    points = scan.rows[:, :2].astype(np.float64)
    submap = Submap(points, scan.origin[None], np.array([0, len(points)]))
    return Place.of(submap)


def test_rays_end_at_the_first_occupied_cell() -> None:
    occupied = np.zeros((9, 9), np.bool_)
    occupied[4, 7] = occupied[4, 8] = True
    known = np.ones((9, 9), np.bool_)
    known[:3] = False
    hits = np.zeros((3, 2))
    bearings = np.array([0.0, np.pi / 2, -np.pi / 2])
    assert cast_rays(occupied, known, 1.5, 4.5, bearings, 20.0, hits) == 1
    assert hits[0].tolist() == [7.5, 4.5]
    assert cast_rays(occupied, known, 1.5, 4.5, bearings, 3.0, hits) == 0


def test_an_empty_grid_is_refused() -> None:
    empty = OccupancyGrid(np.full((20, 20), -3.0, np.float32), 0.05, np.zeros(2))
    with pytest.raises(MapError, match="no occupied cell"):
        known_place_from_grid(empty, Config())
