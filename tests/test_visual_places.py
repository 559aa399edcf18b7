"""Words, places and closures: references of the kernels, known loops, and doubles of places."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from memory_store import MemoryStore
from numpy.typing import NDArray
from visual_rooms import Room, circle, planar_pose

from mapmyworld.config import Config
from mapmyworld.geometry.rigid import between, se3_exp
from mapmyworld.kernels.image_matching import match_all
from mapmyworld.places.appearance import find_candidates
from mapmyworld.places.visual_closures import find_visual_closures
from mapmyworld.registration.features import extract_features, spread
from mapmyworld.registration.image_pairs import register_images
from mapmyworld.registration.views import make_view
from mapmyworld.types import ConstraintKind, Judged, Node, NodeData, Why
from mapmyworld.types.wording import in_words

Array = NDArray[np.float64]
CONFIG = Config(threads=2)


class Silent:
    """Progress that nobody watches."""

    def stage(self, name: str, total: float | None = None, unit: str = "") -> None: ...

    def update(self, done: float) -> None: ...

    def note(self, message: str) -> None: ...


def random_words(seed: int, count: int) -> NDArray[np.uint64]:
    bits = np.random.default_rng(seed).integers(0, 256, (count, 32)).astype(np.uint8)
    return bits.view(np.uint64)


def hamming(a: NDArray[np.uint64], b: NDArray[np.uint64]) -> NDArray[np.int64]:
    bits_a, bits_b = (np.unpackbits(w.view(np.uint8), axis=1).astype(int) for w in (a, b))
    return np.abs(bits_a[:, None] - bits_b[None]).sum(axis=2)


def test_exhaustive_matching_agrees_with_its_numpy_reference() -> None:
    a, b = random_words(0, 60), random_words(1, 80)
    b[10:40] = a[5:35] ^ np.uint64(0b1011)
    distance = hamming(a, b)
    expected = np.full(60, -1)
    for i, row in enumerate(distance):
        order = np.argsort(row, kind="stable")
        best = order[0]
        mutual = np.argmin(distance[:, best]) == i
        if mutual and row[best] <= 60 and row[best] <= 0.8 * row[order[1]]:
            expected[i] = best
    assert (expected >= 0).sum() == 30
    assert np.array_equal(match_all(a, b, 60, 0.8), expected)


def test_features_are_spread_over_the_image_and_stay_within_the_limit() -> None:
    random = np.random.default_rng(0)
    crowd = random.uniform(0, 40, (900, 2))
    rest = random.uniform(0, [640, 480], (100, 2))
    pixels = np.concatenate([crowd, rest]).astype(np.float32)
    strength = np.concatenate([np.full(900, 10.0), np.ones(100)]).astype(np.float32)
    chosen = spread(pixels, strength, 640, 480, 150)
    assert len(chosen) == 150
    assert (chosen >= 900).sum() > 80  # most of the lonely ones survive the crowd


def make_words(seed: int, places: list[int]) -> list[NDArray[np.int32]]:
    """Images of 80 words, 60 of which belong to the place and 20 to nothing."""
    random = np.random.default_rng(seed)
    return [
        np.concatenate(
            [np.random.default_rng([9, p]).integers(1, 4000, 60), random.integers(1, 4000, 20)]
        ).astype(np.int32)
        for p in places
    ]


@pytest.mark.parametrize("back", [False, True])
def test_a_second_visit_is_proposed_whichever_way_it_is_driven(back: bool) -> None:
    first = list(range(40))
    second = first[10:30][::-1] if back else first[10:30]
    words = make_words(0, [*first, *range(100, 120), *second])
    stamps = np.arange(len(words)) * 2_000_000_000
    found = find_candidates(
        words, 4000, stamps, np.zeros(len(words), int),
        gap_s=5.0, least_similarity=0.02, most=3,
    )  # fmt: skip
    pairs = {(index, other) for index, other, _ in found}
    expected = {(60 + k, place) for k, place in enumerate(second)}
    assert len(expected & pairs) >= 18
    assert all(index > other for index, other in pairs)


def test_places_that_are_never_seen_again_are_never_proposed() -> None:
    words = make_words(1, list(range(60)))
    stamps = np.arange(60) * 2_000_000_000
    found = find_candidates(
        words, 4000, stamps, np.zeros(60, int),
        gap_s=5.0, least_similarity=0.1, most=3,
    )  # fmt: skip
    assert found == []


def test_a_pair_of_images_gives_their_motion_and_its_scatter() -> None:
    room = Room()
    here = planar_pose(3.0, 2.5, 0.3)
    motion = se3_exp(np.array([0.0, 0.0, 0.15, 0.2, -0.1, 0.0]))
    images = [room.image(here), room.image(here @ motion)]
    views = [make_view(extract_features(i, CONFIG), i.camera, CONFIG) for i in images]
    pair = register_images(*views, CONFIG)
    assert pair.registration.verdict.accepted
    error = between(motion, pair.registration.a_from_b)
    assert np.linalg.norm(error[:3, 3]) < 0.03
    guided = register_images(*views, CONFIG, guess=motion)
    assert guided.registration.verdict.accepted


def test_images_of_different_walls_are_refused_with_a_reason() -> None:
    room = Room()
    images = [room.image(planar_pose(3.0, 2.5, yaw)) for yaw in (0.0, np.pi)]
    views = [make_view(extract_features(i, CONFIG), i.camera, CONFIG) for i in images]
    registration = register_images(*views, CONFIG).registration
    assert not registration.verdict.accepted
    assert "needed" in in_words(registration.verdict)


def store_of(room: Room, truth: list[Array], tracked: list[Array], step_s: float) -> MemoryStore:
    store = MemoryStore()
    for i, (true, pose) in enumerate(zip(truth, tracked, strict=True)):
        stamp = int(i * step_s * 1e9)
        node = Node(i + 1, 0, stamp, pose, pose, 0, true)
        store.add_node(node, NodeData(images=(room.image(true, stamp),)))
    return store


def drifting(truth: list[Array], seed: int) -> list[Array]:
    """Wheel odometry with a hundredth of noise a step."""
    random = np.random.default_rng(seed)
    poses = [truth[0]]
    sigmas = np.array([0.0, 0.0, 0.004, 0.005, 0.005, 0.0])
    for a, b in pairwise(truth):
        poses.append(poses[-1] @ between(a, b) @ se3_exp(random.normal(size=6) * sigmas))
    return poses


def translation_errors(constraints: list[Judged], truth: list[Array]) -> list[float]:
    errors = []
    for c in constraints:
        error = between(between(truth[c.from_id - 1], truth[c.to_id - 1]), c.i_from_j)
        errors.append(float(np.linalg.norm(error[:3, 3])))
    return errors


def test_closures_of_a_second_lap_are_found_and_right() -> None:
    truth = circle((3.0, 2.5), 1.0, 56, 1.6)
    store = store_of(Room(), truth, drifting(truth, 0), 1.0)
    constraints = find_visual_closures(store, None, CONFIG, Silent())
    accepted = [c for c in constraints if c.accepted and abs(c.from_id - c.to_id) > 20]
    assert len(accepted) >= 15
    assert max(translation_errors(accepted, truth)) < 0.1
    assert all(c.kind is ConstraintKind.LOOP_CLOSURE for c in accepted)
    assert min(accepted[0].source.similarity, accepted[0].source.matches) > 0
    assert len(store.words()) > 20
    store.add_constraints(constraints)
    assert find_visual_closures(store, None, CONFIG, Silent()) == []


def test_images_of_successive_nodes_are_believed_where_wheels_slip() -> None:
    """Wheels that slip by 8 cm on a way of 10 report what is not so, and images show it."""
    truth = circle((3.0, 2.5), 1.0, 20, 0.5)
    slip = se3_exp([0.0, 0.0, 0.0, 0.08, 0.0, 0.0])
    tracked = [*truth[:10], *(truth[9] @ slip @ between(truth[9], p) for p in truth[10:])]
    found = find_visual_closures(store_of(Room(), truth, tracked, 1.0), None, CONFIG, Silent())
    across = [c for c in found if c.accepted and {c.from_id, c.to_id} == {10, 11}]
    assert len(across) == 1
    assert max(translation_errors(across, truth)) < 0.02


def test_identical_pictures_along_a_wall_close_no_loop() -> None:
    """The pictures repeat every 2 m: whatever fits, fits elsewhere as well."""
    room = Room(size=(16.0, 3.0, 2.5), period=2.0)
    truth = [planar_pose(2 + 0.25 * i, 1.2, np.pi / 2) for i in range(48)]
    truth += [planar_pose(14 - 0.25 * i, 1.25, np.pi / 2) for i in range(48)]
    store = store_of(room, truth, drifting(truth, 1), 0.5)
    constraints = find_visual_closures(store, None, CONFIG, Silent())
    accepted = [c for c in constraints if c.accepted]
    assert len(constraints) > 50
    assert all(error < 0.3 for error in translation_errors(accepted, truth))
    assert any(c.verdicts[-1].why is Why.MOTION_CONTRADICTS for c in constraints)


def test_results_do_not_depend_on_the_number_of_threads() -> None:
    truth = circle((3.0, 2.5), 1.0, 30, 1.3)
    runs = []
    for threads in (1, 3):
        store = store_of(Room(), truth, truth, 1.0)
        found = find_visual_closures(store, None, replace(CONFIG, threads=threads), Silent())
        runs.append([(c.from_id, c.to_id, c.verdicts, c.i_from_j.tobytes()) for c in found])
    assert runs[0] == runs[1]


def neighbours(tracked: list[Array], blind_after: int | None) -> list[Judged]:
    """Steps of a tracker that knows them to millimetres, but for one through the dark."""
    found = []
    for i, (a, b) in enumerate(pairwise(tracked)):
        sigma = 0.5 if i == blind_after else 0.003
        information = np.eye(6) / sigma**2
        found.append(Judged(i + 1, i + 2, ConstraintKind.NEIGHBOUR, between(a, b), information))
    return found


def test_places_are_recognised_again_across_a_stretch_that_says_it_was_blind() -> None:
    truth = circle((3.0, 2.5), 1.0, 40, 1.6)
    turn = se3_exp(np.array([0.0, 0.0, 0.9, 0.2, 0.1, 0.0]))
    tracked = truth[:25] + [truth[25] @ turn @ between(truth[25], pose) for pose in truth[25:]]
    across = []
    for blind_after in (24, None):
        store = store_of(Room(), truth, tracked, 1.0)
        store.add_constraints(neighbours(tracked, blind_after))
        found = find_visual_closures(store, None, CONFIG, Silent())
        across.append([c for c in found if c.accepted and c.from_id <= 25 < c.to_id])
    assert len(across[0]) >= 5
    assert max(translation_errors(across[0], truth)) < 0.1
    assert across[1] == []
