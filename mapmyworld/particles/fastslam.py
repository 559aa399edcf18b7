"""Grid-based FastSLAM over a whole log: track, filter, smooth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.alignment.joint_alignment import align_in_rounds
from mapmyworld.alignment.laser_pairs import neighbour_pairs
from mapmyworld.backend.system import System, number_free
from mapmyworld.config import Config, ParticlesConfig
from mapmyworld.errors import LogError
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    interpolate_planar,
    matrix_to_planar,
    wrap_angle,
)
from mapmyworld.odometry.laser_odometry import LaserMotion, LaserTracker
from mapmyworld.parallel import batches
from mapmyworld.particles.contradictions import Contradictions, contradictions
from mapmyworld.particles.filter import Generation, ParticleFilter
from mapmyworld.particles.filter_scans import beams_from_scan
from mapmyworld.particles.history import paths_of, summary_of
from mapmyworld.particles.kernels.surface_tiles import Beams
from mapmyworld.particles.motions import Motion, motions_between
from mapmyworld.registration.scan_matching import FINE, prepare_scans
from mapmyworld.types import Frame, Progress, Scan

_AT_ONCE = 64  # scans that are tracked in one go
_AHEAD = 2  # updates that are looked at ahead where scan and odometry contradict each other


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
    revisits: Contradictions
    """What visits to the same places report of each other in the final map."""
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


def run_fastslam(frames: Iterable[Frame], config: Config, progress: Progress) -> FastSlamResult:
    """Path of the most likely particle, from the scans of a log.

    Raises LogError when no frame has a scan.
    """
    tracker = LaserTracker(config)
    record = _track(frames, tracker, config, progress)
    motions = record.motions(tracker.wheels, config)
    path, generations = _filtered(motions, record.beams, config, progress)
    updates = _smoothed_path(path, generations, motions, record, config, progress)
    return FastSlamResult(
        stamps_ns=np.array(record.stamps, np.int64),
        path=_path_of_frames(updates, record),
        covariances=_covariances_of_frames(generations, record),
        summary=summary_of(generations, updates, np.array(record.updates)),
        paths=paths_of(generations, updates),
        revisits=contradictions(updates, record.beams),
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
    path: NDArray[np.float64],
    generations: Sequence[Generation],
    motions: Sequence[Motion],
    record: _Record,
    config: Config,
    progress: Progress,
) -> NDArray[np.float64]:
    """The best particle's path (K, 3) at the updates, all their scans aligned with each other."""
    if len(path) < 3 or not config.odometry.refine:
        return path
    steps = between_planar(path[:-1], path[1:])
    modes = [motion.nearest(step) for motion, step in zip(motions, steps, strict=True)]
    u = np.array([motion.u[k] for motion, k in zip(motions, modes, strict=True)])
    covariance = np.array([motion.covariance[k] for motion, k in zip(motions, modes, strict=True)])
    variances = [np.linalg.eigvalsh(g.covariance[:2, :2])[-1] for g in generations]
    spread, information = float(np.sqrt(max(variances))), np.linalg.inv(covariance)
    return smooth_path(path, spread, u, information, record.scans, config, progress)


def smooth_path(
    path: Array, spread: float, motions: Array, information: Array, scans: Sequence[Scan],
    config: Config, progress: Progress,
) -> Array:  # fmt: skip
    """The `path` of scans smoothed, (K, 3) both: all of them aligned with each other.

    The motions (K - 1, 3) between them are known to `information` (K - 1, 3, 3). A particle fixes
    each pose when it passes, with the map of that moment, and of thirty the best one comes back to
    a place about as far off as they lie apart, whose standard deviation is at most `spread` m: so
    far surfaces are looked for at first. Offline the whole path is known, so the posterior over
    paths, p(x_1:t | z_1:t, u_1:t), can be climbed on from there.
    """
    reaches = reaches_from(spread)
    progress.stage("refine", len(reaches), "rounds")
    every, settings = np.arange(len(path)), config.odometry
    system = System(True, every[:-1], every[1:], motions, information, number_free(every == 0))

    def pairs_at(poses: Array) -> NDArray[np.int64]:
        return neighbour_pairs(poses, settings.refine_radius, settings.refine_revisits)

    prepared = prepare_scans(scans, config.registration)
    return align_in_rounds(prepared, system, path, pairs_at, config, progress, reaches).poses


def reaches_from(first: float) -> Array:
    """Reaches (m) from the `first` down to those of a good guess, two rounds a halving."""
    halves = math.ceil(2.0 * math.log2(max(first / FINE[0], 1.0)))
    return np.append(FINE[0] * 2.0 ** (0.5 * np.arange(halves, 0, -1)), FINE)


def _path_of_frames(updates: NDArray[np.float64], record: _Record) -> NDArray[np.float64]:
    """Poses (F, 3): tracked motion since the last update, bent so that it meets the next one."""
    tracked, at = np.array(record.tracked), np.array(record.updates)
    frame = np.arange(len(tracked))
    before = np.searchsorted(at, frame, "right") - 1
    after = np.minimum(before + 1, len(at) - 1)
    forwards = compose_planar(updates[before], between_planar(tracked[at[before]], tracked))
    backwards = compose_planar(updates[after], between_planar(tracked[at[after]], tracked))
    share = (frame - at[before]) / np.maximum(at[after] - at[before], 1)
    path = interpolate_planar(forwards, backwards, np.where(after > before, share, 0.0))
    path[:, 2] = wrap_angle(path[:, 2])
    return path


def _covariances_of_frames(
    generations: Sequence[Generation], record: _Record
) -> NDArray[np.float64]:
    """Covariances (F, 3, 3): each frame has that of the last update."""
    at_updates = np.array([generation.covariance for generation in generations])
    before = np.searchsorted(record.updates, np.arange(len(record.tracked)), "right") - 1
    return np.asarray(at_updates[before])
