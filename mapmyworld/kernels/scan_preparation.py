"""Scans made ready for matching: spaced evenly, smoothed onto local lines, with their normals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit
from mapmyworld.kernels.line_fits import direction_variance, is_line, side_sums, surface_line

_GAP = 6.0  # beam spacings between neighbours beyond which a surface is taken to end
_LEAST_GAP = 0.08  # m, gaps that never end a surface
_SPAN = 2.3  # beam spacings to each side that a line's support reaches at least
_THICK = 0.05  # m, standard deviation across a line, at most
_NOISE_SPAN = 8.0  # standard deviations of a range to each side that a line's support reaches
_NOISE_GAP = 6.0  # standard deviations of a range between neighbours that never end a surface
_NOISE_BIN = 0.001  # m
_NOISE_BINS = 100
_ONE_IN = 10  # neighbours that differ do so by the step to which ranges are rounded, or less
_LOWER_QUARTILE = 0.3186  # of a normal distribution's distances from its mean, in sigmas


@inner_jit
def sort_by_bearing(
    points: NDArray[np.float32], origin: NDArray[np.float64], order: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Bearings (N,) in rad about the lidar, ascending; `order` (N,) becomes the points' order.

    Points (N, 2), the lidar at `origin` (2,). Sweeps come sorted one way or the other, so an
    insertion sort is the fastest.
    """
    count = len(points)
    bearings = np.empty(count)
    turns_back, start = 0, 0
    for i in range(count):
        bearings[i] = np.arctan2(points[i, 1] - origin[1], points[i, 0] - origin[0])
        if i > 0 and bearings[i] < bearings[i - 1]:
            turns_back += 1
    backward = 2 * turns_back > count
    # A full turn that does not start behind the lidar wraps once: begin after that place.
    for i in range(1, count):
        before, after = (i, i - 1) if backward else (i - 1, i)
        if bearings[after] < bearings[before] - np.pi:
            start = i
    raw = bearings.copy()
    for i in range(count):
        k = (start - 1 - i) % count if backward else (start + i) % count
        order[i], bearings[i] = k, raw[k]
    for i in range(1, count):
        value, which, k = bearings[i], order[i], i - 1
        while k >= 0 and bearings[k] > value:
            bearings[k + 1], order[k + 1] = bearings[k], order[k]
            k -= 1
        bearings[k + 1], order[k + 1] = value, which
    return bearings


@jit
def range_noise(
    xs: NDArray[np.float64], ys: NDArray[np.float64], origin: NDArray[np.float64]
) -> float:
    """Standard deviation (m) of the ranges of a sweep, `xs` and `ys` (N,) sorted by bearing.

    A range is compared with where its ray from `origin` (2,) meets the line through its two
    neighbours, which is right at any angle to a wall; the difference has 1.5 times a range's
    variance. By their lower quartile, which corners, edges and clutter hardly move. It is at least
    that of rounding, a twelfth of the step squared: neighbours along a wall are rounded alike.
    """
    counts, steps = np.zeros(_NOISE_BINS, np.int64), np.zeros(_NOISE_BINS, np.int64)
    ranges = np.sqrt((xs - origin[0]) ** 2 + (ys - origin[1]) ** 2)
    for i in range(1, len(xs) - 1):
        step = abs(ranges[i] - ranges[i - 1])
        if step >= _NOISE_BIN:
            steps[_bin_of(step)] += 1
        ax, ay = xs[i - 1] - origin[0], ys[i - 1] - origin[1]
        dx, dy = xs[i + 1] - xs[i - 1], ys[i + 1] - ys[i - 1]
        px, py = xs[i] - origin[0], ys[i] - origin[1]
        across = px * dy - py * dx
        if abs(across) < 1e-12:
            continue
        off = abs(1.0 - (ax * dy - ay * dx) / across) * ranges[i]
        counts[_bin_of(off)] += 1
    noise = _quantile(counts, 4) / (_LOWER_QUARTILE * np.sqrt(1.5))
    return float(max(noise, _quantile(steps, _ONE_IN) / np.sqrt(12.0)))


@inner_jit
def _bin_of(metres: float) -> int:
    return min(int(metres / _NOISE_BIN), _NOISE_BINS - 1)


@inner_jit
def _quantile(counts: NDArray[np.int64], one_in: int) -> float:
    """Metres below which one in so many lies, of a histogram (B,); the middle of its bin."""
    total, seen, low = counts.sum(), 0, 0
    while low < _NOISE_BINS - 1 and one_in * (seen + counts[low]) < total:
        seen += counts[low]
        low += 1
    return _NOISE_BIN * (low + 0.5)


