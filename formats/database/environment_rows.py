"""GPS fixes and readings of the environment as RTAB-Map's blobs, both ways."""

from __future__ import annotations

import numpy as np

from formats.decimal_stamps import nanoseconds_from_text
from mapmyworld.errors import MapError
from mapmyworld.types import GpsMessage, Quantity, ReadingMessage

# RTAB-Map's numbers of sensors; those from 100 on are a user's own and not read.
_NUMBERS = {
    Quantity.WIFI: 1,
    Quantity.TEMPERATURE: 2,
    Quantity.PRESSURE: 3,
    Quantity.LIGHT: 4,
    Quantity.HUMIDITY: 5,
}
_QUANTITIES = {number: quantity for quantity, number in _NUMBERS.items()}
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


def readings_to_blob(readings: tuple[ReadingMessage, ...]) -> bytes | None:
    """Rows of sensor number, value, stamp."""
    rows = [(_NUMBERS[r.quantity], r.value, r.stamp_ns * 1e-9) for r in readings]
    return np.array(rows, "<f8").tobytes() if rows else None


def blob_to_readings(blob: bytes | None, what: str) -> tuple[ReadingMessage, ...]:
    """The readings of known sensors.

    Raises `MapError` where they are damaged; `what` names them.
    """
    if not blob:
        return ()
    if len(blob) % 24:
        raise MapError(f"{what}: readings take 24 bytes each, not {len(blob)} in all")
    rows = np.frombuffer(blob, "<f8").reshape(-1, 3).tolist()
    return tuple(
        ReadingMessage(nanoseconds(stamp), "", _QUANTITIES[number], value)
        for number, value, stamp in rows
        if number in _QUANTITIES
    )
