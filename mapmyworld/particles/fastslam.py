"""Grid-based FastSLAM over a whole log: track, filter, smooth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.alignment.laser_refinement import carry_along
from mapmyworld.config import Config, ParticlesConfig, RegistrationConfig
from mapmyworld.errors import LogError
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar, matrix_to_planar
from mapmyworld.odometry.laser_odometry import LaserMotion, LaserTracker
from mapmyworld.parallel import batches
from mapmyworld.particles.filter import Generation, ParticleFilter
from mapmyworld.particles.history import paths_of, summary_of
from mapmyworld.particles.kernels.surface_tiles import Beams
from mapmyworld.particles.motions import Motion, motions_between, tracked_between
from mapmyworld.particles.smoothing import smooth_path
from mapmyworld.registration.scan_matching import prepare_scan
from mapmyworld.types import Frame, Progress, Scan

_AT_ONCE = 64  # scans that are tracked in one go
_AHEAD = 2  # updates that are looked at ahead where scan and odometry contradict each other
_LONE = 0.25  # m to the nearer neighbour in the sweep from which an end point stands alone


@dataclass(frozen=True, slots=True, eq=False)
class FastSlamResult:
    """The best particle, and how the others fared."""

    stamps_ns: NDArray[np.int64]
    """(F,) of the frames that have a scan, in the order of motion."""
    path: NDArray[np.float64]
    """(F, 3) map_from_base of the best particle, smoothed."""
    covariances: NDArray[np.float64]
    """(F, 3, 3) of x, y, yaw in each pose's own frame: spread of the weighted particles."""
    summary: dict[str, Any]
    paths: dict[str, list[Any]]
    """How the filter went, in numbers and as a picture's lines."""
    times_lost: int
    """Scans that fit nothing seen before while there was no odometry."""
    notes: tuple[str, ...]
    losses: tuple[str, ...]
    """What tracking noticed, and what it lost."""


@dataclass(slots=True)
class _Record:
    """What tracking leaves: every frame's motion, the updates' scans."""

    stamps: list[int] = field(default_factory=list)
    tracked: list[NDArray[np.float64]] = field(default_factory=list)
    covariances: list[NDArray[np.float64]] = field(default_factory=list)
    odometry: list[NDArray[np.float64]] = field(default_factory=list)
    """(3,) each; NaN where unknown."""
    updates: list[int] = field(default_factory=list)
    """Frames at which the filter is updated."""
    beams: list[Beams] = field(default_factory=list)
    scans: list[Scan] = field(default_factory=list)
    times_lost: int = 0

    def add(self, frame: Frame, tracked: LaserMotion, settings: ParticlesConfig) -> None:
        """One more frame that has a scan."""
        odometry = frame.odom_from_base
        self.stamps.append(frame.stamp_ns)
        self.tracked.append(tracked.pose)
        self.covariances.append(tracked.covariance)
        self.times_lost += int(tracked.is_tracking_loss and odometry is None)
        self.odometry.append(np.full(3, np.nan) if odometry is None else matrix_to_planar(odometry))
        if frame.scan is not None and self._moved_enough(settings):
            self.updates.append(len(self.tracked) - 1)
            self.beams.append(beams_from_scan(frame.scan, settings))
            self.scans.append(frame.scan)

    def _moved_enough(self, settings: ParticlesConfig) -> bool:
        """Whether the newest frame is the first, or far from the last update."""
        if not self.updates:
            return True
        moved = between_planar(self.tracked[self.updates[-1]], self.tracked[-1])
        far = np.hypot(*moved[:2]) >= settings.step_distance
        return bool(far or abs(moved[2]) >= settings.step_angle)

    def motions(self, wheels: NDArray[np.float64], config: Config) -> list[Motion]:
        """From each update to the next."""
        odometry = np.array([np.full(3, np.nan), *self.odometry])
        recorded = between_planar(odometry[:-1], odometry[1:])
        poses, covariances = np.array(self.tracked), np.array(self.covariances)
        return motions_between(self.updates, poses, covariances, recorded, wheels, config.odometry)


def run_fastslam(
    frames: Iterable[Frame], config: Config, progress: Progress, wheels: Array | None = None
) -> FastSlamResult:
    """Path of the most likely particle, from the scans of a log.

    `wheels` (56,): how the odometry is calibrated, if that is known. Raises LogError when no frame
    has a scan.
    """
    tracker = LaserTracker(config, wheels)
    record = _track(frames, tracker, config, progress)
    motions = record.motions(tracker.wheels, config)
    path, generations = _filtered(motions, record.beams, config, progress)
    updates = _smoothed_path(path, motions, record, config, progress)
    tracked, at = np.array(record.tracked), np.array(record.updates)
    before = np.searchsorted(at, np.arange(len(tracked)), "right") - 1
    # Tracked motion since the last update, bent so that it meets the next one.
    return FastSlamResult(
        stamps_ns=np.array(record.stamps, np.int64),
        path=carry_along(tracked, at, updates, np.arange(len(tracked), dtype=np.float64)),
        covariances=np.array([g.covariance for g in generations])[before],
        summary=summary_of(generations, updates, at),
        paths=paths_of(generations, updates),
        times_lost=record.times_lost,
        notes=tracker.notes(),
        losses=tracker.losses(),
    )


def _track(
    frames: Iterable[Frame], tracker: LaserTracker, config: Config, progress: Progress
) -> _Record:
    """Tracks every frame that has a scan; keeps the scans where the robot has moved far enough.

    All of it before the filter begins: only in the end the wheels are calibrated by the whole log.
    """
    record = _Record()
    progress.stage("track", None, "s")
    for some in batches((f for f in frames if f.scan is not None), _AT_ONCE):
        for frame, tracked in zip(some, tracker.track_all(some), strict=True):
            record.add(frame, tracked, config.particles)
        progress.update((record.stamps[-1] - record.stamps[0]) * 1e-9)
    if not record.stamps:
        raise LogError("FastSLAM needs laser scans, and no frame of this log has one")
    return record


def _filtered(
    motions: Sequence[Motion], scans: Sequence[Beams], config: Config, progress: Progress
) -> tuple[NDArray[np.float64], list[Generation]]:
    """The best particle's path (K, 3) and all generations, one a scan; the maps are let go."""
    progress.stage("particles", float(len(scans)), "scans")
    particles = ParticleFilter(config.particles, config.threads, config.seed)
    for k in range(len(scans)):
        known = motions[k - 1 : k + _AHEAD] if k else []
        particles.step(known, scans[k : k + 1 + _AHEAD])
        progress.update(float(k + 1))
    return particles.best_path(), particles.generations


def _smoothed_path(
    path: Array, motions: Sequence[Motion], record: _Record, config: Config, progress: Progress
) -> Array:
    """The best particle's path (K, 3) at the updates, smoothed.

    Between them the robot moved as it was tracked, but where the particle follows the odometry
    against that.
    """
    if len(path) < 3 or not config.odometry.refine:
        return path
    tracked, covariances = np.array(record.tracked), np.array(record.covariances)
    u, covariance = tracked_between(record.updates, tracked, covariances)
    steps = between_planar(path[:-1], path[1:])
    for k, (motion, step) in enumerate(zip(motions, steps, strict=True)):
        if motion.is_contradicted and motion.nearest(step) == 0:
            u[k], covariance[k] = motion.u[0], motion.covariance[0]
    stamps = np.array(record.stamps, np.int64)[record.updates]
    odometry = np.array(record.odometry)[record.updates]
    return smooth_path(path, u, covariance, odometry, stamps, record.scans, config, progress)


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