@inner_jit
def prepare_points(
    points: NDArray[np.float32],
    origin: NDArray[np.float64],
    increment: float,
    spacing: float,
    radius: float,
    out: NDArray[np.float32],
) -> int:
    """Fills `out` (N, 6), rows sorted by bearing as `scan_alignment` has them; returns how many.

    Of `points` (N, 2) seen from `origin` (2,) those nearest to each multiple of `spacing` along the
    sweep. The first ones beyond it would be those behind leaps, which rounded ranges have outwards
    on one side of the lidar and inwards on the other: that turns all matches one way. A point whose
    neighbours within `radius` lie on a line is moved onto it and gets the line's normal, towards
    the lidar; others keep their place and a zero normal.
    """
    count = len(points)
    order = np.empty(count, np.int64)
    bearings = sort_by_bearing(points, origin, order)
    xs, ys = np.empty(count), np.empty(count)
    for i in range(count):
        xs[i], ys[i] = points[order[i], 0], points[order[i], 1]
    steps = np.zeros(count)  # from the point before
    for i in range(1, count):
        dx, dy = xs[i] - xs[i - 1], ys[i] - ys[i - 1]
        steps[i] = np.sqrt(dx * dx + dy * dy)
    noise = range_noise(xs, ys, origin)
    radius = max(radius, _NOISE_SPAN * noise)
    thickest = max(_THICK, 2.0 * noise)
    least_gap = max(_LEAST_GAP, _NOISE_GAP * noise)
    kept, begins, ends = 0, 0.0, 0.5 * spacing
    for i in range(count):
        onward = steps[i + 1] if i + 1 < count else 0.0
        begins, ends = ends, ends + 0.5 * (steps[i] + onward)
        if np.floor(ends / spacing) == np.floor(begins / spacing):
            continue
        dx, dy = xs[i] - origin[0], ys[i] - origin[1]
        distance = np.sqrt(dx * dx + dy * dy)
        gap = max(least_gap, _GAP * distance * increment)
        reach = max(radius, _SPAN * distance * increment)
        before = side_sums(xs, ys, steps, i, -1, reach, gap)
        after = side_sums(xs, ys, steps, i, 1, reach, gap)
        out[kept, 0], out[kept, 1] = xs[i], ys[i]
        out[kept, 2], out[kept, 3], out[kept, 4], out[kept, 5] = 0.0, 0.0, bearings[i], 0.0
        line = surface_line(before, after, dx, dy, noise)
        if is_line(line, thickest):
            nx, ny = line.normal_x, line.normal_y
            if nx * dx + ny * dy > 0.0:
                nx, ny = -nx, -ny
            offset = nx * line.centre_x + ny * line.centre_y
            out[kept, 0], out[kept, 1] = xs[i] + offset * nx, ys[i] + offset * ny
            out[kept, 2], out[kept, 3] = nx, ny
            out[kept, 5] = direction_variance(line, noise * (nx * dx + ny * dy) / distance)
        kept += 1
    return kept


@jit
def prepare_many(
    points: NDArray[np.float32],
    bounds: NDArray[np.int64],
    origins: NDArray[np.float64],
    increments: NDArray[np.float64],
    settings: NDArray[np.float64],
    out: NDArray[np.float32],
    out_bounds: NDArray[np.int64],
) -> None:
    """Prepares scans, `points[bounds[k]:bounds[k + 1]]` each, behind each other into `out` (T, 6).

    `points` (N, 2), base frame, and `bounds` (S + 1,) of scans from `origins` (S, 2), their beams
    `increments` (S,), rad, apart. `settings` (4,): metres beyond which returns are dropped, least
    spacing, points of a scan to aim at, radius of a line's fit. Fills `out_bounds` (S + 1,).
    """
    out_bounds[0] = 0
    for s in range(len(bounds) - 1):
        near = np.empty((bounds[s + 1] - bounds[s], 2), np.float32)
        count, length = 0, 0.0
        for i in range(bounds[s], bounds[s + 1]):
            dx, dy = points[i, 0] - origins[s, 0], points[i, 1] - origins[s, 1]
            if dx * dx + dy * dy < settings[0] * settings[0]:  # also drops NaN
                near[count, 0], near[count, 1] = points[i, 0], points[i, 1]
                if count > 0:
                    dx = near[count, 0] - near[count - 1, 0]
                    dy = near[count, 1] - near[count - 1, 1]
                    length += min(np.sqrt(dx * dx + dy * dy), 0.5)
                count += 1
        spacing = max(settings[1], length / settings[2])
        kept = prepare_points(
            near[:count], origins[s], increments[s], spacing, settings[3], out[out_bounds[s] :]
        )
        out_bounds[s + 1] = out_bounds[s] + kept
