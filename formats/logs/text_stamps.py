"""Times as text logs write them."""

from __future__ import annotations

from formats.decimal_stamps import nanoseconds_from_text

_MAX_STAMP_NS = (1 << 33) * 1_000_000_000  # the year 2242


def stamp_from_text(text: bytes) -> int:
    """Nanoseconds of decimal seconds, exact; ValueError where it is no time of a log."""
    stamp = nanoseconds_from_text(text.decode("ascii", "replace"))
    if not 0 <= stamp < _MAX_STAMP_NS:
        raise ValueError(f"{text!r} is no time")
    return stamp
