"""Down to the nearby minimum, by gtsam's Levenberg-Marquardt."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import gtsam

from mapmyworld.backend.block_matrix import colamd_order_of
from mapmyworld.backend.factors import FactorGraph, elimination_order, factor_graph, poses_of
from mapmyworld.backend.system import Fit, System, fit_of
from mapmyworld.geometry import Array

_STEPS = 20  # where a rough minimum is enough
_NOTHING = 1e-12  # cost of a graph without contradiction


@dataclass(frozen=True, slots=True, eq=False)
class Descent:
    """Where a descent ended."""

    fit: Fit
    iterations: int
    converged: bool
    start: str = ""
    """What it is called where it began."""


def optimised_roughly(
    system: System, poses: Array, tolerance: float = 1e-3, steps: int = _STEPS
) -> Array:
    """map_from_node at the minimum near `poses`, (N, 3 or 4, 4) both."""
    return descend(system, fit_of(system, poses), tolerance, steps).fit.poses


def descend(system: System, start: Fit, tolerance: float, steps: int) -> Descent:
    """The nearby minimum: steps end where one gains less than `tolerance` of the cost."""
    if system.size == 0 or start.cost < _NOTHING:
        return Descent(start, 0, True)
    order = colamd_order_of(len(system.free), system.tails, system.heads)
    free = order[system.free[order] >= 0].tolist()
    fit, taken = start, 0
    while taken < steps:
        graph, before = factor_graph(system, fit.poses), fit
        values, more = optimised(graph, free, tolerance, steps - taken)
        found = fit_of(system, poses_of(system, values, before.poses))
        fit, taken = (found if found.chi2 <= before.chi2 else before), taken + more
        exact = system.kinds is None  # else sightings were linear about the poses before
        if exact or fit.chi2 >= (1.0 - tolerance) * before.chi2:
            break
    return Descent(fit, taken, taken < steps)


def solved(graph: FactorGraph, tolerance: float = 1e-6, steps: int = 100) -> FactorGraph:
    """The graph at the nearby minimum, whatever factors and variables were added to it."""
    order = elimination_order(graph.factors)
    return replace(graph, values=optimised(graph, order, tolerance, steps)[0])


def optimised(
    graph: FactorGraph, order: list[int], tolerance: float, steps: int
) -> tuple[Any, int]:
    """The values of least cost near those of the graph, and how many steps led there; variables
    are eliminated in this order.
    """
    optimiser = gtsam.LevenbergMarquardtOptimizer(
        graph.factors, graph.values, gtsam.Ordering(order), _parameters(tolerance, steps)
    )  # fmt: skip
    return optimiser.optimize(), optimiser.iterations()


def _parameters(tolerance: float, steps: int) -> Any:
    """Gtsam's parameters of a descent."""
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(steps)
    parameters.setRelativeErrorTol(tolerance)
    parameters.setAbsoluteErrorTol(0.0)
    parameters.setErrorTol(_NOTHING)
    return parameters
