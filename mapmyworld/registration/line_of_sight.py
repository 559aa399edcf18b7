"""What a laser sees through: points beyond the surfaces that other scans met."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import transform_points_planar
from mapmyworld.registration.scan_matching import PreparedScan, ScanSet
from mapmyworld.registration.scan_search import submap_points

_SECTORS = 360  # about the laser, in each of which the nearest surface hides the others
_MARGIN, _SHARE = 0.2, 0.03  # m, and of the range, by which a point may miss its surface


def share_seen_through(scan: PreparedScan, targets: ScanSet, poses: Array, pose: Array) -> float:
    """Share of a scan's points that, from a pose (3,), lie beyond surfaces of the targets.

    Of those that lie at or beyond one: what comes from nearer may be somebody in the way, and
    about the rest the targets, at `poses` (S, 3), indicate nothing.
    """
    origin = transform_points_planar(pose, scan.origin[None])
    surfaces = submap_points(targets, poses)
    known, sector = _polar(surfaces - origin)
    nearest = np.full(_SECTORS, np.inf)
    np.minimum.at(nearest, sector, known)
    away, sector = _polar(transform_points_planar(pose, scan.rows[:, :2]) - origin)
    behind, margin = away - nearest[sector], _MARGIN + _SHARE * away
    beyond = int(np.count_nonzero(behind > margin))
    met = int(np.count_nonzero(np.abs(behind) <= margin))
    return beyond / max(beyond + met, 1)


def _polar(points: Array) -> tuple[Array, NDArray[np.int64]]:
    """Distances (N,) of points (N, 2), and the sectors they lie in."""
    turn = np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi) + 0.5
    return np.hypot(points[:, 0], points[:, 1]), (turn * _SECTORS).astype(np.int64) % _SECTORS
