"""When sensors measure, what their stamps indicate, and when the recorder gets the message."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.simulation.robot_settings import ClockSettings


@dataclass(frozen=True, slots=True, eq=False)
class Schedule:
    """Parallel arrays, one entry a measurement."""

    times: Array
    """(N,) seconds since the start at which it is really taken."""
    stamps_ns: NDArray[np.int64]
    """(N,) what its header indicates, increasing."""
    log_times_ns: NDArray[np.int64]
    """(N,) when it is recorded, increasing."""


def random_of(seed: int, *path: str | int) -> np.random.Generator:
    """A generator of its own for every purpose, so that no stream disturbs another."""
    words = [p if isinstance(p, int) else zlib.crc32(p.encode()) for p in path]
    return np.random.default_rng([seed, *words])


def make_schedule(
    rate: float,
    duration: float,
    latency: float,
    clock: ClockSettings,
    random: np.random.Generator,
) -> Schedule:
    """Regular measurements from a random phase on, with uncertain stamps and late recording."""
    phase = random.random() / rate
    times = np.arange(phase, duration, 1.0 / rate)
    start_ns = round(clock.start * 1e9)
    jitter = np.clip(random.normal(size=len(times)), -3.0, 3.0) * clock.stamp_jitter
    delay = latency + random.exponential(clock.latency_jitter, len(times))
    stamps = start_ns + np.round((times + jitter) * 1e9).astype(np.int64)
    recorded = np.maximum(start_ns + np.round((times + delay) * 1e9).astype(np.int64), stamps)
    return Schedule(times, np.maximum.accumulate(stamps), np.maximum.accumulate(recorded))
