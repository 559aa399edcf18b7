"""Freed memory goes back to the system, and garbage is searched for when it should be."""

from __future__ import annotations

import ctypes
import gc
import sys
from pathlib import Path

import pytest

from mapmyworld import heap
from mapmyworld.heap import give_back, no_search_for_garbage


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux how much memory is held")
def test_what_was_freed_is_given_back() -> None:
    """Small blocks under one that stays: the heap cannot shrink by itself."""
    blocks = [bytes(1000) for _ in range(40_000)]
    kept = blocks[-1]
    full = resident_mb()
    del blocks
    give_back()
    assert resident_mb() < full - 20.0
    assert len(kept) == 1000


def test_a_c_library_without_trim_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    heap._trimmer.cache_clear()
    monkeypatch.setattr(ctypes, "CDLL", lambda _: object())
    give_back()
    assert heap._trimmer() is None
    heap._trimmer.cache_clear()


def test_garbage_is_looked_for_again() -> None:
    with no_search_for_garbage(spare=True):
        assert not gc.isenabled()
    assert gc.isenabled()
    spared = gc.get_freeze_count()
    assert spared > 0
    with no_search_for_garbage(spare=True):
        pass
    assert gc.get_freeze_count() <= spared  # what came since may be garbage
    gc.unfreeze()


def test_a_search_that_was_off_stays_off() -> None:
    gc.disable()
    try:
        with no_search_for_garbage():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()
