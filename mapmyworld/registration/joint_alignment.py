"""Many scans aligned with each other at once: all pairs' normal equations in one sparse system.

Lu and Milios, "Globally consistent range scan alignment for environment mapping", Autonomous
Robots 4, 1997, with point-to-line residuals that are associated anew in every round.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu

from mapmyworld.config import RegistrationConfig
from mapmyworld.geometry import between_planar, compose_planar, wrap_angle
from mapmyworld.kernels.scan_alignment import pair_systems
from mapmyworld.registration.scan_matching import ScanSet
from mapmyworld.registration.threads import run_in_chunks

Array = NDArray[np.float64]
_UPPER = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
_LONGEST = 0.5  # m (and rad) that a scan moves in one round at most


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """Measured motions from scan `tails[k]` to scan `heads[k]`."""

    tails: NDArray[np.int64]
    heads: NDArray[np.int64]
    tail_from_head: Array
    """(M, 3)."""
    information: Array
    """(M, 3, 3) of the right perturbation."""


@dataclass(frozen=True, slots=True, eq=False)
class JointAlignment:
    """What the joint alignment came to."""

    poses: Array
    """(S, 3)."""
    moved: tuple[float, ...]
    """Root mean square movement of the scans in each round, metres."""
    residual: float
    """Root mean square distance between a point and the other scan's line, metres."""
    systems: Array
    """(P, 12) the pairs' normal equations in the last round."""


def align_jointly(
    scans: ScanSet,
    poses: Array,
    pairs: NDArray[np.int64],
    motions: Motions,
    reaches: Sequence[float],
    config: RegistrationConfig,
    threads: int,
) -> JointAlignment:
    """Poses (S, 3) that fit the `pairs` (P, 2) of scans and the motions best; the first stays.

    One round a reach: the distance (m) within which points are associated.
    """
    poses = np.array(poses, np.float64)
    systems = np.zeros((len(pairs), 12))
    moved: list[float] = []
    for reach in reaches:
        scale = max(config.residual_scale, 0.25 * reach)

        def work(
            first: int, last: int, reach: float = reach, scale: float = scale, at: Array = poses
        ) -> None:
            pair_systems(
                first, last, scans.rows, scans.bounds, scans.origins, pairs, at, reach, scale,
                systems,
            )  # fmt: skip

        run_in_chunks(work, len(pairs), threads)
        step = _solve(poses, pairs, systems, motions, config)
        poses = compose_planar(poses, step)
        moved.append(float(np.sqrt(np.mean(np.sum(step[:, :2] ** 2, axis=1)))))
    weights = max(float(systems[:, 9].sum()), 1e-9)
    return JointAlignment(
        poses, tuple(moved), float(np.sqrt(systems[:, 10].sum() / weights)), systems
    )


def adjoint_planar(a_from_b: Array) -> Array:
    """(..., 3, 3): `a_from_b * exp(t) == exp(adjoint t) * a_from_b`."""
    c, s = np.cos(a_from_b[..., 2]), np.sin(a_from_b[..., 2])
    result = np.zeros((*a_from_b.shape[:-1], 3, 3))
    result[..., 0, 0], result[..., 0, 1], result[..., 0, 2] = c, -s, a_from_b[..., 1]
    result[..., 1, 0], result[..., 1, 1], result[..., 1, 2] = s, c, -a_from_b[..., 0]
    result[..., 2, 2] = 1.0
    return result


def _solve(
    poses: Array, pairs: NDArray[np.int64], systems: Array, motions: Motions,
    config: RegistrationConfig,
) -> Array:  # fmt: skip
    """One Gauss-Newton step (S, 3) of all scans."""
    sigma_squared = config.range_sigma**2 * config.correlation * 2.0
    hessians = systems[:, _UPPER] / sigma_squared
    gradients = systems[:, 6:9] / sigma_squared
    error = between_planar(
        motions.tail_from_head, between_planar(poses[motions.tails], poses[motions.heads])
    )
    tails = np.concatenate([pairs[:, 0], motions.tails])
    heads = np.concatenate([pairs[:, 1], motions.heads])
    hessians = np.concatenate([hessians, motions.information])
    pulls = np.einsum("kij,kj->ki", motions.information, error)
    gradients = np.concatenate([gradients, pulls])
    towards = -adjoint_planar(between_planar(poses[heads], poses[tails]))
    at_tail = np.swapaxes(towards, 1, 2)
    blocks = [hessians, at_tail @ hessians @ towards, at_tail @ hessians, hessians @ towards]
    rows = [heads, tails, tails, heads]
    columns = [heads, tails, heads, tails]
    count = len(poses)
    right = np.zeros((count, 3))
    np.add.at(right, heads, -gradients)
    np.add.at(right, tails, -np.einsum("kij,kj->ki", at_tail, gradients))
    step = _sparse_solve(count, rows, columns, blocks, right)
    step[:, :2] = np.clip(step[:, :2], -_LONGEST, _LONGEST)
    step[:, 2] = np.clip(wrap_angle(step[:, 2]), -_LONGEST, _LONGEST)
    return step


def _sparse_solve(
    count: int,
    rows: list[NDArray[np.int64]],
    columns: list[NDArray[np.int64]],
    blocks: list[Array],
    right: Array,
) -> Array:
    row = np.concatenate(rows)[:, None, None] * 3 + np.arange(3)[:, None] + np.zeros(3, np.int64)
    column = np.concatenate(columns)[:, None, None] * 3 + np.arange(3) + np.zeros((3, 1), np.int64)
    values = np.concatenate(blocks)
    anchor = np.arange(3)
    damping = np.full(3 * count, 1e-3)
    damping[anchor] = 1e9
    every = np.arange(3 * count)
    matrix = coo_array(
        (
            np.concatenate([values.ravel(), damping]),
            (np.concatenate([row.ravel(), every]), np.concatenate([column.ravel(), every])),
        ),
        shape=(3 * count, 3 * count),
    ).tocsc()
    factors = splu(
        matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    return np.asarray(factors.solve(right.ravel())).reshape(-1, 3)
