"""Lines of a graph file by their tag, as tables of numbers; lines without sense are named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """All sound lines of one tag."""

    numbers: NDArray[np.float64]
    """(R, columns) without the tag."""
    lines: NDArray[np.int64]
    """(R,) line numbers in the file, from 1."""


def tables_from_text(
    text: str, columns: Mapping[str, int]
) -> tuple[dict[str, Table], dict[str, list[tuple[int, str]]], list[str]]:
    """Tables of the tags with a fixed number of `columns`, other lines by tag, and problems."""
    texts: dict[str, list[str]] = {}
    numbers: dict[str, list[int]] = {}
    for number, line in enumerate(text.splitlines(), 1):
        tag, _, rest = line.strip().partition(" ")
        if not tag or tag.startswith("#"):
            continue
        if tag in texts:
            texts[tag].append(rest)
            numbers[tag].append(number)
        else:
            texts[tag], numbers[tag] = [rest], [number]
    problems: list[str] = []
    tables = {
        tag: _table(tag, texts[tag], numbers[tag], columns[tag], problems)
        for tag in texts
        if tag in columns
    }
    others = {
        tag: list(zip(numbers[tag], texts[tag], strict=True)) for tag in texts if tag not in columns
    }
    return tables, others, problems


def _table(tag: str, rows: list[str], lines: list[int], width: int, problems: list[str]) -> Table:
    """All rows at once; one by one only when something is wrong with any."""
    tokens = " ".join(rows).split()
    if len(tokens) == width * len(rows):
        try:
            values = np.array(tokens, dtype=np.float64).reshape(-1, width)
        except ValueError:
            pass
        else:
            if np.isfinite(values).all():
                return Table(values, np.array(lines, np.int64))
    good = [
        (line, read)
        for line, row in zip(lines, rows, strict=True)
        if (read := _row(tag, line, row, width, problems)) is not None
    ]
    numbers = np.array([read for _, read in good], np.float64).reshape(-1, width)
    return Table(numbers, np.array([line for line, _ in good], np.int64))


def _row(tag: str, line: int, row: str, width: int, problems: list[str]) -> list[float] | None:
    tokens = row.split()
    if len(tokens) != width:
        problems.append(f"line {line}: {tag} has {len(tokens)} numbers instead of {width}")
        return None
    try:
        values = [float(token) for token in tokens]
    except ValueError as error:
        problems.append(f"line {line}: {tag}: {error}")
        return None
    if not np.isfinite(values).all():
        problems.append(f"line {line}: {tag} holds a value that is not finite")
        return None
    return values
