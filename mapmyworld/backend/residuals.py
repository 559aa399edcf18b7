"""Residuals of a pose graph's edges, for all of them at once.

An edge's residual is `log(measured^-1 * between(from, to))`: (E, 3) over x, y, yaw in a planar
graph, else (E, 6), rotation first; the same as gtsam's factors. Half the sum of their squared
sigmas is the graph's cost. Formulas: Sola, Deray, Atchuthan, "A micro Lie theory" (2018).
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar, compose_planar, planar_exp, planar_log
from mapmyworld.geometry.rigid import between, se3_exp, se3_log


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
