"""Times as text logs write them."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation

_MAX_STAMP_S = 1 << 33  # seconds; the year 2242, so that nanoseconds fit 64 bits


def stamp_from_text(text: bytes) -> int:
    """Nanoseconds of decimal seconds, exact; ValueError where it is no time."""
    seconds, _, fraction = text.partition(b".")
    if seconds.isdigit() and (fraction.isdigit() or not fraction):
        stamp = int(seconds) * 1_000_000_000 + int(fraction[:9].ljust(9, b"0"))
    else:
        try:
            stamp = int(Decimal(text.decode("ascii")).scaleb(9))
        except (InvalidOperation, OverflowError, ValueError) as error:
            raise ValueError(f"{text!r} is no time") from error
    if not 0 <= stamp < _MAX_STAMP_S * 1_000_000_000:
        raise ValueError(f"{text!r} is no time")
    return stamp
