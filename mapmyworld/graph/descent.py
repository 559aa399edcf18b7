"""Down to the nearby minimum: Gauss-Newton, damped where that makes things worse."""

from __future__ import annotations

from mapmyworld.geometry import Array
from mapmyworld.graph.cholesky import NotPositiveDefiniteError
from mapmyworld.graph.linear_system import (
    Pattern,
    Solver,
    damped,
    factorised,
    gradient_of,
    linearise,
    pattern_of,
)
from mapmyworld.graph.residuals import retract
from mapmyworld.graph.system import System, edge_chi2

_STEPS = 20  # of Gauss-Newton at most
_DAMPING = 1e-4  # share of the diagonal, at first
_DAMPED_OUT = 1e8  # where no step helps any more
_NOTHING = 1e-18  # cost of a graph without contradiction
_NEAR = 0.1  # share of the cost gained by a step, below which its factors serve for the next ones
_PACE = 0.1  # share of the last step's gain up to which they still do


def relax(system: System, pattern: Pattern, poses: Array, weights: Array, steps: int) -> Array:
    """Poses after some Gauss-Newton steps on the weighted problem."""
    for _ in range(steps):
        blocks, gradient = linearise(system, pattern, poses, weights)
        poses = _stepped(system, factorised(pattern, blocks), poses, gradient)
    return poses


def settle(system: System, poses: Array, tolerance: float = 1e-3, steps: int = _STEPS) -> Array:
    """Poses at the nearby minimum: Gauss-Newton, damped where that makes things worse."""
    return descend(system, poses, tolerance, steps)[0]


def descend(system: System, poses: Array, tolerance: float, steps: int) -> tuple[Array, int, bool]:
    """Poses at the nearby minimum, factorisations made, and whether it was reached.

    Levenberg-Marquardt that tries the full step first (Marquardt's scaling of the diagonal). Near
    the minimum the matrix hardly changes: further steps are made with the factors at hand.
    """
    pattern, cost = pattern_of(system), _cost(system, poses)
    damping = 0.0
    for taken in range(1, steps + 1):
        blocks, gradient = linearise(system, pattern, poses)
        while True:
            try:
                solver = factorised(pattern, damped(pattern, blocks, damping))
                moved = _stepped(system, solver, poses, gradient)
                found = _cost(system, moved)
                if found <= cost:
                    break
            except NotPositiveDefiniteError:  # the equations leave something undetermined
                pass
            damping = max(_DAMPING, 10.0 * damping)
            if damping > _DAMPED_OUT:
                return poses, taken, True
        gain, poses, cost = cost - found, moved, found
        if damping == 0.0 and gain < _NEAR * cost:
            poses, cost, gain = _coasted(system, pattern, solver, poses, cost, gain, tolerance)
        if gain <= tolerance * cost or cost < _NOTHING:
            return poses, taken, True
        damping = damping / 10.0 if damping > _DAMPING else 0.0
    return poses, steps, False


def _coasted(
    system: System,
    pattern: Pattern,
    solver: Solver,
    poses: Array,
    cost: float,
    gain: float,
    tolerance: float,
) -> tuple[Array, float, float]:
    """Poses after more steps with the same factors, their cost, and what the last one gained."""
    while gain > tolerance * cost and cost >= _NOTHING:
        moved = _stepped(system, solver, poses, gradient_of(system, pattern, poses))
        found = _cost(system, moved)
        if not found <= cost:
            break
        before, gain, poses, cost = gain, cost - found, moved, found
        if gain > _PACE * before:
            break
    return poses, cost, gain


def _cost(system: System, poses: Array) -> float:
    return float(edge_chi2(system, poses).sum())


def _stepped(system: System, solver: Solver, poses: Array, gradient: Array) -> Array:
    step = solver.solve(-gradient.ravel()).reshape(gradient.shape)
    return retract(system.planar, poses, step)
