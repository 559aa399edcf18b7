"""Scans made ready for matching: far and crowded end points dropped, normals estimated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.particles.kernels import Beams
from mapmyworld.types import Scan

_SPAN = 4  # neighbours on each side that a normal may rest on
_STRAIGHT = 0.03  # m from the chord of its neighbours at which a lone end point is on a line
_CHORD = 4.0  # m, such a chord at most
_NORMAL_BASE = 0.12  # m between the outer neighbours from which a direction is trusted


def beams_from_scan(scan: Scan, *, range_max: float, spacing: float, most: int) -> Beams:
    """At most `most` end points nearer than `range_max`, some `spacing` apart, with normals."""
    points = np.asarray(scan.points, np.float64)
    origin = np.asarray(scan.origin[:2], np.float64)
    points = points[np.all(np.isfinite(points), axis=1)]
    points = points[np.hypot(*(points - origin).T) < range_max]
    normals = surface_normals(points, origin, scan.angle_increment)
    keep = _spaced(points, spacing)
    if len(keep) > most:
        keep = keep[(np.arange(most) * len(keep)) // most]
    return Beams(np.ascontiguousarray(points[keep]), np.ascontiguousarray(normals[keep]), origin)


def surface_normals(
    points: NDArray[np.float64], origin: NDArray[np.float64], increment: float
) -> NDArray[np.float64]:
    """Unit normals (N, 2) towards the lidar, across neighbours in the sweep; zero where unknown.

    Neighbours belong to the same surface while the gap between consecutive end points stays
    small for their range; the nearest pair far enough apart gives the direction.
    """
    count = len(points)
    normals = np.zeros((count, 2))
    if count < 3:
        return normals
    ranges = np.hypot(*(points - origin).T)
    gaps = np.hypot(*np.diff(points, axis=0).T)
    allowed = 0.06 + 4.0 * max(increment, 0.002) * np.minimum(ranges[1:], ranges[:-1])
    joined = np.concatenate([[0], np.cumsum(gaps > allowed)])
    index = np.arange(count)
    pending = np.ones(count, np.bool_)
    for span in range(1, _SPAN + 1):
        before, after = np.maximum(index - span, 0), np.minimum(index + span, count - 1)
        before = np.where(joined[before] == joined, before, index)
        after = np.where(joined[after] == joined, after, index)
        along = points[after] - points[before]
        length = np.hypot(*along.T)
        ready = pending & (after > index) & (before < index)
        ready &= (length > _NORMAL_BASE) | (span == _SPAN) & (length > 0.5 * _NORMAL_BASE)
        across = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.maximum(length, 1e-9)[:, None]
        normals[ready] = across[ready]
        pending &= ~ready
    _add_sparse_normals(points, normals, pending)
    towards = np.sum(normals * (origin - points), axis=1)
    normals[towards < 0.0] *= -1.0
    return normals


def _add_sparse_normals(
    points: NDArray[np.float64], normals: NDArray[np.float64], pending: NDArray[np.bool_]
) -> None:
    """Fills in normals where beams graze a wall so that end points lie far apart, but in a line."""
    chord = points[2:] - points[:-2]
    length = np.hypot(*chord.T)
    across = np.stack([chord[:, 1], -chord[:, 0]], axis=1) / np.maximum(length, 1e-9)[:, None]
    offset = np.abs(np.sum(across * (points[1:-1] - points[:-2]), axis=1))
    inner = pending[1:-1] & (offset < _STRAIGHT) & (length > _NORMAL_BASE) & (length < _CHORD)
    middle = np.flatnonzero(inner) + 1
    normals[middle] = across[inner]


def _spaced(points: NDArray[np.float64], spacing: float) -> NDArray[np.int64]:
    """Indices of end points, in sweep order, of which neighbours are about `spacing` apart."""
    if len(points) == 0:
        return np.zeros(0, np.int64)
    steps = np.concatenate([[0.0], np.hypot(*np.diff(points, axis=0).T)])
    # A jump to another surface counts as one spacing, so that its first point is kept.
    travelled = np.cumsum(np.minimum(steps, spacing))
    bins = np.floor(travelled / spacing + 1e-9)
    return np.flatnonzero(np.concatenate([[True], np.diff(bins) > 0]))
