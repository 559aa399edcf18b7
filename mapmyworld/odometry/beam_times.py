"""How fast a laser sweeps that does not say when its beams were taken: turning robots show it.

A beam is taken some seconds a radian after the one ahead, and the robot goes on meanwhile, so that
what it sees is stretched or squeezed as it turns. Two scans of one place whose robot turned at
different rates are aligned by point to line, and these seconds are a fourth unknown beside the
pose, of all pairs together. The motion is that by which sweeps are deskewed afterwards
(`RecordedMotion.velocity`): where stamps indicate little of it, the seconds come out small.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from mapmyworld.config import RegistrationConfig
from mapmyworld.errors import LogError
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import between_planar, transform_points_planar, wrap_angle
from mapmyworld.registration.scan_matching import (
    COARSE,
    PreparedScan,
    match_scan,
    prepare_scan,
    scan_set,
)
from mapmyworld.sensing.motion import COURSE, RecordedMotion
from mapmyworld.sensing.sweeps import scan_from_message
from mapmyworld.types import LaserScanMessage

_PLACE = 1.0  # m and rad that a robot goes: two scans of one place or of the next are compared
_PAIRS = 512  # those of which it turned most differently
_OVERLAP = 0.6  # share of a scan that the other explains, at least
_ALIKE = 0.7  # cosine between normals of points on one wall


class BeamTimes(NamedTuple):
    """What pairs of scans show."""

    seconds: float
    """Seconds a radian, in the order of the beams."""
    sigma: float
    """Its standard error; infinite where no pair shows it."""
    pairs: int


class _Taken(NamedTuple):
    """A sweep, and how the robot moved."""

    scan: PreparedScan
    swept: Array
    """(N,) radians from the middle of the sweep to its points."""
    pose: Array
    """(3,) odom_from_base."""
    velocity: Array
    """(3,) m/s and rad/s in the base frame."""


def turning_moments(motion: RecordedMotion) -> Index:
    """(P, 2) stamps, ns: of two places in a row where a robot turned most to the right and left."""
    stamps_ns = np.unique(motion.stamps_ns)
    path, around = motion.in_plane(stamps_ns), round(COURSE * 1e9)
    rates = motion.in_plane(stamps_ns + around)[:, 2] - motion.in_plane(stamps_ns - around)[:, 2]
    moved = np.abs(np.diff(path, axis=0))
    steps = np.hypot(moved[:, 0], moved[:, 1]) + moved[:, 2]
    places = np.concatenate([[0.0], np.cumsum(steps)]) // _PLACE
    starts = np.flatnonzero(np.diff(places, prepend=-1.0)).tolist()
    ends = [*starts[2:], len(rates), len(rates)][: len(starts)]
    extremes = [
        (first + int(rates[first:end].argmin()), first + int(rates[first:end].argmax()))
        for first, end in zip(starts, ends, strict=True)
    ]
    pairs = np.unique(np.array(extremes, np.int64), axis=0)
    order = np.argsort(rates[pairs[:, 0]] - rates[pairs[:, 1]], kind="stable")[:_PAIRS]
    return np.asarray(stamps_ns[pairs[order]])


def beam_times(
    pairs: Sequence[tuple[LaserScanMessage, LaserScanMessage]],
    base_from_lidar: Array,
    motion: RecordedMotion,
    config: RegistrationConfig,
) -> BeamTimes:
    """How fast a laser at `base_from_lidar` (4, 4) sweeps, by pairs of its scans."""
    found = list[tuple[float, float]]()
    for pair in pairs:
        with contextlib.suppress(LogError):  # sweeps that do not say where their beams went
            target, source = (_taken(m, base_from_lidar, motion, config) for m in pair)
            found += _information(target, source, config)
    if not found:
        return BeamTimes(0.0, np.inf, 0)
    pulls, known = np.array(found).T
    seconds = pulls.sum() / known.sum()
    # As registration states, and one more pair that misses by as much as that.
    scatter = (1.0 + np.sum((pulls - seconds * known) ** 2 / known)) / len(found)
    return BeamTimes(float(seconds), float(np.sqrt(scatter / known.sum())), len(found))


def _taken(
    message: LaserScanMessage,
    base_from_lidar: Array,
    motion: RecordedMotion,
    config: RegistrationConfig,
) -> _Taken:
    scan = prepare_scan(scan_from_message(message, base_from_lidar, None), config)
    middle = message.angle_min + 0.5 * (len(message.ranges) - 1) * message.angle_increment
    ahead = base_from_lidar[:2, :2] @ [np.cos(middle), np.sin(middle)]
    order = np.sign(message.angle_increment) * np.copysign(1.0, base_from_lidar[2, 2])
    swept = order * wrap_angle(scan.rows[:, 4] - np.arctan2(ahead[1], ahead[0]))
    pose = motion.in_plane(np.array([message.stamp_ns]))[0]
    return _Taken(scan, swept, pose, motion.velocity(message.stamp_ns))


def _information(
    target: _Taken, source: _Taken, config: RegistrationConfig
) -> list[tuple[float, float]]:
    """What pulls the seconds a radian, and what is known of them, once the pose is eliminated."""
    guess = between_planar(target.pose, source.pose)
    match = match_scan(
        source.scan, scan_set([target.scan]), np.zeros((1, 3)), guess, config, max_distances=COARSE
    )
    seen, mine = (taken.scan.rows.astype(np.float64) for taken in (target, source))
    if match.overlap < _OVERLAP:
        return []
    reach = float(COARSE[-1])
    points = transform_points_planar(match.pose, mine[:, :2])
    turned = np.array([0.0, 0.0, match.pose[2]])
    _, near = cKDTree(seen[:, :2]).query(points, distance_upper_bound=reach)
    normals = np.vstack([seen[:, 2:4], np.zeros(2)])[near]  # none for points that meet nothing
    met = np.sum(transform_points_planar(turned, mine[:, 2:4]) * normals, axis=1) > _ALIKE
    normals, near = normals[met], near[met]
    residuals = np.sum(normals * (points[met] - seen[near, :2]), axis=1)
    of_source = _derivatives(mine[met], transform_points_planar(-turned, normals))
    of_target = _derivatives(seen[near], normals)
    by_time = source.swept[met] * (of_source @ source.velocity)
    by_time -= target.swept[near] * (of_target @ target.velocity)
    rows = np.column_stack([of_source, by_time])
    weights = 1.0 / (1.0 + (residuals / (config.residual_share * reach)) ** 2)
    variance = max(config.range_sigma, match.residual) ** 2 * config.correlation
    hessian = rows.T @ (rows * weights[:, None]) / variance
    gradient = rows.T @ (residuals * weights) / variance
    share = np.linalg.solve(hessian[:3, :3] + np.eye(3), hessian[:3, 3])
    known = hessian[3, 3] - share @ hessian[:3, 3]
    return [(float(share @ gradient[:3] - gradient[3]), float(known))] if known > 0.0 else []


def _derivatives(rows: Array, normals: Array) -> Array:
    """(N, 3) of the distances along `normals` (N, 2), by x, y and yaw of a scan with `rows`."""
    turning = normals[:, 1] * rows[:, 0] - normals[:, 0] * rows[:, 1]
    return np.column_stack([normals, turning])
