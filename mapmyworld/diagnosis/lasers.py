"""Laser against odometry and gyroscope: scale of distances, and time offsets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from mapmyworld.config import Config, RegistrationConfig
from mapmyworld.diagnosis.finding import Finding
from mapmyworld.diagnosis.rotation import nearest_offset, time_offset
from mapmyworld.diagnosis.sample import odometry_yaw, take_sample
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.geometry.rigid import between
from mapmyworld.registration.scan_matching import COARSE, match_scan, prepare_scans, scan_set
from mapmyworld.sensing.plan import Plan, ScanSource
from mapmyworld.types import Frame, LogSource

_LEAST_OVERLAP = 0.6
_STRAIGHT = 0.02  # rad of turn below which a step reports distances
_LEAST_STEP = 0.02  # m
_INFORMATIVE = 0.1  # share of a match's information along the path, to measure distances
_LEAST_DISTANCE = 0.5  # m in all, from which the scale is worth a word
_ROUNDS = 5  # measurements of a time offset, each from the stamps that the one before gave
_FAR_BETTER = 2.5  # by which the error must fall for a time offset to be taken back
_NOTHING_LEFT = 0.005  # s, half of the steps in which offsets are tried
_HALF = 0.6  # of the time between sweeps, which half of one lasts at most, and some noise
_SCALE_OFF = 0.03  # share by which odometry may be wrong before it is worth a word


def laser_findings(
    frames: list[Frame], plan: Plan, config: RegistrationConfig
) -> Iterator[Finding]:
    """What comparing neighbouring scans reports about the odometry and the clocks."""
    pairs, moves, reported = _matched(frames, config)
    if not pairs:
        return
    certain = reported > _INFORMATIVE
    yield from distance_scale(_odometry_steps(pairs)[certain], moves[certain])
    first_ns = frames[0].stamp_ns
    starts, ends = _times(pairs, first_ns)
    clocks = ("odometry", odometry_yaw(plan, first_ns)), ("gyroscope", _gyro_yaw(frames))
    for name, clock in clocks:
        found = clock and time_offset(("laser", name), starts, ends, moves[:, 2], clock)
        if found is not None:
            yield _beside_half_a_sweep(found, frames, plan.scan)


def _beside_half_a_sweep(found: Finding, frames: list[Frame], scan: ScanSource | None) -> Finding:
    """A time offset; where nothing reports when a beam was taken, half a sweep of it is no news."""
    period = float(np.median(np.diff([f.stamp_ns for f in frames if f.scan]))) * 1e-9
    is_half = found.unit == "s" and abs(found.value) < _HALF * period
    if found.good or scan is None or scan.is_deskewed or not is_half:
        return found
    return replace(
        found,
        text=f"{found.text}: half a sweep ({period:.2f} s), as the laser gives no time_increment",
        suggestion=f"have its driver fill time_increment; else {found.suggestion}",
    )


def refined_lag(log: LogSource, plan: Plan, config: Config, lag_s: float) -> float:
    """By how many seconds odometry is stamped later than the laser, from a first measurement.

    That is off by up to half a sweep, because sweeps are put right by the very odometry: so it is
    measured again with the stamps shifted by what was found, until nothing is left. 0 where both
    then agree little better than unshifted: wheels slip as well.
    """
    unshifted = _offset(log, plan, config)
    if unshifted is None:
        return 0.0
    for _ in range(_ROUNDS):
        found = _offset(log, plan.with_odometry_shifted(-lag_s), config)
        if found is None:
            return 0.0
        rest, error = found
        if abs(rest) < _NOTHING_LEFT:
            return lag_s if unshifted[1] > _FAR_BETTER * error else 0.0
        lag_s += rest
    return 0.0


def _offset(log: LogSource, plan: Plan, config: Config) -> tuple[float, float] | None:
    """`nearest_offset` of odometry to laser in a log's first minutes; None where it is unknown."""
    frames = take_sample(log, plan, config.sensing)
    pairs, moves, _ = _matched(frames, config.registration)
    if not pairs:
        return None
    first_ns = frames[0].stamp_ns
    (starts, ends), clock = _times(pairs, first_ns), odometry_yaw(plan, first_ns)
    return clock and nearest_offset(starts, ends, moves[:, 2], clock)


def _times(pairs: list[tuple[Frame, Frame]], first_ns: int) -> Array:
    """Seconds (2, N) since a stamp at which the frames of each pair were taken."""
    return np.array([[f.stamp_ns - first_ns for f in pair] for pair in pairs]).T * 1e-9


