"""Scans made ready for the filter, by the same kernel as for all other scan matching."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import ParticlesConfig, RegistrationConfig
from mapmyworld.particles.kernels.surface_tiles import Beams
from mapmyworld.registration.scan_matching import prepare_scan
from mapmyworld.types import Scan

_LONE = 0.25  # m to the nearer neighbour in the sweep from which an end point stands alone


def beams_from_scan(scan: Scan, settings: ParticlesConfig) -> Beams:
    """About `beams` end points nearer than `range_max`, evenly spaced, with normals.

    Lone ones without a normal are left out: where beams graze a wall they would hold on to it
    as if it had marks, and keep the robot from moving along.
    """
    config = RegistrationConfig(
        point_spacing=settings.beam_spacing,
        point_count=settings.beams,
        range_max=settings.range_max,
    )
    prepared = prepare_scan(scan, config)
    rows = prepared.rows.astype(np.float64)
    points, normals = rows[:, :2], rows[:, 2:4]
    keep = normals.any(axis=1) | (_nearer_gap(points) < _LONE)
    return Beams(
        np.ascontiguousarray(points[keep]), np.ascontiguousarray(normals[keep]), prepared.origin
    )


def _nearer_gap(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Metres (N,) to the nearer of the neighbours before and after."""
    gaps = np.hypot(*np.diff(points, axis=0).T)
    return np.asarray(np.minimum(np.append(gaps, np.inf), np.insert(gaps, 0, np.inf)))
