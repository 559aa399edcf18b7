"""Lines through a point of a scan and its neighbours, of both sides or of one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit

_STRAIGHT = 9.0  # times its variance across a line, that along it is at least
_THIN = 0.01  # m across a line up to which both sides are one surface; or what noise explains


class Sums(NamedTuple):
    """A point's neighbours to one side, seen from it."""

    members: float
    x: float
    y: float
    xx: float
    xy: float
    yy: float


class Line(NamedTuple):
    """Points about their line of least squares."""

    across: float
    along: float
    """Variances, m^2; infinite across where the points are too few."""
    normal_x: float
    normal_y: float
    centre_x: float
    centre_y: float
    """m, seen from the point that the line is for."""
    points: float
    """How many they are."""


@inner_jit
def side_sums(
    xs: NDArray[np.float64],
    ys: NDArray[np.float64],
    steps: NDArray[np.float64],
    i: int,
    side: int,
    reach: float,
    gap: float,
) -> Sums:
    """The neighbours of point i on the `side` (-1, 1) within `reach`, up to the first `gap`.

    The next one counts however far it is. Points are at `xs`, `ys` (N,), with `steps` (N,) as the
    distances to the point before; all in m.
    """
    n, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    k = i + side
    while 0 <= k < len(xs):
        dx, dy = xs[k] - xs[i], ys[k] - ys[i]
        far = dx * dx + dy * dy > reach * reach and abs(k - i) > 1
        if far or steps[max(k, k - side)] > gap:
            break
        n += 1.0
        sx, sy = sx + dx, sy + dy
        sxx, sxy, syy = sxx + dx * dx, sxy + dx * dy, syy + dy * dy
        k += side
    return Sums(n, sx, sy, sxx, sxy, syy)


@inner_jit
def surface_line(before: Sums, after: Sums, x: float, y: float, noise: float) -> Line:
    """The line of the surface that the point at (x, y) from the lidar is on.

    Where both sides do not lie on one line, as noise in the range would let them, they may be two
    surfaces, such as a wall and the recess of its door: then it is the side that does. If both
    do, it is a corner. A line through one neighbour a side indicates nothing then.
    """
    line = _fitted(before, after)
    slant = abs(line.normal_x * x + line.normal_y * y) / np.sqrt(x * x + y * y)
    thin = max(_THIN, 2.0 * noise * slant)
    if not line.across > thin * thin:
        return line
    nothing = Sums(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    one, other = _fitted(before, nothing), _fitted(nothing, after)
    if is_line(one, thin) != is_line(other, thin):
        return one if is_line(one, thin) else other
    return line if max(before.members, after.members) > 1.0 else _fitted(nothing, nothing)


@inner_jit
def is_line(line: Line, thickest: float) -> bool:
    """Whether the points stand off their line by `thickest` metres at most, root mean square."""
    return line.along > _STRAIGHT * line.across and line.across < thickest * thickest


@inner_jit
def direction_variance(line: Line, noise: float) -> float:
    """Variance (rad^2) of a line's direction: its points err by `noise` (m) across, or by more."""
    across = max(line.across, noise * noise)
    return across / ((line.points - 2.0) * line.along)


@inner_jit
def _fitted(before: Sums, after: Sums) -> Line:
    n = 1.0 + before.members + after.members
    if n < 3.0:
        return Line(np.inf, 0.0, 0.0, 0.0, 0.0, 0.0, n)
    mx, my = (before.x + after.x) / n, (before.y + after.y) / n
    cxx = (before.xx + after.xx) / n - mx * mx
    cxy = (before.xy + after.xy) / n - mx * my
    cyy = (before.yy + after.yy) / n - my * my
    half, root = 0.5 * (cxx + cyy), np.hypot(0.5 * (cxx - cyy), cxy)
    angle = 0.5 * np.arctan2(2.0 * cxy, cxx - cyy) + 0.5 * np.pi
    return Line(max(half - root, 0.0), half + root, np.cos(angle), np.sin(angle), mx, my, n)
