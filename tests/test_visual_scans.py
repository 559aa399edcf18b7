"""Closures by images aligned by the laser scans of both nodes."""

from __future__ import annotations

import numpy as np
import pytest
from laser_rooms import WALLS, cast
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import matrix_to_planar, planar_to_matrix
from mapmyworld.geometry.rigid import between, se3_exp
from mapmyworld.places.scan_check import refine_by_scans
from mapmyworld.registration.image_pairs import ImagePair
from mapmyworld.types import Judge, Registration, Scan, Verdict, Why
from mapmyworld.types.wording import in_words

Array = NDArray[np.float64]


def pair_with(a_from_b: Array, sigma: float) -> ImagePair:
    """A closure by images, certain to `sigma` metres and as many radians."""
    information = np.eye(6) / sigma**2
    numbers = {"inliers": 60, "sigmas": 3.0}
    agreed = Verdict(Judge.CAMERA, True, Why.IMAGES_AGREE, numbers)
    found = Registration(a_from_b, information, agreed, 60, 0.7, 0.5)
    none = np.zeros(0, np.int64)
    return ImagePair(found, none, none, np.zeros(0, np.bool_), True, 20, sigma, sigma)


def nodes(seed: int) -> tuple[Array, Array]:
    """Two planar poses in the left room that look alike enough to see the same walls."""
    random = np.random.default_rng(seed)
    first, second = random.uniform([-3, -2, -0.3], [-1, 2, 0.3], (2, 3))
    return first, second


@pytest.mark.parametrize("seed", range(6))
def test_scans_make_a_closure_more_exact_and_more_certain(seed: int) -> None:
    a, b = nodes(seed)
    truth = between(planar_to_matrix(a), planar_to_matrix(b))
    error = np.random.default_rng(seed + 50).normal(0.0, 0.03, 6) * [0.1, 0.1, 1, 1, 1, 0.1]
    pair = pair_with(truth @ se3_exp(error), 0.03)
    found = refine_by_scans(
        pair, cast(a, WALLS, seed), cast(b, WALLS, seed + 9), Config()
    ).registration
    miss = np.abs(matrix_to_planar(between(truth, found.a_from_b)))
    assert found.converged
    assert (miss < [0.01, 0.01, 0.005]).all()
    assert "refined by scan matching" in in_words(found.verdict)
    assert (np.linalg.eigvalsh(found.information - pair.registration.information) > -1e-3).all()
    # Height, roll and pitch are none of a laser's business.
    before, after = pair.registration.a_from_b, found.a_from_b
    assert after[2, 3] == pytest.approx(before[2, 3], abs=1e-9)


def test_scans_that_contradict_the_images_make_it_no_closure() -> None:
    """Ten centimetres off, at a centimetre of stated uncertainty."""
    a, b = nodes(3)
    wrong = between(planar_to_matrix(a), planar_to_matrix(b)) @ se3_exp([0, 0, 0, 0.1, 0.05, 0])
    found = refine_by_scans(pair_with(wrong, 0.01), cast(a, WALLS, 1), cast(b, WALLS, 2), Config())
    assert not found.registration.converged
    assert "contradict" in in_words(found.registration.verdict)


def test_scans_that_see_other_walls_leave_a_closure_alone() -> None:
    a, b = nodes(4)
    elsewhere = Scan(
        np.random.default_rng(0).uniform(5, 9, (300, 2)).astype(np.float32), np.zeros(3),
        np.zeros(0, np.float32), 30.0, 0.01,
    )  # fmt: skip
    pair = pair_with(between(planar_to_matrix(a), planar_to_matrix(b)), 0.02)
    assert refine_by_scans(pair, cast(a, WALLS, 1), elsewhere, Config()) is pair
