"""The summary of a list of errors, by the same definitions as evo's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """In the unit of the errors."""

    count: int
    rmse: float
    mean: float
    median: float
    std: float
    """Of the population (divided by the count)."""
    minimum: float
    maximum: float


def summarise(errors: ArrayLike) -> ErrorStatistics:
    """Statistics of errors (N,), at least one."""
    e = np.asarray(errors, np.float64)
    return ErrorStatistics(
        count=len(e),
        rmse=float(np.sqrt(np.mean(e**2))),
        mean=float(e.mean()),
        median=float(np.median(e)),
        std=float(e.std()),
        minimum=float(e.min()),
        maximum=float(e.max()),
    )
