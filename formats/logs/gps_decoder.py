"""ROS messages about where on earth the robot is, as typed values."""

from __future__ import annotations

import math
from typing import Any

from formats.logs.message_fields import field, header_of, matrix_of
from mapmyworld.types import GpsMessage

_NO_FIX = -1
_ERROR = 10.0  # m, where the receiver does not indicate it


def nav_sat_fix(value: Any) -> GpsMessage:
    """Position with its largest standard deviation; NaN where the receiver has no fix."""
    names = ("latitude", "longitude", "altitude")
    latitude, longitude, altitude = (float(field(value, name, math.nan)) for name in names)
    variance = float(matrix_of(value, "position_covariance", 3, 3).diagonal().max())
    is_known = field(value, "position_covariance_type", 0) != 0
    known = is_known and math.isfinite(variance) and variance > 0
    if field(field(value, "status"), "status", 0) == _NO_FIX:
        latitude = longitude = math.nan
    error = math.sqrt(variance) if known else _ERROR
    return GpsMessage(*header_of(value), latitude, longitude, altitude, error)
