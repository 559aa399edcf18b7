"""Residuals of a pose graph's edges, for all of them at once; the same as gtsam's factors.

An edge's residual is `log(measured^-1 * between(from, to))`: (E, 3) over x, y, yaw in a planar
graph, else (E, 6), rotation first. Half the sum of their squared sigmas is the graph's cost.
"""

from __future__ import annotations

import numpy as np

from mapmyworld.geometry import Array, between, between_planar, se3_log


def planar_log(motion: Array) -> Array:
    """Tangents (..., 3) of planar motions (..., 3): the constant twist that yields them."""
    yaw = motion[..., 2]
    half = 0.5 * yaw
    small = np.abs(yaw) < 1e-5
    safe = np.where(small, 1.0, half)
    factor = np.where(small, 1.0 - half * half / 3.0, safe / np.tan(safe))
    x, y = motion[..., 0], motion[..., 1]
    return np.stack([factor * x + half * y, factor * y - half * x, yaw], axis=-1)


def edge_residuals(
    planar: bool, map_from_tail: Array, map_from_head: Array, measured: Array
) -> Array:
    """Residuals (E, 3 or 6) of measured motions between pairs of poses."""
    if planar:
        return planar_log(between_planar(measured, between_planar(map_from_tail, map_from_head)))
    return se3_log(between(measured, between(map_from_tail, map_from_head)))


def squared_sigmas(residuals: Array, information: Array) -> Array:
    """(E,) chi-squared values `r' I r`."""
    return np.asarray(np.einsum("ei,eij,ej->e", residuals, information, residuals))
