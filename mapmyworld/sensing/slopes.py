"""Slopes, as an accelerometer feels them: how far gravity leans from where it mostly points."""

from __future__ import annotations

from array import array

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.types import ImuMessage

_SPACING_NS = 100_000_000  # between samples that are looked at: a drive may last for hours
_WINDOW_S = 3.0  # over which samples are averaged: longer than starting and braking take
_LEAST_SAMPLES = 10  # of a window
_TRUE_FORCE = (0.8, 1.2)  # of its usual length, for a window's force to be gravity's alone


class Forces:
    """Specific force, every tenth of a second; 32 bytes a sample."""

    def __init__(self) -> None:
        self._stamps, self._values = array("q"), array("d")

    def wants(self, stamp_ns: int) -> bool:
        """Whether it is time for another sample; also where stamps step back."""
        return not self._stamps or abs(stamp_ns - self._stamps[-1]) >= _SPACING_NS

    def add(self, message: ImuMessage, stamp_ns: int) -> None:
        """One more sample, in the sensor's own frame."""
        if np.isfinite(message.linear_acceleration).all():
            self._stamps.append(stamp_ns)
            self._values.extend(message.linear_acceleration.tolist())

    def slope(self) -> float:
        """Radians by which the steepest window leans from the usual up; 0 where it is unknown."""
        windows = _means(np.array(self._stamps), np.array(self._values).reshape(-1, 3))
        lengths = np.hypot.reduce(windows, axis=1)  # squares of damaged values overflow
        usual = float(np.median(lengths)) if len(lengths) else 0.0
        low, high = (share * usual for share in _TRUE_FORCE)
        kept = (lengths > low) & (lengths < high)
        if not kept.any():
            return 0.0
        directions = windows[kept] / lengths[kept, None]
        up = np.median(directions, axis=0)
        cosines = directions @ (up / np.linalg.norm(up))
        return float(np.arccos(np.clip(cosines.min(), -1.0, 1.0)))


def _means(stamps_ns: np.ndarray, forces: Array) -> Array:
    """Mean force (K, 3) of every window with enough samples."""
    if len(stamps_ns) == 0:
        return np.zeros((0, 3))
    number = ((stamps_ns - stamps_ns[0]) * 1e-9 // _WINDOW_S).astype(np.int64)
    _, window = np.unique(number, return_inverse=True)
    counts = np.bincount(window)
    sums = np.stack([np.bincount(window, forces[:, axis]) for axis in range(3)], axis=1)
    enough = counts >= _LEAST_SAMPLES
    return np.asarray(sums[enough] / counts[enough, None])
