"""The beams of scans in the map, in cells."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import MappingConfig
from mapmyworld.types import Scan

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """The beams of some scans in the map, in cells."""

    starts: Array
    """(S, 2) the lidars."""
    ends: Array
    """(R, 2) where the beams end."""
    is_hit: NDArray[np.bool_]
    """(R,) whether something stopped them there."""
    bounds: NDArray[np.int64]
    """(S + 1,) where each scan's beams begin."""


def beams_of(scans: Sequence[tuple[Array, Scan]], settings: MappingConfig) -> Beams:
    """Beams of scans at poses (3,), map_from_base, up to the range of the map.

    A scan whose pose is not finite has none.
    """
    poses = np.array([pose for pose, _ in scans], np.float64)
    origins = np.array([scan.origin[:2] for _, scan in scans], np.float64)
    starts = _placed(poses, origins)
    points = np.concatenate([scan.points for _, scan in scans]).astype(np.float64)
    scan_of = np.repeat(np.arange(len(scans)), [len(scan.points) for _, scan in scans])
    beams = _placed(poses[scan_of], points) - starts[scan_of]
    lengths = np.maximum(np.hypot(beams[:, 0], beams[:, 1]), 1e-9)
    is_hit = lengths <= settings.range_max
    ends = starts[scan_of] + beams * np.minimum(1.0, settings.range_max / lengths)[:, None]
    for away, of in _without_return(scans, poses, starts, settings):
        ends, scan_of = np.concatenate([ends, away]), np.concatenate([scan_of, of])
        is_hit = np.concatenate([is_hit, np.zeros(len(away), np.bool_)])
        order = np.argsort(scan_of, kind="stable")
        ends, is_hit, scan_of = ends[order], is_hit[order], scan_of[order]
    finite = np.isfinite(ends).all(axis=1) & np.isfinite(starts[scan_of]).all(axis=1)
    bounds = np.searchsorted(scan_of[finite], np.arange(len(scans) + 1))
    ends = ends[finite] / settings.resolution
    return Beams(starts / settings.resolution, ends, is_hit[finite], bounds)


def _without_return(
    scans: Sequence[tuple[Array, Scan]], poses: Array, starts: Array, settings: MappingConfig
) -> Iterator[tuple[Array, NDArray[np.int64]]]:
    """Ends (R, 2) of beams that nothing stopped, and of which scan they are, kind by kind."""
    if settings.missing_range > 0:
        yield _missing_ends(scans, poses, starts, settings)
    scan_of = np.repeat(np.arange(len(scans)), [len(scan.passed) for _, scan in scans])
    if len(scan_of):
        points = np.concatenate([scan.passed for _, scan in scans]).astype(np.float64)
        yield _placed(poses[scan_of], points), scan_of


def _missing_ends(
    scans: Sequence[tuple[Array, Scan]], poses: Array, starts: Array, settings: MappingConfig
) -> tuple[Array, NDArray[np.int64]]:
    """How far beams without a return are taken to have gone (R, 2), and of which scan they are."""
    scan_of = np.repeat(np.arange(len(scans)), [len(scan.missing) for _, scan in scans])
    bearings = np.concatenate([scan.missing for _, scan in scans]) + poses[scan_of, 2]
    reach = np.array([min(settings.missing_range, scan.range_max) for _, scan in scans])[scan_of]
    away = reach[:, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)
    return starts[scan_of] + away, scan_of


def _placed(poses: Array, points: Array) -> Array:
    """Points (N, 2), each in a base at its own pose (N, 3), in the map."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = c * points[:, 0] - s * points[:, 1] + poses[:, 0]
    return np.stack([x, s * points[:, 0] + c * points[:, 1] + poses[:, 1]], axis=-1)
