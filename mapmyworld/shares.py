"""Shares as words: what was measured never rounds up to the limit that it misses."""

from __future__ import annotations

import math


def percent_below(share: float, limit: float) -> tuple[str, str]:
    """Both in percent, the share rounded down: 69% where 0.6996 misses 0.7, not 70%."""
    return f"{math.floor(100 * share)}%", f"{100 * limit:g}%"
