"""GPS fixes as RTAB-Map's blobs, both ways."""

from __future__ import annotations

import numpy as np

from formats.decimal_stamps import nanoseconds_from_text
from mapmyworld.errors import MapError
from mapmyworld.types import GpsMessage

_LATEST_S = 9e9  # a stamp's seconds beyond which nanoseconds leave 64 bits


def nanoseconds(stamp: float | None) -> int:
    """A stamp in float seconds as the decimal number that was meant: microseconds survive.

    Raises `MapError` for one beyond sense.
    """
    seconds = float(stamp or 0.0)
    if not abs(seconds) < _LATEST_S:
        raise MapError(f"a stamp of {seconds} s")
    return nanoseconds_from_text(repr(seconds))


def gps_to_blob(fix: GpsMessage | None) -> bytes | None:
    """48 bytes: stamp, longitude, latitude, altitude, error, bearing (unknown: 0)."""
    if fix is None:
        return None
    numbers = (fix.stamp_ns * 1e-9, fix.longitude, fix.latitude, fix.altitude, fix.error, 0.0)
    return np.array(numbers, "<f8").tobytes()


def blob_to_gps(blob: bytes | None, what: str) -> GpsMessage | None:
    """The fix; None where there is none, which a stamp of 0 says as well.

    Raises `MapError` where it is damaged; `what` names it.
    """
    if not blob:
        return None
    if len(blob) != 48:
        raise MapError(f"{what}: a GPS fix takes 48 bytes, not {len(blob)}")
    stamp, longitude, latitude, altitude, error, _ = np.frombuffer(blob, "<f8").tolist()
    if not stamp > 0:
        return None
    return GpsMessage(nanoseconds(stamp), "", latitude, longitude, altitude, error)
