"""Docstrings give shapes of all arrays, and those of what raises name the error."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from conftest import ROOT

sys.path.insert(0, str(ROOT / "docs"))
import docstrings

ERRORS = "class MapError(Exception): ...\n"
VALUES = '''
from typing import Protocol
from numpy.typing import NDArray
Array = NDArray[float]

class Store(Protocol):
    def poses(self) -> Array:
        """(N, 3) of nodes."""

class Scan:
    """What was seen."""
    points: Array
    """(N, 2) metres."""
    origin: Array
    """Of the lidar."""
    _hidden: Array

    def poses(self) -> Array:
        return self.points

    def first(self) -> Array:
        return self.points
'''
FUNCTIONS = '''
from mapmyworld.errors import MapError
from mapmyworld.values import Array

def shaped(points: Array) -> None:
    """Of points (..., N, 3 or 4)."""

def first(points: Array) -> tuple[Array, int]:
    """The first two of points (N, 3)."""

def split(points: Array) -> tuple[Array, Array]:
    """Those of points (N, 3) on the left and on the right, (K, 3) both."""

def paired(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Distances of `a`, `b`, `c` and `d` (N, 3), in the same shape."""

def unpaired(a: Array, b: Array) -> None:
    """Distances (N,) of a and b."""

def pieces(a: Array, b: Array, c: Array | None = None) -> list[Array]:
    """What is in all of them, (..., 2) each."""

def named(points: Array) -> None:
    """Of points (Thrun, Burgard) in (0, 1]."""

def warned() -> None:
    """Raises `MapError` every time."""
    raise MapError("no")

def silent(points: list[float]) -> None:
    """Fails every time."""
    raise MapError("no")

@group.command
def run(points: list[float]) -> None:
    """The text of a command is its help."""
    raise MapError("no")

def _inner(points: Array) -> None: ...
'''


def test_every_array_has_a_shape_and_every_error_is_named() -> None:
    *lacking, shapes, errors = docstrings.report()
    assert lacking == []
    assert int(shapes.split()[2]) > 800  # or the script has stopped seeing them
    assert int(errors.split()[2]) > 100


def test_what_is_lacking_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mapmyworld").mkdir()
    for name, text in (("errors", ERRORS), ("values", VALUES), ("functions", FUNCTIONS)):
        (tmp_path / "mapmyworld" / f"{name}.py").write_text(text, encoding="utf-8")
    monkeypatch.setattr(docstrings, "ROOT", tmp_path)
    found = [line.partition(": ")[2] for line in docstrings.report()]
    assert found[:6] == [
        "first gives too few shapes for points, result",
        "unpaired gives too few shapes for a, b",
        "named gives too few shapes for points",
        "Scan.origin gives too few shapes for origin",
        "Scan.first gives too few shapes for result",
        "",
    ]
    assert found[6:] == ["silent gives too few errors for MapError", ""]
