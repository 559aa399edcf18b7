"""Where tracking is lost: no odometry, and scans that fit nothing that was seen before.

A robot that was carried off, or blind for a while, sees nothing that fits. Where odometry goes on
it leads on; without it the motion is as good as unknown.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
UNKNOWN = np.array([25.0, 25.0, 2.25])
"""Variances, 5 m and 1.5 rad, of a motion across a loss."""
_VAGUE = np.array([0.09, 0.09, 0.0225])  # 0.3 m and 0.15 rad: where it may be the view that changed
_FAR = 0.3  # m and rad from the expected pose from which a poor match is not believed
_SOMEWHAT = 0.2  # overlap from which a scan that cannot be placed may still be from where it seems
_AT_ONCE = 1e9  # ns between scans within which nobody carries a robot off
_NAMED = 5  # moments that are named, at most


class TrackingLosses:
    """Remembers where tracking was lost."""

    def __init__(self) -> None:
        self._first_ns: int | None = None
        self._last_ns = 0
        self._doubted_ns: int | None = None
        self._found_ns: list[int] = []

    def go_on(self, stamp_ns: int) -> None:
        """One more scan."""
        self._first_ns = stamp_ns if self._first_ns is None else self._first_ns
        self._last_ns = stamp_ns

    def found(
        self, stamp_ns: int, variances: Array, apart: Array, overlap: float
    ) -> tuple[Array, bool]:
        """The variances, at least those given, of the motion to a scan that cannot be placed.

        (3,) both, in m^2 and rad^2. And whether tracking is lost there. `apart` (3,) is how far
        from the expected pose the best match is, `overlap` how well it fits.
        """
        follows = stamp_ns - self._last_ns <= _AT_ONCE
        if follows and overlap >= _SOMEWHAT and not _is_far(apart):
            before, self._doubted_ns = self._doubted_ns, stamp_ns
            again = before is not None and stamp_ns - before <= _AT_ONCE
            return np.asarray(variances if again else variances + _VAGUE), not again
        self._found_ns.append(stamp_ns)
        return np.maximum(UNKNOWN, variances), True

    def notes(self) -> tuple[str, ...]:
        """One line that says when, if ever."""
        if not self._found_ns:
            return ()
        when = named_moments(self._found_ns, self._first_ns or 0)
        return (f"tracking was lost at {when}: no scan match and no odometry",)


def named_moments(stamps_ns: Sequence[int], start_ns: int) -> str:
    """Seconds since the start, of the first few; the others are counted."""
    moments = [f"{(stamp - start_ns) * 1e-9:.0f} s" for stamp in stamps_ns[:_NAMED]]
    more = len(stamps_ns) - len(moments)
    return ", ".join(moments) + (f" and {more} times more" if more else "")


def _is_far(motion: Array) -> bool:
    return bool(max(np.hypot(*motion[:2]), abs(motion[2])) > _FAR)
