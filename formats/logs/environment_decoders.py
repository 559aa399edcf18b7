"""ROS messages about where on earth the robot is and what the air is like, as typed values."""

from __future__ import annotations

import math
from collections.abc import Callable

from formats.logs.channels import Payload
from formats.logs.wire import Wire
from mapmyworld.types import GpsMessage, Quantity, ReadingMessage

_NO_FIX = 255  # status -1 as an unsigned byte
_ERROR = 10.0  # m, where the receiver does not indicate it


def nav_sat_fix(wire: Wire, data: Payload) -> GpsMessage:
    """Position with its largest standard deviation; NaN where the receiver has no fix."""
    stamp, frame, position = wire.header(data, wire.start)
    fixed = data[position] != _NO_FIX
    # The status byte is followed by a 16-bit field, aligned in CDR.
    position = wire.align(position + 1, 2) + 2
    values, position = wire.array(data, position, "f8", 12)
    latitude, longitude, altitude, *covariance = (float(value) for value in values)
    variance = max(covariance[0], covariance[4], covariance[8])
    known = data[position] != 0 and math.isfinite(variance) and variance > 0
    error = math.sqrt(variance) if known else _ERROR
    if not fixed:
        latitude = longitude = math.nan
    return GpsMessage(stamp, frame, latitude, longitude, altitude, error)


def reading_decoder(quantity: Quantity, scale: float) -> Callable[[Wire, Payload], ReadingMessage]:
    """The decoder of a message of a value and its variance, in the quantity's unit."""

    def decode(wire: Wire, data: Payload) -> ReadingMessage:
        stamp, frame, position = wire.header(data, wire.start)
        values, _ = wire.array(data, position, "f8", 1)
        return ReadingMessage(stamp, frame, quantity, float(values[0]) * scale)

    return decode
