"""Scans made ready for matching, and one scan aligned with others of known poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import RegistrationConfig
from mapmyworld.kernels.scan_alignment import align
from mapmyworld.kernels.scan_preparation import prepare_points
from mapmyworld.types import Scan

_NO_PRIOR = np.zeros((3, 3))
FINE = np.array([0.3, 0.2, 0.15, 0.12, 0.12, 0.12])  # m, reaches from a good guess
COARSE = np.array([0.8, 0.8, 0.6, 0.5, 0.4, 0.3, 0.2, 0.15, 0.12, 0.12])  # m, from a poor guess


@dataclass(frozen=True, slots=True, eq=False)
class PreparedScan:
    """A scan's points, evenly spaced, with the normals of the lines they lie on."""

    rows: NDArray[np.float32]
    """(N, 5): x, y, normal x, normal y (zero if unknown), bearing about the lidar, ascending."""
    origin: NDArray[np.float64]
    """(2,) the lidar in the base frame."""


@dataclass(frozen=True, slots=True, eq=False)
class ScanSet:
    """Many prepared scans behind each other in one array."""

    rows: NDArray[np.float32]
    """(T, 5)."""
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
    count: int
    """Residuals that agree."""


def prepare_scan(scan: Scan, config: RegistrationConfig) -> PreparedScan:
    """The scan's points for matching; empty where it has no returns in range."""
    origin = np.ascontiguousarray(scan.origin[:2], np.float64)
    points = np.asarray(scan.points, np.float32)
    if len(points) == 0:
        return PreparedScan(np.zeros((0, 5), np.float32), origin)
    offsets = points - origin.astype(np.float32)
    squared = np.einsum("ij,ij->i", offsets, offsets)
    near = squared < config.range_max**2  # also drops NaN
    if not near.all():
        points = points[near]
    points = np.ascontiguousarray(points)
    steps = np.hypot(*np.diff(points, axis=0).T)
    spacing = max(config.point_spacing, float(np.minimum(steps, 0.5).sum()) / config.point_count)
    out = np.empty((len(points), 5), np.float32)
    increment = scan.angle_increment if np.isfinite(scan.angle_increment) else 0.01
    kept = prepare_points(points, origin, increment, spacing, config.line_radius, out)
    return PreparedScan(out[:kept].copy(), origin)


def scan_set(scans: Sequence[PreparedScan]) -> ScanSet:
    """The scans as one set."""
    if not scans:
        return ScanSet(np.zeros((0, 5), np.float32), np.zeros(1, np.int64), np.zeros((0, 2)))
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
    which: NDArray[np.int64],
    poses: NDArray[np.float64],
    guess: NDArray[np.float64],
    config: RegistrationConfig,
    *,
    prior: NDArray[np.float64] | None = None,
    prior_information: NDArray[np.float64] | None = None,
    reaches: NDArray[np.float64] = FINE,
) -> Match:
    """Aligns a scan with targets `which` at `poses` (S, 3), from `guess` (3,).

    `prior` (3,) with its information pulls as another measurement; the match's own information
    leaves it out.
    """
    out = np.zeros(16)
    sigma = config.range_sigma * np.sqrt(config.correlation)
    align(
        scan.rows, 0, len(scan.rows), targets.rows, targets.bounds, which, poses, targets.origins,
        guess, guess if prior is None else prior,
        _NO_PRIOR if prior_information is None else prior_information,
        reaches, config.residual_scale, sigma, out,
    )  # fmt: skip
    return match_from_row(out, len(which), config)


def match_from_row(out: NDArray[np.float64], targets: int, config: RegistrationConfig) -> Match:
    """The kernel's row of numbers as a match."""
    xx, xy, xr, yy, yr, rr = out[3:9]
    hessian = np.array([[xx, xy, xr], [xy, yy, yr], [xr, yr, rr]])
    sigma_squared = max(config.range_sigma**2, float(out[10])) * config.correlation
    return Match(
        pose=out[:3].copy(),
        information=hessian / (sigma_squared * max(targets, 1)),
        overlap=float(out[9]),
        residual=float(np.sqrt(out[10])),
        count=int(out[11]),
    )
