"""What a solution predicts of edges, in sigmas of what they state: residuals and covariances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.backend.factors import factors_at
from mapmyworld.backend.information import Information
from mapmyworld.backend.system import System, chosen_edges, fit_of, moving_edges
from mapmyworld.geometry import Array, Index


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """A group of C edges between poses against a solution."""

    residuals: Array
    """(C * d,) in sigmas: one edge's residual is `root' r`, with `root root'` its information."""
    covariance: Array
    """(C * d, C * d) of these, as the solution predicts them."""


def predictions(
    information: Information, system: System, poses: Array, groups: Sequence[Index]
) -> list[Prediction]:
    """Every group of edges of a system, none of them a sighting, against a solution.

    A group is the positions (C,) of its edges. The `poses` (N, 3 or 4, 4), map_from_node, are the
    solution, whose `information` has the system's free nodes for variables.
    """
    if not groups:
        return []
    order = np.concatenate(groups)
    asked = chosen_edges(system, order)
    moving = moving_edges(asked)
    roots = np.linalg.cholesky(asked.information)
    residuals = np.einsum("eji,ej->ei", roots, fit_of(asked, poses).residuals)
    size = system.dimension
    ends = np.cumsum([0, *(len(group) for group in groups)])
    rows = np.concatenate([[0], np.cumsum(moving)]) * size
    if moving.any():
        factors = factors_at(asked, poses, information.values)
        linear = factors.linearize(information.values)
        jacobian, right = information.variables.jacobian(linear)
        residuals[moving] = -right.reshape(-1, size)
        found = information.factorised.predict(jacobian, rows[ends])
    else:
        found = [np.zeros((0, 0))] * len(groups)
    whole = [
        _spread_out(moving[a:b], size, own)
        for a, b, own in zip(ends[:-1].tolist(), ends[1:].tolist(), found, strict=True)
    ]
    parts = np.split(residuals, ends[1:-1])
    return [Prediction(r.ravel(), covariance) for r, covariance in zip(parts, whole, strict=True)]


def _spread_out(moving: NDArray[np.bool_], size: int, own: Array) -> Array:
    """The covariance of all edges of a group, zero for those between nodes that stay."""
    if moving.all():
        return own
    rows = np.repeat(moving, size)
    found = np.zeros((len(rows), len(rows)))
    found[np.ix_(rows, rows)] = own
    return found
