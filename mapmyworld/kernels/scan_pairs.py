"""Normal equations of pairs of scans, both ways, for many scans that are aligned at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit
from mapmyworld.kernels.planar_algebra import adjoint_of_inverse, relative
from mapmyworld.kernels.scan_alignment import Rows, add_target


@jit
def pair_systems(
    first: int,
    last: int,
    rows: Rows,
    bounds: NDArray[np.int64],
    origins: NDArray[np.float64],
    pairs: NDArray[np.int64],
    poses: NDArray[np.float64],
    reach: float,
    scale: float,
    out: NDArray[np.float64],
) -> None:
    """Normal equations `out` (P, 15) of pairs (P, 2), target and source, `first` to `last`.

    Scan k is `rows[bounds[k]:bounds[k + 1]]`; `rows` (N, 6), `bounds` (S + 1,); its lidar was at
    `origins` (S, 2) in the frame of its pose, of `poses` (S, 3). Scans are compared both ways, so
    that a pair is the same seen from either end; everything is expressed for a perturbation of the
    source. What errors of normals add (the last three) is not taken off.
    """
    back, adjoint = np.zeros(15), np.empty((3, 3))
    hit = np.zeros(np.max(np.diff(bounds)), np.bool_)
    for k in range(first, last):
        t, s = pairs[k, 0], pairs[k, 1]
        out[k] = 0.0
        add_target(rows, bounds[s], bounds[s + 1], rows, bounds[t], bounds[t + 1], origins[t],
                   relative(poses[t], poses[s]), reach, scale, out[k], hit)  # fmt: skip
        back[:] = 0.0
        turned = relative(poses[s], poses[t])
        add_target(rows, bounds[t], bounds[t + 1], rows, bounds[s], bounds[s + 1], origins[s],
                   turned, reach, scale, back, hit)  # fmt: skip
        adjoint_of_inverse(turned, adjoint)
        add_seen_from_target(back, adjoint, out[k])


@inner_jit
def add_seen_from_target(
    back: NDArray[np.float64], adjoint: NDArray[np.float64], system: NDArray[np.float64]
) -> None:
    """Adds normal equations for the target's perturbation to those for the source's, (15,) both.

    A perturbation d of the source moves the target by -A d, A the adjoint (3, 3) of
    target_from_source: rel exp(d) inverted is exp(-d) rel^-1 = rel^-1 exp(-A d).
    """
    slot = 0
    for i in range(3):
        for m in range(3):
            system[6 + i] -= adjoint[m, i] * back[6 + m]
        for j in range(i, 3):
            total = 0.0
            for m in range(3):
                for n in range(3):
                    upper = min(m, n) * (5 - min(m, n)) // 2 + max(m, n)
                    total += adjoint[m, i] * back[upper] * adjoint[n, j]
            system[slot] += total
            slot += 1
    for m in range(9, 12):
        system[m] += back[m]
    c, sine, xx, xy, yy = adjoint[0, 0], adjoint[1, 0], back[12], back[13], back[14]
    system[12] += c * c * xx + 2.0 * c * sine * xy + sine * sine * yy
    system[13] += (c * c - sine * sine) * xy + c * sine * (yy - xx)
    system[14] += sine * sine * xx - 2.0 * c * sine * xy + c * c * yy
