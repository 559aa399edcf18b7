"""Points of the local map, seen again and again."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.odometry.local_map import LocalMap
from mapmyworld.registration.views import View
from mapmyworld.types import CameraModel, Features

SIGMA = 0.01  # 1/m


def straight_ahead(depth: float) -> View:
    """A view of one feature in the middle of the image, so far away; NaN without depth."""
    return View(
        cast(CameraModel, None), cast(Features, None), np.zeros((1, 2), np.float32),
        np.array([[0.0, 0.0, 1.0 / depth]]), np.array([[0.002, SIGMA, 0.06]]),
        np.zeros((1, 4), np.uint64), np.zeros(2, np.int32), np.zeros(1, np.int32), 1,
    )  # fmt: skip


def seen_from_one_place(depths: list[float]) -> LocalMap:
    local_map = LocalMap(Config())
    point: NDArray[np.int64] = np.array([-1])
    for depth in depths:
        point = local_map.add_keyframe(np.eye(4), straight_ahead(depth), point).point_of
    return local_map


def test_a_point_lies_at_the_mean_of_its_sightings_weighed_by_how_well_each_knows_the_depth() -> (
    None
):
    """A depth errs by depth^2 times the error of its inverse."""
    depths = np.array([2.0, 2.2, 4.0])
    weights = 1.0 / depths**4
    expected = float(weights @ depths / weights.sum())
    assert seen_from_one_place(depths.tolist()).points[0, 2] == pytest.approx(expected)


def test_a_sighting_without_depth_moves_no_point() -> None:
    assert seen_from_one_place([2.0, np.nan, 2.0]).points[0, 2] == pytest.approx(2.0)


def test_a_feature_without_depth_makes_no_point() -> None:
    assert len(seen_from_one_place([np.nan]).near(np.eye(4))) == 0
