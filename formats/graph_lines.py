"""Lines of a graph file by their tag, as tables of numbers; lines without sense are named."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from formats.bounds import LARGEST

_SHOWN = 5  # line numbers or ids in one message
_SMALLEST = 1e-6  # of a quaternion's numbers: if all are smaller it indicates no direction
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
    """The sound rows; the others are named in the order of their lines."""
    numbered, numbers, faults = list[int](), list[list[float]](), dict[int, str]()
    for line, text in rows:
        tokens = text.split()
        if len(tokens) != columns.count:
            faults[line] = f" has {len(tokens)} numbers instead of {columns.count}"
            continue
        try:
            numbers.append([float(token) for token in tokens])
            numbered.append(line)
        except ValueError as error:
            faults[line] = f": {error}"
    values = np.array(numbers, np.float64).reshape(-1, columns.count)
    lines, good = np.array(numbered, np.int64), np.ones(len(values), np.bool_)
    for sound, fault in _needed(values, columns):
        faults |= dict.fromkeys(lines[good & ~sound.all(axis=1)].tolist(), f" holds {fault}")
        good &= sound.all(axis=1)
    problems += [f"line {line}: {tag}{faults[line]}" for line in sorted(faults)]
    return Table(values[good], lines[good])


def _needed(
    values: NDArray[np.float64], columns: Columns
) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """What must be true (R, ...) of all that a row (C,) holds, and what it holds else."""
    yield np.isfinite(values), "a value that is not finite"
    yield np.abs(values) <= LARGEST, f"a value beyond {LARGEST:.0e}"
    ids = values[:, : columns.ids]
    yield (np.rint(ids) == ids) & (np.abs(ids) <= _LARGEST_ID), "an id that is no whole number"
    if columns.quaternion is not None:
        quaternion = np.abs(values[:, columns.quaternion : columns.quaternion + 4])
        yield quaternion.max(axis=1, keepdims=True) > _SMALLEST, "a quaternion that is zero"


def listed(values: NDArray[np.int64] | list[int]) -> str:
    """The first few of these numbers (N,), and how many more there are."""
    shown = ", ".join(str(int(v)) for v in values[:_SHOWN])
    return f"{shown} and {len(values) - _SHOWN} more" if len(values) > _SHOWN else shown
