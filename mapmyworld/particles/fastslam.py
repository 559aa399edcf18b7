"""Grid-based FastSLAM over a whole log: track, filter, smooth, draw."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.errors import ConfigError, LogError
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    interpolate_planar,
    matrix_to_planar,
    wrap_angle,
)
from mapmyworld.particles.filter import ParticleFilter, motion_covariance
from mapmyworld.particles.filter_scans import beams_from_scan
from mapmyworld.particles.history import FastSlamHistory, history_from_filter
from mapmyworld.particles.kernels import Beams
from mapmyworld.particles.smoothing import smooth_path
from mapmyworld.particles.threads import Workers
from mapmyworld.particles.tracker import LocalTracker
from mapmyworld.types import OccupancyGrid, Progress, Scan


class Moment(Protocol):
    """As much of a frame as FastSLAM reads."""

    @property
    def stamp_ns(self) -> int: ...
    @property
    def odom_from_base(self) -> NDArray[np.float64] | None:
        """(4, 4)."""
        ...

    @property
    def scan(self) -> Scan | None: ...


@dataclass(frozen=True, slots=True, eq=False)
class FastSlamResult:
    """The best particle, and how the others fared."""

    stamps_ns: NDArray[np.int64]
    """(F,) of the frames that have a scan, in the order of motion."""
    path: NDArray[np.float64]
    """(F, 3) map_from_base of the best particle, smoothed."""
    covariances: NDArray[np.float64]
    """(F, 3, 3) of x, y, yaw in each pose's own frame: spread of the weighted particles."""
    grid: OccupancyGrid
    history: FastSlamHistory


@dataclass(slots=True)
class _Record:
    """What the pass over the frames leaves: every frame's motion, the updates' scans."""

    stamps: list[int] = field(default_factory=list)
    tracked: list[NDArray[np.float64]] = field(default_factory=list)
    updates: list[int] = field(default_factory=list)
    """Frames at which the filter was updated."""
    beams: list[Beams] = field(default_factory=list)
    scans: list[Scan] = field(default_factory=list)


def run_fastslam(frames: Iterable[Moment], config: Config, progress: Progress) -> FastSlamResult:
    """Path and map of the most likely particle, from the scans of a log.

    Raises LogError when no frame has a scan, ConfigError when there is no such measurement model.
    """
    _check(config.particles.measurement)
    with Workers(config.threads) as workers:
        particles = ParticleFilter(config.particles, workers, config.seed)
        record = _filter_frames(frames, particles, config, workers, progress)
        updates = _refined_path(particles, record, config, workers, progress)
    progress.stage("particle map", float(len(updates)), "scans")
    return FastSlamResult(
        stamps_ns=np.array(record.stamps, np.int64),
        path=_path_of_frames(updates, record),
        covariances=_covariances_of_frames(particles, record),
        grid=_grid(updates, record, config),
        history=history_from_filter(particles.generations, updates, np.array(record.updates)),
    )


def _check(model: str) -> None:
    if model not in ("field", "beams"):
        raise ConfigError(f'particles.measurement is "{model}": use "field" or "beams"')


def _filter_frames(
    frames: Iterable[Moment],
    particles: ParticleFilter,
    config: Config,
    workers: Workers,
    progress: Progress,
) -> _Record:
    """Tracks every frame; updates the filter wherever the robot has moved far enough."""
    settings = config.particles
    record, tracker = _Record(), LocalTracker(settings, workers)
    previous: NDArray[np.float64] | None = None
    progress.stage("particles", None, "s")
    for frame in frames:
        if frame.scan is None:
            continue
        beams = beams_from_scan(
            frame.scan,
            range_max=settings.range_max,
            spacing=settings.beam_spacing,
            most=settings.beams,
        )
        odometry = None if frame.odom_from_base is None else matrix_to_planar(frame.odom_from_base)
        pose = tracker.track(_motion(previous, odometry), beams)
        previous = odometry
        record.stamps.append(frame.stamp_ns)
        record.tracked.append(pose)
        if _moved_enough(record, config):
            last = record.tracked[record.updates[-1]] if record.updates else pose
            tracker.remember(beams)
            particles.step(between_planar(last, pose), beams)
            record.updates.append(len(record.tracked) - 1)
            record.beams.append(beams)
            record.scans.append(frame.scan)
        progress.update((frame.stamp_ns - record.stamps[0]) * 1e-9)
    if not record.stamps:
        raise LogError("FastSLAM needs laser scans, and no frame of this log has one")
    return record


def _motion(
    before: NDArray[np.float64] | None, after: NDArray[np.float64] | None
) -> NDArray[np.float64] | None:
    return None if before is None or after is None else between_planar(before, after)


def _moved_enough(record: _Record, config: Config) -> bool:
    """Whether the newest frame is the first, or far from the last update."""
    if not record.updates:
        return True
    moved = between_planar(record.tracked[record.updates[-1]], record.tracked[-1])
    far = np.hypot(*moved[:2]) >= config.particles.step_distance
    return bool(far or abs(moved[2]) >= config.particles.step_angle)


def _refined_path(
    particles: ParticleFilter,
    record: _Record,
    config: Config,
    workers: Workers,
    progress: Progress,
) -> NDArray[np.float64]:
    """The best particle's path (K, 3) at the updates, smoothed against its own map."""
    path = particles.best_path()
    if len(path) < 2 or config.particles.smoothing < 1:
        return path
    progress.stage("smooth the best particle", float(config.particles.smoothing), "rounds")
    tracked = np.array(record.tracked)[record.updates]
    u = between_planar(tracked[:-1], tracked[1:])
    information = np.array([np.linalg.inv(motion_covariance(v, config.particles)) for v in u])
    return smooth_path(path, u, information, record.beams, config.particles, workers, progress)


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


def _covariances_of_frames(particles: ParticleFilter, record: _Record) -> NDArray[np.float64]:
    """Covariances (F, 3, 3): each frame has that of the last update."""
    at_updates = np.array([generation.covariance for generation in particles.generations])
    before = np.searchsorted(record.updates, np.arange(len(record.tracked)), "right") - 1
    return np.asarray(at_updates[before])


def _grid(updates: NDArray[np.float64], record: _Record, config: Config) -> OccupancyGrid:
    """The occupancy grid of the updates' scans, by the inverse sensor model of all our grids."""
    from mapmyworld.mapping.occupancy import build_grid

    return build_grid(zip(updates, record.scans, strict=True), config)
