"""Where tracking is lost: no odometry, and scans that fit nothing that was seen before.

A robot that was carried off, or blind for a while, sees nothing that fits. Where odometry goes on
it leads on; without it the motion is as good as unknown.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

UNKNOWN = np.array([25.0, 25.0, 2.25])
"""Variances, 5 m and 1.5 rad, of a motion across a loss."""
NAMED = 5
"""Moments or sections of one kind that a note names, at most."""


def named_moments(stamps_ns: Sequence[int], start_ns: int) -> str:
    """Seconds since the start, of the first few; the others are counted."""
    moments = [f"{(stamp - start_ns) * 1e-9:.0f} s" for stamp in stamps_ns[:NAMED]]
    more = len(stamps_ns) - len(moments)
    return ", ".join(moments) + (f" and {more} more" if more else "")
