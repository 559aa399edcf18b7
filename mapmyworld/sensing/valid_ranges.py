"""Which of a sweep's ranges are measurements."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.types import LaserScanMessage


def valid_ranges(scan: LaserScanMessage) -> NDArray[np.bool_]:
    """(N,) which beams came back from something: finite, above the minimum, below the maximum."""
    ranges = scan.ranges
    with np.errstate(invalid="ignore"):
        return np.asarray(
            np.isfinite(ranges)
            & (ranges > max(0.0, scan.range_min))  # 0 where the limit is NaN
            & (ranges < (scan.range_max if scan.range_max > 0 else np.inf))
        )
