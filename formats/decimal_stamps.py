"""Times that are written as decimal seconds."""

from __future__ import annotations

from contextlib import suppress
from decimal import Decimal

_SECOND = 1_000_000_000  # nanoseconds
_LARGEST = 1 << 63  # nanoseconds: 64 bits with a sign


def nanoseconds_from_text(text: str) -> int:
    """Exact, where a float would lose the last digits of a time since 1970; what is finer is cut.

    ValueError where the text is no number, or one that leaves 64 bits.
    """
    with suppress(ArithmeticError, ValueError):
        stamp = Decimal(text) * _SECOND
        if abs(stamp) < _LARGEST:
            return int(stamp)
    raise ValueError(f"{text!r} is no time")


def nanoseconds_from_integer(text: str) -> int:
    """ValueError where the text is no whole number, or one that leaves 64 bits."""
    stamp = int(text)
    if abs(stamp) >= _LARGEST:
        raise ValueError(f"{text!r} is no time")
    return stamp


def seconds_text(stamp_ns: int) -> str:
    """Seconds with nine decimals, exact."""
    return f"{Decimal(stamp_ns).scaleb(-9):.9f}"


_MAX_STAMP_NS = (1 << 33) * 1_000_000_000  # the year 2242


def stamp_from_text(text: bytes) -> int:
    """Nanoseconds of decimal seconds, exact; ValueError where it is no time of a log."""
    stamp = nanoseconds_from_text(text.decode("ascii", "replace"))
    if not 0 <= stamp < _MAX_STAMP_NS:
        raise ValueError(f"{text!r} is no time")
    return stamp
