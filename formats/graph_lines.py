"""Lines of a graph file by their tag, as tables of numbers; lines without sense are named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from formats.bounds import LARGEST

_SHOWN = 5  # line numbers or ids in one message
_SHORTEST = 1e-12  # square of a quaternion's length, below which it indicates no direction
_LARGEST_ID = 2.0**53  # above it not every whole number is one of double precision


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """All sound lines of one tag."""

    numbers: NDArray[np.float64]
    """(R, C) without the tag, R lines of C numbers."""
    lines: NDArray[np.int64]
    """(R,) line numbers in the file, from 1."""


@dataclass(frozen=True, slots=True)
class Columns:
    """What stands behind a tag: so many numbers, the first of them ids."""

    count: int
    ids: int
    quaternion: int | None = None
    """Where a quaternion's four numbers begin."""


def tables_from_text(
    text: str, columns: Mapping[str, Columns]
) -> tuple[dict[str, Table], dict[str, list[tuple[int, str]]], list[str]]:
    """Tables of the tags whose `columns` are known, other lines by tag, and problems."""
    found: dict[str, list[tuple[int, str]]] = {}
    for number, line in enumerate(text.removeprefix("\ufeff").splitlines(), 1):
        tag, *rest = line.split(None, 1) or [""]
        if tag and not tag.startswith("#"):
            found.setdefault(tag, []).append((number, rest[0] if rest else ""))
    problems: list[str] = []
    tables = {
        tag: _table(tag, rows, columns[tag], problems)
        for tag, rows in found.items()
        if tag in columns
    }
    return tables, {tag: rows for tag, rows in found.items() if tag not in columns}, problems


def _table(tag: str, rows: list[tuple[int, str]], columns: Columns, problems: list[str]) -> Table:
    """All rows at once; one by one only when something is wrong with any."""
    width, texts = columns.count, [text for _, text in rows]
    try:
        values = np.loadtxt(texts if any(texts) else ["?"], comments=None, ndmin=2)
        if values.shape == (len(rows), width) and not _fault(values, columns):
            return Table(values, np.array([line for line, _ in rows], np.int64))
    except ValueError:  # what is no number, or another number of them
        pass
    good = [
        (line, read)
        for line, row in rows
        if (read := _row(tag, line, row, columns, problems)) is not None
    ]
    numbers = np.array([read for _, read in good], np.float64).reshape(-1, width)
    return Table(numbers, np.array([line for line, _ in good], np.int64))


def _row(
    tag: str, line: int, row: str, columns: Columns, problems: list[str]
) -> NDArray[np.float64] | None:
    tokens = row.split()
    if len(tokens) != columns.count:
        problems.append(f"line {line}: {tag} has {len(tokens)} numbers instead of {columns.count}")
        return None
    try:
        values = np.array(tokens, np.float64)
    except ValueError as error:
        problems.append(f"line {line}: {tag}: {error}")
        return None
    if fault := _fault(values, columns):
        problems.append(f"line {line}: {tag} holds {fault}")
        return None
    return values


def _fault(values: NDArray[np.float64], columns: Columns) -> str:
    """What is wrong with some of the numbers (..., columns); empty where nothing is."""
    # Counting takes numpy a fraction of asking for all or any of few numbers.
    if np.count_nonzero(np.abs(values) <= LARGEST) < values.size:  # nor is what is no number
        if np.isfinite(values).all():
            return f"a value beyond {LARGEST:.0e}"
        return "a value that is not finite"
    ids = values[..., : columns.ids]
    if np.count_nonzero((np.rint(ids) == ids) & (np.abs(ids) <= _LARGEST_ID)) < ids.size:
        return "an id that is no whole number"
    if columns.quaternion is not None:
        quaternion = values[..., columns.quaternion : columns.quaternion + 4]
        if np.count_nonzero(np.add.reduce(quaternion * quaternion, axis=-1) < _SHORTEST):
            return "a quaternion that is zero"
    return ""


def listed(values: NDArray[np.int64] | list[int]) -> str:
    """The first few of these numbers (N,), and how many more there are."""
    shown = ", ".join(str(int(v)) for v in values[:_SHOWN])
    return f"{shown} and {len(values) - _SHOWN} more" if len(values) > _SHOWN else shown
