"""The laser: sweeps from a moving robot, first perfect, then as a real one reports them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import compose_planar
from mapmyworld.simulation.driver import Drive
from mapmyworld.simulation.floor_plan import Plan
from mapmyworld.simulation.robot_settings import LaserSettings


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """What an ideal laser measures, with and without glass in the way."""

    ranges: Array
    """(N,) metres; infinite where nothing is met."""
    behind: Array
    """(N,) metres with glass taken away; equal to `ranges` where there is none."""
    incidence: Array
    """(N,) cosine between each beam and the normal of what it meets; 1 where nothing is met."""


@dataclass(frozen=True, slots=True, eq=False)
class Laser:
    """A laser on the robot in a world."""

    settings: LaserSettings
    base_from_laser: Array
    """(3,)."""
    plan: Plan
    plan_behind_glass: Plan

    @property
    def angle_increment(self) -> float:
        """Radians between beams."""
        return float(np.radians(self.settings.field_of_view) / (self.settings.beams - 1))

    @property
    def time_increment(self) -> float:
        """Seconds between beams of a head that turns `rate` times a second."""
        return self.angle_increment / (2.0 * np.pi * self.settings.rate)

    def angles(self) -> Array:
        """(N,) radians of the beams in the laser's frame, in the order of the sweep."""
        first = -np.radians(self.settings.field_of_view) / 2.0
        return np.asarray(first + self.angle_increment * np.arange(self.settings.beams))

    def sweep(self, drive: Drive, start_s: float) -> Sweep:
        """A perfect sweep whose first beam leaves at `start_s`, each beam from where it is then."""
        angles = self.angles()
        times = start_s + self.time_increment * np.arange(len(angles))
        rays = compose_planar(drive.at(times), self.base_from_laser)
        rays[:, 2] += angles
        ranges, hits = self.plan.cast(rays)
        behind = ranges
        if self.plan.glass.any():
            behind, _ = self.plan_behind_glass.cast(rays)
        return Sweep(ranges, behind, _incidence(self.plan.segments, hits, rays[:, 2]))


def _incidence(segments: Array, hits: NDArray[np.int64], angles: Array) -> Array:
    if len(segments) == 0:
        return np.ones(len(hits))
    along = segments[hits, 2:] - segments[hits, :2]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    cosine = np.abs(along[:, 0] * np.sin(angles) - along[:, 1] * np.cos(angles))
    return np.where(hits < 0, 1.0, cosine)


def disturb_sweep(
    sweep: Sweep, settings: LaserSettings, random: np.random.Generator
) -> NDArray[np.float32]:
    """Ranges (N,) as reported: noisy, sometimes missing (infinite), through glass or not.

    Glass hit head-on lets `glass_transmission` of the beams pass; hit at a slant it deflects
    those that it does not pass, and nothing comes back.
    """
    count = len(sweep.ranges)
    at_glass = sweep.behind > sweep.ranges
    passing = random.random(count) < settings.glass_transmission
    deflected = at_glass & ~passing & (random.random(count) > sweep.incidence**4)
    ranges = np.where(at_glass & passing, sweep.behind, sweep.ranges)
    ranges = ranges + random.normal(size=count) * settings.noise
    lost = deflected | (random.random(count) < settings.dropout)
    lost |= (ranges > settings.range_max) | (ranges < settings.range_min)
    return np.where(lost, np.inf, ranges).astype(np.float32)
