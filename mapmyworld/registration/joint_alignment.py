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
from scipy.sparse.linalg import SuperLU, splu

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
    enough: float = 0.0,
) -> JointAlignment:
    """Poses (S, 3) that fit the `pairs` (P, 2) of scans and the motions best; the first stays.

    One round a reach: the distance (m) within which points are associated; none after a round
    that moved the scans by less than `enough` metres.
    """
    poses = np.array(poses, np.float64)
    systems = np.zeros((len(pairs), 12))
    moved: list[float] = []
    factors, factored = None, 0.0
    for reach in reaches:
        _associate(scans, poses, pairs, reach, config, threads, systems)
        equations = _equations(poses, pairs, systems, motions, config)
        if factors is None or reach != factored:
            # Rounds of the same reach differ little: the last factors do for them.
            factors, factored = _factorise(equations, len(poses)), reach
        step = _step(equations, factors, len(poses))
        poses = compose_planar(poses, step)
        moved.append(float(np.sqrt(np.mean(np.sum(step[:, :2] ** 2, axis=1)))))
        if moved[-1] < enough:
            break
    weights = max(float(systems[:, 9].sum()), 1e-9)
    return JointAlignment(
        poses, tuple(moved), float(np.sqrt(systems[:, 10].sum() / weights)), systems
    )


def _associate(
    scans: ScanSet, poses: Array, pairs: NDArray[np.int64], reach: float,
    config: RegistrationConfig, threads: int, systems: Array,
) -> None:  # fmt: skip
    """Fills `systems` (P, 12) with the normal equations of all pairs at `poses`."""
    scale = max(config.residual_scale, 0.25 * reach)

    def work(first: int, last: int) -> None:
        pair_systems(
            first, last, scans.rows, scans.bounds, scans.origins, pairs, poses, reach, scale,
            systems,
        )  # fmt: skip

    run_in_chunks(work, len(pairs), threads)


def adjoint_planar(a_from_b: Array) -> Array:
    """(..., 3, 3): `a_from_b * exp(t) == exp(adjoint t) * a_from_b`."""
    c, s = np.cos(a_from_b[..., 2]), np.sin(a_from_b[..., 2])
    result = np.zeros((*a_from_b.shape[:-1], 3, 3))
    result[..., 0, 0], result[..., 0, 1], result[..., 0, 2] = c, -s, a_from_b[..., 1]
    result[..., 1, 0], result[..., 1, 1], result[..., 1, 2] = s, c, -a_from_b[..., 0]
    result[..., 2, 2] = 1.0
    return result


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Normal equations of all pairs and motions, each for a perturbation of its head."""

    tails: NDArray[np.int64]
    heads: NDArray[np.int64]
    hessians: Array
    """(K, 3, 3)."""
    gradients: Array
    """(K, 3)."""
    towards: Array
    """(K, 3, 3) what a perturbation of the tail is to the head."""


def _equations(
    poses: Array, pairs: NDArray[np.int64], systems: Array, motions: Motions,
    config: RegistrationConfig,
) -> _Equations:  # fmt: skip
    sigma_squared = config.range_sigma**2 * config.correlation * 2.0
    error = between_planar(
        motions.tail_from_head, between_planar(poses[motions.tails], poses[motions.heads])
    )
    tails = np.concatenate([pairs[:, 0], motions.tails])
    heads = np.concatenate([pairs[:, 1], motions.heads])
    pulls = np.einsum("kij,kj->ki", motions.information, error)
    return _Equations(
        tails,
        heads,
        np.concatenate([systems[:, _UPPER] / sigma_squared, motions.information]),
        np.concatenate([systems[:, 6:9] / sigma_squared, pulls]),
        -adjoint_planar(between_planar(poses[heads], poses[tails])),
    )


def _factorise(equations: _Equations, count: int) -> SuperLU:
    """The sparse system (3 S, 3 S) of all scans, factorised; the first scan is held."""
    tails, heads, hessians = equations.tails, equations.heads, equations.hessians
    at_tail = np.swapaxes(equations.towards, 1, 2)
    across = hessians @ equations.towards
    values = np.concatenate([hessians, at_tail @ across, np.swapaxes(across, 1, 2), across])
    rows = np.concatenate([heads, tails, tails, heads])
    columns = np.concatenate([heads, tails, heads, tails])
    row = rows[:, None, None] * 3 + np.arange(3)[:, None] + np.zeros(3, np.int64)
    column = columns[:, None, None] * 3 + np.arange(3) + np.zeros((3, 1), np.int64)
    damping = np.full(3 * count, 1e-3)
    damping[:3] = 1e9
    every = np.arange(3 * count)
    matrix = coo_array(
        (
            np.concatenate([values.ravel(), damping]),
            (np.concatenate([row.ravel(), every]), np.concatenate([column.ravel(), every])),
        ),
        shape=(3 * count, 3 * count),
    ).tocsc()
    return splu(
        matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )


def _step(equations: _Equations, factors: SuperLU, count: int) -> Array:
    """One Gauss-Newton step (S, 3) of all scans."""
    right = np.zeros((count, 3))
    np.add.at(right, equations.heads, -equations.gradients)
    back = np.einsum("kji,kj->ki", equations.towards, equations.gradients)
    np.add.at(right, equations.tails, -back)
    step = np.asarray(factors.solve(right.ravel())).reshape(-1, 3)
    step[:, :2] = np.clip(step[:, :2], -_LONGEST, _LONGEST)
    step[:, 2] = np.clip(wrap_angle(step[:, 2]), -_LONGEST, _LONGEST)
    return step
