"""The normal equations of many scans, of their pairs and of motions between them, and one step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.backend.block_matrix import Blocks, metis_order_of, place_in
from mapmyworld.backend.information import Factorised
from mapmyworld.config import RegistrationConfig
from mapmyworld.geometry.planar import between_planar, planar_adjoint, wrap_angle

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_UPPER = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
_DAMPING = 1e-3  # information that every scan has of where it is, so that none is undetermined
_LONGEST = 0.5  # m (and rad) that a scan moves in one round at most


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """Measured motions from scan `tails[k]` to scan `heads[k]`."""

    tails: Index
    heads: Index
    tail_from_head: Array
    """(M, 3)."""
    information: Array
    """(M, 3, 3) of the right perturbation."""


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """Normal equations of all pairs and motions, each for a perturbation of its head."""

    tails: Index
    heads: Index
    hessians: Array
    """(K, 3, 3)."""
    gradients: Array
    """(K, 3)."""
    towards: Array
    """(K, 3, 3) what a perturbation of the tail is to the head."""


def equations_of(
    poses: Array, pairs: Index, systems: Array, motions: Motions, config: RegistrationConfig
) -> Equations:
    """The equations at `poses` of pairs with their `systems` (P, 12), and of the motions."""
    sigma_squared = config.range_sigma**2 * config.correlation * 2.0
    error = between_planar(
        motions.tail_from_head, between_planar(poses[motions.tails], poses[motions.heads])
    )
    tails = np.concatenate([pairs[:, 0], motions.tails])
    heads = np.concatenate([pairs[:, 1], motions.heads])
    pulls = np.einsum("kij,kj->ki", motions.information, error)
    return Equations(
        tails,
        heads,
        np.concatenate([systems[:, _UPPER] / sigma_squared, motions.information]),
        np.concatenate([systems[:, 6:9] / sigma_squared, pulls]),
        -planar_adjoint(between_planar(poses[heads], poses[tails])),
    )


def factors_of(equations: Equations, held: NDArray[np.bool_]) -> Factorised:
    """The factorised system over all scans (S,); those that are held link to none."""
    free = ~(held[equations.tails] | held[equations.heads])
    order = metis_order_of(len(held), equations.tails[free], equations.heads[free])
    return _matrix_of(equations, held, place_in(order)).factorised(order)


def _matrix_of(equations: Equations, held: NDArray[np.bool_], place: Index) -> Blocks:
    """The matrix of the system, each scan in its `place` (S,)."""
    tails, heads, hessians = equations.tails, equations.heads, equations.hessians
    free, count = ~(held[tails] | held[heads]), len(held)
    across = hessians @ equations.towards
    at_tail = np.swapaxes(equations.towards, 1, 2) @ across
    own = np.where(held, 1.0, _DAMPING)[:, None, None] * np.eye(3)
    ends = np.concatenate([heads[~held[heads]], tails[~held[tails]], np.arange(count)])
    blocks = np.concatenate([hessians[~held[heads]], at_tail[~held[tails]], own])
    rows = np.concatenate([ends, heads[free], tails[free]])
    columns = np.concatenate([ends, tails[free], heads[free]])
    links = [across[free], np.swapaxes(across[free], 1, 2)]
    return Blocks.summed(count, place[rows], place[columns], np.concatenate([blocks, *links]))


def step_of(equations: Equations, factors: Factorised, held: NDArray[np.bool_]) -> Array:
    """One Gauss-Newton step (S, 3) of all scans; none of those that are held."""
    back = np.einsum("kji,kj->ki", equations.towards, equations.gradients)
    pulls = np.concatenate([equations.gradients, back])
    ends = np.concatenate([equations.heads, equations.tails])
    right = -np.stack(list(_sums(ends, pulls, len(held))), axis=-1)
    right[held] = 0.0
    step = factors.solve(right.ravel()).reshape(-1, 3)
    step[:, :2] = np.clip(step[:, :2], -_LONGEST, _LONGEST)
    step[:, 2] = np.clip(wrap_angle(step[:, 2]), -_LONGEST, _LONGEST)
    return np.asarray(step)


def _sums(ends: Index, pulls: Array, count: int) -> Iterator[Array]:
    for column in pulls.T:
        yield np.asarray(np.bincount(ends, column, minlength=count), np.float64)
