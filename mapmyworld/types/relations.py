"""Known relative poses between moments of a log: the reference of Kuemmerle's metric."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Relations:
    """Parallel arrays, one row a relation; the second moment may precede the first."""

    stamps_ns: NDArray[np.int64]
    """(N, 2)."""
    first_from_second: NDArray[np.float64]
    """(N, 4, 4): pose of the robot at the second stamp in its frame at the first."""
