"""The scans since a search began, and the motion between them: what every place must explain."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.planar import compose_planar, invert_planar

Array = NDArray[np.float64]
LogLikelihood = Callable[[Array, Array], Array]
"""Of poses (K, 3), given the points (N, 2) of a scan."""
_REMEMBERED = 200  # scans; the search weighs one every 0.1 m or 0.1 rad


class Past:
    """Scans with the motion that led to each; a lost motion ends what can be remembered."""

    def __init__(self) -> None:
        self._scans: deque[tuple[Array, Array]] = deque(maxlen=_REMEMBERED)

    def forget(self) -> None:
        """Begins anew."""
        self._scans.clear()

    def add(self, step: Array, points: Array) -> None:
        """A scan's points (N, 2) after a motion `step` (3,) since the scan before."""
        self._scans.append((step, points))

    def evidence(self, poses: Array, log_likelihood: LogLikelihood) -> Array:
        """Log-likelihoods (K,) of all scans together if the last was taken at poses (K, 3)."""
        total = np.zeros(len(poses))
        for step, points in reversed(self._scans):
            total += log_likelihood(poses, points)
            poses = compose_planar(poses, invert_planar(step))
        return total
