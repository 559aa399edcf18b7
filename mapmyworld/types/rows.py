"""Parallel arrays that are chosen from, and laid behind each other, all alike."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Parallel arrays, a row of each for one thing; one that is optional may be None."""

    def chosen(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Self:
        """The rows of a mask (N,) or at positions (K,)."""
        arrays = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(self, **{k: None if a is None else a[which] for k, a in arrays.items()})

    def followed_by(self, *others: Self) -> Self:
        """These rows, then those of the others; of an array that one of them lacks, none."""
        found = {}
        for f in fields(self):
            parts = [getattr(rows, f.name) for rows in (self, *others)]
            found[f.name] = None if any(p is None for p in parts) else np.concatenate(parts)
        return replace(self, **found)


@dataclass(frozen=True, slots=True, eq=False)
class CountedRows(Rows):
    """The same, with a length."""

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))
