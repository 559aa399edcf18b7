"""Numbers as ROS messages hold them: in single precision."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def singles(values: ArrayLike) -> NDArray[np.float32]:
    """Values as float32, (...) both; what is too large for one is infinite, like no return."""
    with np.errstate(over="ignore", invalid="ignore"):  # signalling NaN is invalid
        return np.asarray(values, np.float32)


def single(value: Any) -> float:
    """One value, rounded to single precision."""
    return float(singles(value))
