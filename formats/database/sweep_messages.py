"""A stored scan turned back into the message that a laser would have sent."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.planar import invert_planar, transform_points_planar
from mapmyworld.types import LaserScanMessage, Scan

# Bearings that stray further from the lattice of beams than this share of a step were moved by
# motion correction: they get a lattice as many times finer, so as not to be moved back.
_ON_LATTICE = 1e-3
_FINER = 16
_MAX_BEAMS = 1 << 20


def message_from_scan(scan: Scan, stamp_ns: int, frame_id: str) -> LaserScanMessage:
    """A sweep about `scan.origin`, taken at once: returns as ranges, missing beams as inf."""
    points = transform_points_planar(invert_planar(scan.origin), scan.points)
    points = points[np.isfinite(points).all(axis=1)]  # a damaged map may hold anything
    bearings = np.arctan2(points[:, 1], points[:, 0])
    missing = np.asarray(scan.missing, np.float64) - scan.origin[2]
    missing = missing[np.isfinite(missing)]
    missing = np.mod(missing + math.pi, 2 * math.pi) - math.pi
    both = np.concatenate([bearings, missing])
    first, step = _lattice(both, scan.angle_increment)
    slots = np.rint((both - first) / step).astype(np.int64)
    limit = scan.range_max if math.isfinite(scan.range_max) else 0.0
    lengths = np.hypot(points[:, 0], points[:, 1]).astype(np.float32)
    if limit > 0:  # a return at the limit itself would read as none
        lengths = np.minimum(lengths, np.nextafter(np.float32(limit), np.float32(0)))
    ranges = np.full(int(slots.max(initial=-1)) + 1, np.nan, np.float32)
    ranges[slots[len(points) :]] = np.inf
    # Of two returns in one beam the nearer hides the farther.
    order = np.argsort(-lengths, kind="stable")
    ranges[slots[: len(points)][order]] = lengths[order]
    return LaserScanMessage(
        stamp_ns, frame_id, first, step, 0.0, 0.0, 0.0, limit, ranges, np.empty(0, np.float32)
    )


def _lattice(bearings: NDArray[np.float64], increment: float) -> tuple[float, float]:
    """First bearing and step on which all bearings lie, or nearly."""
    if len(bearings) == 0:
        return 0.0, increment or 0.01
    first = float(bearings.min())
    span = float(bearings.max()) - first
    if increment <= 0:
        gaps = np.diff(np.sort(bearings))
        gaps = gaps[gaps > 1e-6]
        increment = float(np.median(gaps)) if len(gaps) else 0.01
    increment = max(increment, span / _MAX_BEAMS, 1e-6)
    places = (bearings - first) / increment
    off = float(np.abs(places - np.rint(places)).max())
    return first, increment if off < _ON_LATTICE else increment / _FINER
