"""Newton's method on a twin, in the world's own dimensions or in more."""

from __future__ import annotations

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.graph.block_solver import solver_of
from mapmyworld.graph.cholesky import NotPositiveDefiniteError
from mapmyworld.graph.twin import Twin


def hessian_blocks(twin: Twin, blocks: Array, bases: Array) -> Array:
    """Half the Hessian's blocks (B, m, m) along tangents (N, m, p, d + 1), of those of S."""
    flat = bases.reshape(*bases.shape[:2], -1)
    left = (bases[twin.rows] @ blocks[:, None]).reshape(len(blocks), *flat.shape[1:])
    return np.asarray(left @ np.swapaxes(flat[twin.columns], 1, 2))


def newton_step(
    twin: Twin,
    gradient: Array,
    hessian: Array,
    damping: float,
    floor: float,
    extra: int = 0,
) -> Array | None:
    """Newton's step (N, m), damped by shares of the diagonal; None where it has no minimum.

    `damping` is one of a number's own diagonal, `floor` of the largest; `extra` counts the
    dimensions that poses have beyond the world's.
    """
    nodes, inner = len(gradient), np.arange(gradient.shape[1])
    diagonal = np.abs(hessian[:nodes, inner, inner])
    blocks = hessian.copy()
    largest = diagonal.max()
    blocks[:nodes, inner, inner] += damping * diagonal + floor * largest
    # Landmarks have no rotation; the first node of every part does not move.
    turns = inner[: len(inner) - twin.dimension - extra]
    blocks[twin.points[:, None], turns, turns] = largest
    blocks[twin.anchors[:, None], inner, inner] += largest
    right = -gradient
    right[twin.anchors] = 0.0
    try:
        solver = solver_of(nodes, twin.rows, twin.columns, blocks)
        return np.asarray(solver.solve(right.ravel()).reshape(nodes, -1))
    except NotPositiveDefiniteError:
        return None
