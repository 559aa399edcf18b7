"""Settings of grid-based FastSLAM."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ParticlesConfig:
    """Settings of FastSLAM."""

    count: int = 30  # particles at most
    count_min: int = 10  # particles at least; as many as `count` switches the adaptation off
    resolution: float = 0.05  # m, cells of the particles' maps
    range_max: float = 25.0  # m, end points farther away are not used
    beams: int = 180  # end points of a scan at most
    beam_spacing: float = 0.03  # m between neighbouring end points
    step_distance: float = 0.15  # m of motion between two updates of the filter
    step_angle: float = 0.15  # rad of rotation between two updates of the filter
    sigma: float = 0.04  # m, end points about surfaces
    beams_effective: float = 40.0  # beams of a scan that count as independent
    odometry_sigma: float = 0.15  # m per m and rad per rad: how far recorded motion is believed
    odometry_floor: float = 0.05  # m, and half as many rad, of uncertainty in any recorded motion
    drift_floor: float = 0.02  # m, and half as many rad, of uncertainty in scan-matched motion
    drift_sigma: float = 0.03  # m per m: uncertainty of scan-matched motion
    drift_angle: float = 0.01  # rad per m: uncertainty of scan-matched motion
    weight_gain: float = 0.025  # power of the weights; below 1 keeps particles apart for longer
    resample_below: float = 0.5  # share of effective particles at which the filter resamples
    kld_error: float = 0.15  # distance to the true posterior that sets the number of particles
    measurement: str = "field"  # "field" = likelihood field, "beams" = beam model
    smoothing: int = 20  # rounds in which path and map of the best particle refine each other
