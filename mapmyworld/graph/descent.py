"""Down to the nearby minimum: Gauss-Newton, damped where that makes things worse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.graph.block_solver import Solver
from mapmyworld.graph.cholesky import NotPositiveDefiniteError
from mapmyworld.graph.linear_system import (
    Pattern,
    damped,
    factorised,
    gradient_of,
    linearise,
    pattern_of,
)
from mapmyworld.graph.residuals import retract
from mapmyworld.graph.system import Fit, System, fit_of

_STEPS = 20  # of Gauss-Newton at most
_DAMPING = 1e-8  # share of the diagonal, at first
_SLIGHT = 1e-12  # share up to which the next step is tried undamped
_GROWTH = 4.0  # of the damping where a step is taken back; twice as much with every further one
_POOR, _GOOD = 0.1, 0.75  # of the promised gain: taken back up to here, damped less from there
_DAMPED_OUT = 1e8  # where no step helps any more
_NOTHING = 1e-18  # cost of a graph without contradiction
_NEAR = 0.1  # share of the cost gained by a step, below which its factors serve for the next ones
_PACE = 0.1  # share of the last step's gain up to which they still do


@dataclass(frozen=True, slots=True, eq=False)
class Descent:
    """Where a descent ended."""

    fit: Fit
    iterations: int
    """Factorisations that led there."""
    converged: bool


def relax(system: System, pattern: Pattern, poses: Array, weights: Array, steps: int) -> Array:
    """Poses after some Gauss-Newton steps on the weighted problem."""
    for _ in range(steps):
        blocks, gradient = linearise(system, pattern, poses, weights)
        poses = _stepped(system, factorised(pattern, blocks), poses, gradient)
    return poses


def settle(system: System, poses: Array, tolerance: float = 1e-3, steps: int = _STEPS) -> Array:
    """Poses at the nearby minimum: Gauss-Newton, damped where that makes things worse."""
    return descend(system, fit_of(system, poses), tolerance, steps).fit.poses


def descend(system: System, start: Fit, tolerance: float, steps: int) -> Descent:
    """The nearby minimum.

    Levenberg-Marquardt that tries the full step first (Marquardt's scaling of the diagonal), and
    damps by how much of what the linear equations promise a step keeps (Nielsen, "Damping
    parameter in Marquardt's method", 1999). Near the minimum the matrix hardly changes: further
    steps are made with the factors at hand.
    """
    pattern, fit, damping = pattern_of(system), start, 0.0
    for taken in range(1, steps + 1):
        step = _downhill(system, pattern, fit, damping, tolerance)
        if step is None:
            return Descent(fit, taken, True)
        fit, gain, damping = step.fit, step.gain, step.damping
        if damping == 0.0 and gain < _NEAR * fit.chi2:
            fit, gain = _coasted(system, pattern, step.solver, fit, gain, tolerance)
        if gain <= tolerance * fit.chi2 or fit.chi2 < _NOTHING:
            return Descent(fit, taken, True)
        if step.kept > _GOOD:
            damping = damping / 3.0 if damping > _SLIGHT else 0.0
    return Descent(fit, steps, False)


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """Where a step leads, and what it was made with."""

    fit: Fit
    solver: Solver
    damping: float
    gain: float
    """What it takes off the cost."""
    kept: float
    """The share of what the linear equations promised."""


def _downhill(
    system: System, pattern: Pattern, fit: Fit, damping: float, tolerance: float
) -> _Step | None:
    """The first step that keeps its promise, ever more damped; None where none helps."""
    blocks, gradient = linearise(system, pattern, fit.poses, residuals=fit.residuals)
    growth = _GROWTH
    while damping <= _DAMPED_OUT:
        step = _tried(system, pattern, fit, blocks, gradient, damping)
        enough = tolerance * fit.chi2
        if step is not None and step.gain >= 0.0 and (step.kept > _POOR or step.gain <= enough):
            return step
        damping, growth = max(_DAMPING, growth * damping), 2.0 * growth
    return None


def _tried(
    system: System, pattern: Pattern, fit: Fit, blocks: Array, gradient: Array, damping: float
) -> _Step | None:
    """The step that is damped so much; None where the equations leave something undetermined."""
    try:
        solver = factorised(pattern, damped(pattern, blocks, damping))
    except NotPositiveDefiniteError:
        return None
    step = solver.solve(-gradient.ravel()).reshape(gradient.shape)
    found = fit_of(system, retract(system.planar, fit.poses, step))
    gain = fit.chi2 - found.chi2
    kept = gain / _promised(pattern, blocks, gradient, step, damping)
    return _Step(found, solver, damping, gain, kept)


def _promised(
    pattern: Pattern, blocks: Array, gradient: Array, step: Array, damping: float
) -> float:
    """What the linear equations say that a step gains."""
    gain = -float(np.vdot(gradient, step))
    if damping:
        inner = np.arange(blocks.shape[1])
        diagonal = blocks[: pattern.nodes, inner, inner]
        gain += damping * float(np.sum(diagonal * step * step))
    return max(gain, _NOTHING)


def _coasted(
    system: System, pattern: Pattern, solver: Solver, fit: Fit, gain: float, tolerance: float
) -> tuple[Fit, float]:
    """The fit after more steps with the same factors, and what the last of them gained."""
    while gain > tolerance * fit.chi2 and fit.chi2 >= _NOTHING:
        gradient = gradient_of(system, pattern, fit.poses, fit.residuals)
        found = fit_of(system, _stepped(system, solver, fit.poses, gradient))
        if not found.chi2 <= fit.chi2:
            break
        before, gain, fit = gain, fit.chi2 - found.chi2, found
        if gain > _PACE * before:
            break
    return fit, gain


def _stepped(system: System, solver: Solver, poses: Array, gradient: Array) -> Array:
    step = solver.solve(-gradient.ravel()).reshape(gradient.shape)
    return retract(system.planar, poses, step)
