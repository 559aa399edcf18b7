"""The gravity direction, by the specific force that an accelerometer measures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.types import ImuSample

_LEAST_FORCE = 0.5  # of a mean sample: some devices give it in g, not in m/s^2
_STEADY = 0.9  # share of a force's mean length that its mean vector must have, to be gravity


class GravityDirection:
    """Sums specific force along the path, in one frame: over a drive all but gravity's reaction
    cancels out.
    """

    def __init__(self) -> None:
        self._sum, self._lengths, self._count = np.zeros(3), 0.0, 0

    def add(self, samples: Sequence[ImuSample], map_from_base: Array) -> None:
        """Samples taken near a pose (4, 4)."""
        for sample in samples:
            self._sum += map_from_base[:3, :3] @ sample.linear_acceleration
            self._lengths += float(np.linalg.norm(sample.linear_acceleration))
            self._count += 1

    def mean(self) -> list[float] | None:
        """Three numbers, upwards; None without samples, or where a device took gravity out."""
        if self._lengths < _LEAST_FORCE * self._count or not self._count:
            return None
        if np.linalg.norm(self._sum) < _STEADY * self._lengths:
            return None
        return [float(part) for part in self._sum / self._count]
