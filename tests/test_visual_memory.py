"""Memory that images leave behind goes back to the system."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest

from cli import memory


def test_free_memory_between_what_is_still_held_goes_back() -> None:
    """Blocks too small to be mapped by themselves, every other one freed."""
    blocks = [np.ones(10_000) for _ in range(800)]  # 64 MB
    del blocks[::2]
    before = memory.resident_mb()
    memory.give_back_memory()
    assert memory.resident_mb() < before - 15.0
    assert len(blocks) == 400


def test_a_c_library_without_trim_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    memory._trim.cache_clear()
    monkeypatch.setattr(ctypes, "CDLL", lambda _: object())
    memory.give_back_memory()
    assert memory._trim() is None
    memory._trim.cache_clear()
