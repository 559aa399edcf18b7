"""Scans made ready again when asked for are those that were made ready at first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, cast

import numpy as np
import pytest
from laser_rooms import WALLS
from laser_rooms import cast as see
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.parallel import in_threads
from mapmyworld.places import stored_scans
from mapmyworld.places.stored_scans import StoredScans
from mapmyworld.registration.scan_matching import ScanSet, prepare_scans
from mapmyworld.types import MapStore, Scan

REGISTRATION = Config().registration


class Shelf:
    """A store of scans, every third frame without one; counts what is read."""

    def __init__(self, count: int) -> None:
        poses = [np.array([-2.0 + 0.1 * k, 0.5, 0.05 * k]) for k in range(count)]
        self.all = {k: see(pose, WALLS, k) for k, pose in enumerate(poses) if k % 3}
        self.read = 0

    def scans(self, frames: Sequence[int] | NDArray[np.int64]) -> Iterator[tuple[int, Scan]]:
        for frame in np.asarray(frames).tolist():
            if frame in self.all:
                self.read += 1
                yield frame, self.all[frame]


@pytest.fixture
def shelf(monkeypatch: pytest.MonkeyPatch) -> Shelf:
    monkeypatch.setattr(stored_scans, "BLOCK", 4)
    monkeypatch.setattr(stored_scans, "_HELD", 2)
    return Shelf(40)


def stored(shelf: Any) -> StoredScans:
    return StoredScans(cast(MapStore, shelf), np.arange(40), REGISTRATION)


def assert_same(found: ScanSet, wanted: ScanSet) -> None:
    assert np.array_equal(found.rows, wanted.rows)
    assert np.array_equal(found.bounds, wanted.bounds)
    assert np.array_equal(found.origins, wanted.origins)


def test_any_scans_in_any_order_are_those_made_ready_at_once(shelf: Shelf) -> None:
    scans, whole = stored(shelf), prepare_scans(list(shelf.all.values()), REGISTRATION)
    assert scans.frames.tolist() == list(shelf.all)
    for which in (np.arange(26), np.array([25, 0, 13, 13, 2]), np.zeros(0, np.int64)):
        assert_same(scans.some(which), whole.some(which))


def test_threads_that_ask_at_once_get_the_same(shelf: Shelf) -> None:
    scans, whole = stored(shelf), prepare_scans(list(shelf.all.values()), REGISTRATION)
    asked = [np.array([k % 26, 25 - k % 26, k * 7 % 26]) for k in range(200)]
    read = shelf.read
    for which, found in zip(asked, in_threads(scans.some, asked, 4), strict=True):
        assert_same(found, whole.some(which))
    assert shelf.read > read, "blocks must have been let go and read again"


def test_what_was_let_go_is_read_again_alike(shelf: Shelf) -> None:
    scans, whole = stored(shelf), prepare_scans(list(shelf.all.values()), REGISTRATION)
    read = shelf.read
    scans.let_go()
    assert_same(scans.some(np.arange(22, 26)), whole.some(np.arange(22, 26)))
    assert shelf.read > read
