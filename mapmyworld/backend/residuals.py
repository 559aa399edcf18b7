"""Residuals of a pose graph's edges, for all of them at once.

An edge's residual is `log(measured^-1 * between(from, to))`: (E, 3) over x, y, yaw in a planar
graph, else (E, 6), rotation first; the same as gtsam's factors. Half the sum of their squared
sigmas is the graph's cost. Formulas: Sola, Deray, Atchuthan, "A micro Lie theory" (2018).
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar, compose_planar
from mapmyworld.geometry.rigid import between, se3_exp, se3_log


def planar_log(motion: Array) -> Array:
    """Tangents (..., 3) of planar motions (..., 3): the constant twist that yields them."""
    yaw = motion[..., 2]
    half = 0.5 * yaw
    small = np.abs(yaw) < 1e-5
    safe = np.where(small, 1.0, half)
    factor = np.where(small, 1.0 - half * half / 3.0, safe / np.tan(safe))
    x, y = motion[..., 0], motion[..., 1]
    return np.stack([factor * x + half * y, factor * y - half * x, yaw], axis=-1)


def planar_exp(tangent: Array) -> Array:
    """Planar motions (..., 3) of tangents (..., 3)."""
    yaw = tangent[..., 2]
    small = np.abs(yaw) < 1e-5
    safe = np.where(small, 1.0, yaw)
    along = np.where(small, 1.0 - yaw * yaw / 6.0, np.sin(safe) / safe)
    across = np.where(small, 0.5 * yaw, (1.0 - np.cos(safe)) / safe)
    x, y = tangent[..., 0], tangent[..., 1]
    return np.stack([along * x - across * y, across * x + along * y, yaw], axis=-1)


def retract(planar: bool, poses: Array, tangents: Array) -> Array:
    """Poses (N, 3 or 4, 4) moved by tangents (N, 3 or 6) in their own frames, in the same shape."""
    if planar:
        return compose_planar(poses, planar_exp(tangents))
    return np.asarray(poses @ se3_exp(tangents))


def edge_residuals(
    planar: bool, map_from_tail: Array, map_from_head: Array, measured: Array
) -> Array:
    """Residuals (E, 3 or 6), m and rad, of the motions `measured` between pairs of poses.

    `map_from_tail`, `map_from_head` and `measured`, tail_from_head, are (E, 3 or 4, 4) each.
    """
    if planar:
        return planar_log(between_planar(measured, between_planar(map_from_tail, map_from_head)))
    return se3_log(between(measured, between(map_from_tail, map_from_head)))


def chi_squared_quantile(probability: float, freedom: Array | int) -> Array:
    """(...) what chi-squared of this `freedom` (...) stays below with this probability.

    By the inverse of the incomplete gamma function; importing `scipy.stats` for it takes 0.8 s.
    """
    return np.asarray(2.0 * gammaincinv(0.5 * freedom, probability))


def squared_sigmas(residuals: Array, information: Array) -> Array:
    """(E,) chi-squared values `r' I r` of residuals (E, d) and information (E, d, d)."""
    return np.asarray(
        np.einsum("ei,ei->e", residuals, np.einsum("eij,ej->ei", information, residuals))
    )
