"""Freed memory goes back to the system, and garbage is searched for when it should be."""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path

import pytest

from mapmyworld import heap
from mapmyworld.heap import give_back


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
