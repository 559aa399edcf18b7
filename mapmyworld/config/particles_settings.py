"""Settings of grid-based FastSLAM."""

from __future__ import annotations

from dataclasses import dataclass

from mapmyworld.config.ranges import Count, Positive, Share


@dataclass(frozen=True, slots=True)
class ParticlesConfig:
    """Settings of FastSLAM."""

    count: Count = 30  # particles at most
    count_min: Count = 10  # particles at least; as many as `count` switches the adaptation off
    resolution: Positive = 0.05  # m, cells of the particles' maps
    range_max: Positive = 25.0  # m, end points farther away are not used
    beams: Count = 180  # end points of a scan at most
    beam_spacing: Positive = 0.03  # m between neighbouring end points
    step_distance: Positive = 0.15  # m of motion between two updates of the filter
    step_angle: Positive = 0.15  # rad of rotation between two updates of the filter
    sigma: Positive = 0.04  # m, end points about surfaces
    beams_effective: Positive = 40.0  # beams of a scan that count as independent
    weight_gain: Positive = 0.025  # power of the weights; below 1 keeps particles apart for longer
    resample_below: Share = 0.5  # share of effective particles at which the filter resamples
    kld_error: Positive = 0.15  # distance to the true posterior that sets the number of particles
