"""Many scans aligned with each other at once: all pairs' normal equations in one sparse system.

Lu and Milios, "Globally consistent range scan alignment for environment mapping", Autonomous
Robots 4, 1997, with point-to-line residuals that are associated anew in every round.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import RegistrationConfig
from mapmyworld.geometry.planar import compose_planar
from mapmyworld.kernels.scan_alignment import pair_systems
from mapmyworld.parallel import run_in_chunks
from mapmyworld.registration.joint_equations import Motions, equations_of, factors_of, step_of
from mapmyworld.registration.scan_matching import ScanSet

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class JointAlignment:
    """What the joint alignment came to."""

    poses: Array
    """(S, 3)."""
    moved: tuple[float, ...]
    """Root mean square movement of the scans in each round, metres."""
    residual: float
    """Root mean square distance between a point and the other scan's line, metres."""


def align_jointly(
    scans: ScanSet,
    poses: Array,
    pairs: NDArray[np.int64],
    motions: Motions,
    max_distances: Sequence[float],
    config: RegistrationConfig,
    threads: int,
    enough: float = 0.0,
    held: NDArray[np.bool_] | None = None,
) -> JointAlignment:
    """Poses (S, 3) that fit the `pairs` (P, 2) of scans and the motions best.

    One round a reach: the distance (m) within which points are associated; none after a round
    that moved the scans by less than `enough` metres. Scans that are `held` (S,) stay where they
    are, the first one if none is said to.
    """
    poses = np.array(poses, np.float64)
    held = np.arange(len(poses)) == 0 if held is None else held
    systems = np.zeros((len(pairs), 12))
    moved: list[float] = []
    factors, factored = None, 0.0
    for reach in max_distances:
        if reach != factored:
            factors = None  # large, and gone before the next ones are made
        _associate(scans, poses, pairs, reach, config, threads, systems)
        equations = equations_of(poses, pairs, systems, motions, config)
        is_old = factors is not None
        if factors is None:
            # Rounds of the same reach differ little: the last factors do for them.
            factors, factored = factors_of(equations, held), reach
        step = step_of(equations, factors, held)
        if is_old and _length(step, held) >= moved[-1]:
            # Of few points, some that joined or left change much: old factors overshoot.
            factors = None  # gone before the new ones are made
            factors = factors_of(equations, held)
            step = step_of(equations, factors, held)
        del equations
        poses = compose_planar(poses, step)
        moved.append(_length(step, held))
        if moved[-1] < enough:
            break
    weights = max(float(systems[:, 9].sum()), 1e-9)
    residual = float(np.sqrt(systems[:, 10].sum() / weights))
    return JointAlignment(poses, tuple(moved), residual)


def _length(step: Array, held: NDArray[np.bool_]) -> float:
    """Root mean square (m) by which a step (S, 3) moves the scans that are not held."""
    squares = np.sum(step[~held, :2] ** 2, axis=1)
    return float(np.sqrt(squares.sum() / max(len(squares), 1)))


def _associate(
    scans: ScanSet, poses: Array, pairs: NDArray[np.int64], reach: float,
    config: RegistrationConfig, threads: int, systems: Array,
) -> None:  # fmt: skip
    """Fills `systems` (P, 12) with the normal equations of all pairs at `poses`."""
    scale = config.residual_share * reach

    def work(first: int, last: int) -> None:
        pair_systems(
            first, last, scans.rows, scans.bounds, scans.origins, pairs, poses, reach, scale,
            systems,
        )  # fmt: skip

    run_in_chunks(work, len(pairs), threads)
