"""Scans made ready for matching, and where a match indicates that one lies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import RegistrationConfig
from mapmyworld.geometry import Array
from mapmyworld.kernels.scan_alignment import align
from mapmyworld.kernels.scan_preparation import prepare_many
from mapmyworld.types import Scan

FINE = np.array([0.3, 0.2, 0.15, 0.12, 0.12, 0.12])  # m, reaches from a good guess
COARSE = np.array([0.8, 0.8, 0.6, 0.5, 0.4, 0.3, 0.2, 0.15, 0.12, 0.12])  # m, from a poor guess
_NO_PRIOR = np.zeros((3, 3))


@dataclass(frozen=True, slots=True, eq=False)
class PreparedScan:
    """A scan's points, evenly spaced, with the normals of the lines they lie on."""

    rows: NDArray[np.float32]
    """(N, 6): x, y, normal x and y (zero if unknown), bearing about the lidar, ascending, and the
    variance of the normal's direction, rad^2.
    """
    origin: NDArray[np.float64]
    """(2,) the lidar in the base frame."""


@dataclass(frozen=True, slots=True, eq=False)
class ScanSet:
    """Many prepared scans behind each other in one array."""

    rows: NDArray[np.float32]
    """(T, 6)."""
    bounds: NDArray[np.int64]
    """(S + 1,) where each scan begins; the last one ends at T."""
    origins: NDArray[np.float64]
    """(S, 2)."""

    def __len__(self) -> int:
        return len(self.origins)

    def one(self, index: int) -> PreparedScan:
        """A single scan of the set."""
        rows = self.rows[self.bounds[index] : self.bounds[index + 1]]
        return PreparedScan(rows, self.origins[index])

    def some(self, which: NDArray[np.int64]) -> ScanSet:
        """Scans `which` (K,) of the set, in this order."""
        return scan_set([self.one(k) for k in which.tolist()])

    def let_go(self) -> None:
        """All scans stay: see `places.stored_scans` for others."""


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Where a scan lies among others."""

    pose: NDArray[np.float64]
    """(3,) in the frame of the targets' poses."""
    information: NDArray[np.float64]
    """(3, 3) of the right perturbation, from the match alone."""
    overlap: float
    """Share of the scan's points that the targets explain."""
    residual: float
    """Root mean square distance from the lines, metres."""


def prepare_scan(scan: Scan, config: RegistrationConfig) -> PreparedScan:
    """The scan's points for matching; empty where it has no returns in range."""
    return prepare_scans([scan], config).one(0)


def prepare_scans(scans: Sequence[Scan], config: RegistrationConfig) -> ScanSet:
    """Many scans for matching, behind each other."""
    origins = np.array([scan.origin[:2] for scan in scans], np.float64).reshape(-1, 2)
    if not scans:
        return ScanSet(np.zeros((0, 6), np.float32), np.zeros(1, np.int64), origins)
    points = np.ascontiguousarray(np.concatenate([scan.points for scan in scans]), np.float32)
    bounds = np.concatenate([[0], np.cumsum([len(scan.points) for scan in scans])])
    increments = np.array([scan.angle_increment for scan in scans], np.float64)
    for k in np.flatnonzero(~np.isfinite(increments)).tolist():
        increments[k] = _increment_of(scans[k])
    settings = np.array(
        [config.range_max, config.point_spacing, config.point_count, config.line_radius]
    )
    rows, ends = np.empty((len(points), 6), np.float32), np.empty(len(bounds), np.int64)
    prepare_many(points, bounds.astype(np.int64), origins, increments, settings, rows, ends)
    return ScanSet(rows[: ends[-1]].copy(), ends, origins)


def _increment_of(scan: Scan) -> float:
    """Radians between most neighbouring returns, for a scan that does not say."""
    x, y = (scan.points - scan.origin[:2]).T
    bearings = np.sort(np.arctan2(y, x))
    return float(np.median(np.diff(bearings))) if len(bearings) > 1 else np.pi


def scan_set(scans: Sequence[PreparedScan]) -> ScanSet:
    """The scans as one set."""
    if not scans:
        return ScanSet(np.zeros((0, 6), np.float32), np.zeros(1, np.int64), np.zeros((0, 2)))
    lengths = [len(scan.rows) for scan in scans]
    bounds = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    return ScanSet(
        np.concatenate([scan.rows for scan in scans]),
        bounds,
        np.array([scan.origin for scan in scans], np.float64),
    )


def match_scan(
    scan: PreparedScan,
    targets: ScanSet,
    poses: Array,
    guess: Array,
    config: RegistrationConfig,
    *,
    prior_information: Array = _NO_PRIOR,
    max_distances: Array = FINE,
) -> Match:
    """Aligns a scan with targets at `poses` (S, 3), from `guess` (3,).

    Gauss-Newton on distances from the targets' lines, with Cauchy weights; lines are looked for
    within `max_distances` (R,), metres, one a step. The guess, with its `prior_information` (3, 3),
    pulls as another measurement; the match's own information leaves it out.
    """
    out = np.zeros(11)
    sigma = config.range_sigma * np.sqrt(config.correlation)
    align(
        scan.rows, 0, len(scan.rows), targets.rows, targets.bounds[:-1], targets.bounds[1:],
        np.arange(len(targets)), poses, targets.origins, guess, prior_information, max_distances,
        config.residual_share, sigma, out,
    )  # fmt: skip
    xx, xy, xr, yy, yr, rr = out[3:9]
    hessian = np.array([[xx, xy, xr], [xy, yy, yr], [xr, yr, rr]])
    sigma_squared = max(config.range_sigma**2, float(out[10])) * config.correlation
    return Match(
        pose=out[:3].copy(),
        information=hessian / (sigma_squared * max(len(targets), 1)),
        overlap=float(out[9]),
        residual=float(np.sqrt(out[10])),
    )
