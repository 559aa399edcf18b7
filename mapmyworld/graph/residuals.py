"""Residuals of a pose graph's edges and their derivatives, for all of them at once.

An edge's residual is `log(measured^-1 * between(from, to))`: (E, 3) over x, y, yaw in a planar
graph, else (E, 6), rotation first; the same as gtsam's factors. Half the sum of their squared
sigmas is the graph's cost. Formulas: Sola, Deray, Atchuthan, "A micro Lie theory" (2018).
"""

from __future__ import annotations

from functools import cache
from types import ModuleType

import numpy as np
from scipy.special import gammaincinv

from mapmyworld.geometry import Array
from mapmyworld.graph.pose_graph import Index


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
    """Poses moved by tangents (N, 3 or 6) in their own frames."""
    found, kernels = np.zeros(poses.shape), _moves()
    kernel = kernels.planar_moved if planar else kernels.spatial_moved
    kernel(_plain(poses), _plain(tangents), found)
    return found


@cache
def _moves() -> ModuleType:
    from mapmyworld.kernels import pose_moves

    return pose_moves


def edge_fits(
    planar: bool, poses: Array, tails: Index, heads: Index, measured: Array, information: Array
) -> tuple[Array, Array]:
    """Residuals (E, 3 or 6) of motions measured between poses, and squared sigmas (E,) of those.

    Squared sigmas are set for as many edges as information (E, d, d) is given of.
    """
    residuals, squares = np.empty((len(tails), 3 if planar else 6)), np.empty(len(tails))
    kernel = _edges().planar_residuals if planar else _edges().spatial_residuals
    measurements = _plain(measured), _plain(information)
    kernel(_plain(poses), tails, heads, *measurements, residuals, squares)
    return residuals, squares


def edge_residuals(
    planar: bool, map_from_tail: Array, map_from_head: Array, measured: Array
) -> Array:
    """Residuals (E, 3 or 6) of measured motions between pairs of poses."""
    tails, heads = np.arange(2 * len(measured)).reshape(2, -1)
    poses = np.concatenate([map_from_tail, map_from_head])
    return edge_fits(planar, poses, tails, heads, measured, np.empty((0, 1, 1)))[0]


def edge_jacobians(
    planar: bool, poses: Array, tails: Index, heads: Index, residuals: Array
) -> tuple[Array, Array]:
    """Derivatives (E, d, d) of residuals by tangents of the tail and of the head."""
    shape = (*residuals.shape, residuals.shape[1])
    by_tail, by_head = np.zeros(shape), np.zeros(shape)
    kernel = _edges().planar_jacobians if planar else _edges().spatial_jacobians
    kernel(_plain(poses), tails, heads, _plain(residuals), by_tail, by_head)
    return by_tail, by_head


@cache
def _edges() -> ModuleType:
    from mapmyworld.kernels import pose_edges

    return pose_edges


def _plain(array: Array) -> Array:
    """The array as kernels take it."""
    return np.ascontiguousarray(array, np.float64)


def chi_squared_quantile(probability: float, freedom: Array | int) -> Array:
    """What chi-squared stays below; importing `scipy.stats` for it takes 0.8 s."""
    return np.asarray(2.0 * gammaincinv(0.5 * freedom, probability))


def squared_sigmas(residuals: Array, information: Array) -> Array:
    """(E,) chi-squared values `r' I r`."""
    return np.asarray(
        np.einsum("ei,ei->e", residuals, np.einsum("eij,ej->ei", information, residuals))
    )
