"""A system's linear equations at a point: assembled block by block, factorised and solved.

Blocks stand over all nodes; a node that stays has the identity and no links, so that all who work
on the same edges eliminate the same pattern.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from types import ModuleType

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.graph.block_solver import Solver, solver_of
from mapmyworld.graph.cholesky import Factors, factorise
from mapmyworld.graph.elimination import analyse, links
from mapmyworld.graph.pose_graph import Index
from mapmyworld.graph.system import System, jacobians_of, residuals_of


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """Where edges add to the symmetric matrix; depends on the edges alone."""

    nodes: int
    rows: Index
    columns: Index
    """(B,) nodes of the blocks: every node's diagonal first."""
    between: Index
    """(E,) the block of both ends of each edge."""


def pattern_of(system: System) -> Pattern:
    """The pattern of the system's matrix."""
    count = len(system.free)
    return Pattern(count, *links(count, system.tails, system.heads))


def linearise(
    system: System,
    pattern: Pattern,
    poses: Array,
    weights: Array | None = None,
    residuals: Array | None = None,
) -> tuple[Array, Array]:
    """Blocks (B, d, d) of the matrix and gradient (N, d) of half the cost at `poses`.

    `weights` (E,) scale information; `residuals` (E, d) are those at `poses`, where known.
    """
    residuals = residuals_of(system, poses) if residuals is None else residuals
    size = system.dimension
    blocks = np.zeros((len(pattern.rows), size, size))
    return blocks, _added(system, pattern, poses, residuals, blocks, weights)


def gradient_of(system: System, pattern: Pattern, poses: Array, residuals: Array) -> Array:
    """(N, d) of half the cost at `poses`, where edges have these residuals (E, d)."""
    return _added(system, pattern, poses, residuals, np.empty((0, 1, 1)))


def _added(
    system: System,
    pattern: Pattern,
    poses: Array,
    residuals: Array,
    blocks: Array,
    weights: Array | None = None,
) -> Array:
    """The gradient (N, d); what edges add to the blocks is added to these."""
    gradient = np.zeros((len(system.free), system.dimension))
    _kernels().add_edges(
        system.tails,
        system.heads,
        pattern.between,
        system.free,
        *jacobians_of(system, poses, residuals),
        np.ascontiguousarray(system.information, np.float64),
        residuals,
        np.empty(0) if weights is None else weights,
        blocks,
        gradient,
    )
    return gradient


@cache
def _kernels() -> ModuleType:
    from mapmyworld.kernels import normal_equations

    return normal_equations


def damped(pattern: Pattern, blocks: Array, damping: float) -> Array:
    """The blocks with so much of the diagonal on top of it."""
    if damping == 0.0:
        return blocks
    raised, inner = blocks.copy(), np.arange(blocks.shape[1])
    raised[: pattern.nodes, inner, inner] *= 1.0 + damping
    return raised


def factorised(pattern: Pattern, blocks: Array) -> Solver:
    """These equations, ready to be solved for any right-hand side (N * d,).

    Raises `NotPositiveDefiniteError` when the edges leave nodes undetermined.
    """
    return solver_of(pattern.nodes, pattern.rows, pattern.columns, blocks)


def information_factors(system: System, poses: Array) -> Factors:
    """The Cholesky factors of the information at `poses`, over all nodes.

    Those that stay count as known to one unit. Raises `NotPositiveDefiniteError` where the edges
    leave a node undetermined.
    """
    pattern = pattern_of(system)
    symbolic = analyse(pattern.nodes, pattern.rows, pattern.columns, system.dimension)
    return factorise(symbolic, linearise(system, pattern, poses)[0])