def _matched(
    frames: list[Frame], config: RegistrationConfig
) -> tuple[list[tuple[Frame, Frame]], Array, Array]:
    """Neighbouring frames whose scans overlap enough, the motions (N, 3) between them by scan
    matching, and the share (N,) of its information along the path.
    """
    pairs = [(a, b) for a, b in pairwise(frames) if a.scan and b.scan]
    if not pairs:
        return [], np.zeros((0, 3)), np.zeros(0)
    scans = [pair[0].scan for pair in pairs] + [pairs[-1][1].scan]
    prepared = prepare_scans([scan for scan in scans if scan is not None], config)
    moves, reported = np.full((len(pairs), 3), np.nan), np.zeros(len(pairs))
    guess = np.zeros(3)
    for i, step in enumerate(_odometry_steps(pairs)):
        if not np.isnan(step[0]):
            guess = step
        before, after = scan_set([prepared.one(i)]), prepared.one(i + 1)
        match = match_scan(after, before, np.zeros((1, 3)), guess, config, max_distances=COARSE)
        if match.overlap > _LEAST_OVERLAP:
            moves[i] = guess = match.pose
            reported[i] = _information_along(match.pose[:2], match.information)
    good = np.flatnonzero(np.isfinite(moves[:, 0]))
    return [pairs[i] for i in good], moves[good], reported[good]


def _information_along(distance: Array, information: Array) -> float:
    """Share of a match's positional information that lies along the path.

    Between bare walls it is next to nothing, and the scan stays where noise puts it.
    """
    length, whole = float(np.hypot(*distance)), float(information[0, 0] + information[1, 1])
    if length < 1e-6 or whole <= 0.0:
        return 0.0
    spread = np.linalg.inv(information + 1e-9 * whole * np.eye(3))[:2, :2]
    along = distance / length
    return float(1.0 / max(float(along @ spread @ along) * whole, 1.0))


def _odometry_steps(pairs: list[tuple[Frame, Frame]]) -> Array:
    """Motions (N, 3) by the odometry; NaN where it is not known."""
    return np.array(
        [
            matrix_to_planar(between(a.odom_from_base, b.odom_from_base))
            if a.odom_from_base is not None and b.odom_from_base is not None
            else np.full(3, np.nan)
            for a, b in pairs
        ]
    )


def distance_scale(steps: Array, moves: Array) -> Iterator[Finding]:
    """Distance by scan matching (N, 3) over that by odometry (N, 3), where the robot drives on."""
    distance = np.hypot(steps[:, 0], steps[:, 1])
    with np.errstate(invalid="ignore"):
        usable = (distance > _LEAST_STEP) & (np.abs(moves[:, 2]) < _STRAIGHT)
    if not usable.any() or distance[usable].sum() < _LEAST_DISTANCE:
        return
    seen = np.hypot(moves[usable, 0], moves[usable, 1])
    scale = _ratio(seen, distance[usable])
    good = abs(scale - 1.0) < _SCALE_OFF
    text = (
        f"scan matching measures {scale:.3f} of the distance that odometry reports "
        f"({usable.sum()} straight steps, {distance[usable].sum():.1f} m)"
    )
    suggestion = f"correct the wheel radius by a factor of {scale:.3f}"
    yield Finding("odometry scale", scale, "", good, text, suggestion)


def _ratio(seen: Array, distance: Array) -> float:
    """Of the distances, without the steps that slipped.

    Of their sums: jitter of the stamps shifts way from one step to the next, which a median of
    the steps' ratios follows (Intel: 0.951, where any metre of the path indicates 0.966).
    """
    ratios = seen / distance
    middle = np.median(ratios)
    kept = (ratios > 0.5 * middle) & (ratios < 2.0 * middle)
    return float(seen[kept].sum() / distance[kept].sum()) if kept.any() else float(middle)


def _gyro_yaw(frames: list[Frame]) -> tuple[Array, Array] | None:
    """Times and integrated turn about the base's z axis."""
    samples = [one for frame in frames for one in frame.imu]
    if len(samples) < 2:
        return None
    times = np.array([s.stamp_ns - frames[0].stamp_ns for s in samples]) * 1e-9
    rates = np.array([s.angular_velocity[2] for s in samples])
    order = np.argsort(times, kind="stable")
    times, rates = times[order], rates[order]
    yaw = np.concatenate([[0.0], np.cumsum(np.diff(times) * 0.5 * (rates[1:] + rates[:-1]))])
    return times, yaw
