"""Degeneracy: sections of the path whose scans constrain one direction poorly, as corridors do."""

from __future__ import annotations

from dataclasses import dataclass

from mapmyworld.odometry.tracking_losses import NAMED

_LEAST = 1.0  # m of path: less is no section, and no end of one


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
