"""Where tracking breaks: what was seen before no longer says where the robot is.

A robot that was carried off, or blind for a while, sees nothing that fits; or something fits a
little, far from where the odometry leads. Then the motion is as good as unknown. What merely passes
before the laser is none: for a moment the wheels lead on.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.odometry.laser_stretches import leaves_turn_open
from mapmyworld.registration.scan_matching import Match

Array = NDArray[np.float64]
_UNKNOWN = np.array([25.0, 25.0, 2.25])  # variances, 5 m and 1.5 rad, of a motion across a break
_VAGUE = np.array([0.09, 0.09, 0.0225])  # 0.3 m and 0.15 rad: where it may be the view that changed
_WELL = 0.7  # overlap from which a match is believed however far from the odometry it is
_FAR = 0.3  # m and rad from the odometry from which a poorer match is not
_SOMEWHAT = 0.2  # overlap from which a scan that cannot be placed may still be from where it seems
_AT_ONCE = 1e9  # ns between scans within which nobody carries a robot off
_PASSING = (2e9, 1.0)  # ns and m since a scan last fitted, for which something may pass before it
_NAMED = 5  # breaks whose moments are named


class Breaks:
    """Remembers how far the robot went unseen, and where tracking broke."""

    def __init__(self) -> None:
        self._first_ns: int | None = None
        self._last_ns = self._seen_ns = 0
        self._doubted_ns: int | None = None
        self._found_ns: list[int] = []
        self._unseen = np.zeros(2)  # m and rad since a scan last fitted, by the odometry

    @property
    def is_blind(self) -> bool:
        """Whether scans that said nothing came since the last one that was placed."""
        return bool(self._unseen.any())

    def fitted_lately(self, stamp_ns: int) -> bool:
        """Whether what was seen before still says where the robot is.

        Then a scan that fits nothing may be of somebody who soon goes away again.
        """
        longest_ns, farthest = _PASSING
        return stamp_ns - self._seen_ns <= longest_ns and bool(self._unseen[0] <= farthest)

    def go_unseen(self, stamp_ns: int, step: Array) -> None:
        """One more motion (3,) of which the scans say nothing."""
        self._note(stamp_ns)
        self._unseen += np.hypot(step[0], step[1]), abs(step[2])

    def see_again(self, stamp_ns: int) -> None:
        """A scan was placed."""
        self._note(stamp_ns)
        self._seen_ns = stamp_ns
        self._unseen[:] = 0.0

    def since_seen(self, step: Array) -> Array:
        """A motion (3,) together with what came unseen before it: as far and as much turned."""
        metres, turned = self._unseen
        return np.array([np.hypot(step[0], step[1]) + metres, 0.0, abs(step[2]) + turned])

    def found(
        self, stamp_ns: int, variances: Array, apart: Array, overlap: float
    ) -> tuple[Array, bool]:
        """The variances (3,), at least those given, of the motion to a scan that cannot be placed.

        And whether tracking breaks there. `apart` (3,) is how far from the odometry the best match
        is, `overlap` how well it fits.
        """
        follows = stamp_ns - self._last_ns <= _AT_ONCE
        if follows and overlap >= _SOMEWHAT and not _is_far(apart):
            before, self._doubted_ns = self._doubted_ns, stamp_ns
            again = before is not None and stamp_ns - before <= _AT_ONCE
            return np.asarray(variances if again else variances + _VAGUE), not again
        self._found_ns.append(stamp_ns)
        return variances if self.is_blind else np.maximum(_UNKNOWN, variances), True

    def _note(self, stamp_ns: int) -> None:
        self._first_ns = stamp_ns if self._first_ns is None else self._first_ns
        self._last_ns = stamp_ns

    def notes(self) -> tuple[str, ...]:
        """One line that says when, if ever."""
        if not self._found_ns:
            return ()
        zero = self._first_ns or 0
        moments = [f"{(stamp - zero) * 1e-9:.0f} s" for stamp in self._found_ns[:_NAMED]]
        more = len(self._found_ns) - len(moments)
        when = ", ".join(moments) + (f" and {more} times more" if more else "")
        return (
            f"tracking broke at {when}: what the laser saw fits nothing seen right before; "
            "how the path goes on there rests on places recognised later",
        )


def is_doubtful(match: Match, predicted_from_match: Array) -> bool:
    """Whether a match contradicts the odometry and is not to be believed for all that.

    It fits too little to be so far from where the robot was expected, or is of a mere circle.
    """
    astray = match.overlap < _WELL and _is_far(predicted_from_match)
    return astray or leaves_turn_open(match.information)


def _is_far(motion: Array) -> bool:
    return bool(max(np.hypot(*motion[:2]), abs(motion[2])) > _FAR)
