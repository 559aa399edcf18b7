"""Degeneracy: sections of the path whose scans constrain one direction poorly, as corridors do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.laser_motion import FAINT
from mapmyworld.odometry.tracking_losses import NAMED

_LEAST = 1.0  # m of path: less is no section, and no end of one
_TURN = 0.05  # rad of uncertainty from which a heading counts as unknown


@dataclass(slots=True)
class _Section:
    start_ns: int
    end_ns: int
    length: float
    good: float = 0.0


class DegenerateSections:
    """Gathers frames that are poorly constrained into sections."""

    def __init__(self) -> None:
        self._open: _Section | None = None
        self._done: list[_Section] = []
        self._first_ns: int | None = None

    def add(self, stamp_ns: int, moved: float, *, weak: bool) -> None:
        """One frame: how far the robot moved, and whether the match is degenerate."""
        self._first_ns = stamp_ns if self._first_ns is None else self._first_ns
        if weak:
            if self._open is None:
                self._open = _Section(stamp_ns, stamp_ns, 0.0)
            self._open.end_ns, self._open.good = stamp_ns, 0.0
            self._open.length += moved
        elif self._open is not None:
            self._open.good += moved
            if self._open.good > _LEAST:
                self._close()

    def _close(self) -> None:
        if self._open is not None and self._open.length >= _LEAST:
            self._done.append(self._open)
        self._open = None

    def notes(self) -> tuple[str, ...]:
        """One line a section, the longest few."""
        self._close()
        zero = self._first_ns or 0
        longest = sorted(self._done, key=lambda s: -s.length)[:NAMED]
        return tuple(
            f"degenerate from {(s.start_ns - zero) * 1e-9:.0f} s to "
            f"{(s.end_ns - zero) * 1e-9:.0f} s ({s.length:.1f} m, corridor): position along it "
            "relies on odometry"
            for s in sorted(longest, key=lambda s: s.start_ns)
        )


def has_open_heading(information: NDArray[np.float64]) -> bool:
    """Whether a match (3, 3) hardly knows the heading, as where all that is seen is a circle."""
    known = information + FAINT * np.eye(3)
    return bool(np.linalg.inv(known)[2, 2] > _TURN**2)
