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
from mapmyworld.graph.residuals import retract, squared_sigmas
from mapmyworld.graph.system import System, residuals_of

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
class _Point:
    """Poses, and what they cost."""

    poses: Array
    residuals: Array
    cost: float
    """The sum of squared sigmas."""

    @staticmethod
    def of(system: System, poses: Array) -> _Point:
        residuals = residuals_of(system, poses)
        cost = float(squared_sigmas(residuals, system.information).sum())
        return _Point(poses, residuals, cost)


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
    """Poses at the nearby minimum, factorisations that led there, and whether it was reached.

    Levenberg-Marquardt that tries the full step first (Marquardt's scaling of the diagonal), and
    damps by how much of what the linear equations promise a step keeps (Nielsen, "Damping
    parameter in Marquardt's method", 1999). Near the minimum the matrix hardly changes: further
    steps are made with the factors at hand.
    """
    pattern, point, damping = pattern_of(system), _Point.of(system, poses), 0.0
    for taken in range(1, steps + 1):
        step = _downhill(system, pattern, point, damping, tolerance)
        if step is None:
            return point.poses, taken, True
        point, gain, damping = step.point, step.gain, step.damping
        if damping == 0.0 and gain < _NEAR * point.cost:
            point, gain = _coasted(system, pattern, step.solver, point, gain, tolerance)
        if gain <= tolerance * point.cost or point.cost < _NOTHING:
            return point.poses, taken, True
        if step.kept > _GOOD:
            damping = damping / 3.0 if damping > _SLIGHT else 0.0
    return point.poses, steps, False


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """Where a step leads, and what it was made with."""

    point: _Point
    solver: Solver
    damping: float
    gain: float
    """What it takes off the cost."""
    kept: float
    """The share of what the linear equations promised."""


def _downhill(
    system: System, pattern: Pattern, point: _Point, damping: float, tolerance: float
) -> _Step | None:
    """The first step that keeps its promise, ever more damped; None where none helps."""
    blocks, gradient = linearise(system, pattern, point.poses, residuals=point.residuals)
    growth = _GROWTH
    while damping <= _DAMPED_OUT:
        step = _tried(system, pattern, point, blocks, gradient, damping)
        enough = tolerance * point.cost
        if step is not None and step.gain >= 0.0 and (step.kept > _POOR or step.gain <= enough):
            return step
        damping, growth = max(_DAMPING, growth * damping), 2.0 * growth
    return None


def _tried(
    system: System, pattern: Pattern, point: _Point, blocks: Array, gradient: Array, damping: float
) -> _Step | None:
    """The step that is damped so much; None where the equations leave something undetermined."""
    try:
        solver = factorised(pattern, damped(pattern, blocks, damping))
    except NotPositiveDefiniteError:
        return None
    step = solver.solve(-gradient.ravel()).reshape(gradient.shape)
    found = _Point.of(system, retract(system.planar, point.poses, step))
    gain = point.cost - found.cost
    kept = gain / _promised(pattern, blocks, gradient, step, damping)
    return _Step(found, solver, damping, gain, kept)


def _promised(
    pattern: Pattern, blocks: Array, gradient: Array, step: Array, damping: float
) -> float:
    """What the linear equations say that a step gains."""
    inner = np.arange(blocks.shape[1])
    diagonal = blocks[: len(pattern.stays), inner, inner]
    gain = damping * float(np.sum(diagonal * step * step)) - float(np.vdot(gradient, step))
    return max(gain, _NOTHING)


def _coasted(
    system: System, pattern: Pattern, solver: Solver, point: _Point, gain: float, tolerance: float
) -> tuple[_Point, float]:
    """The point after more steps with the same factors, and what the last of them gained."""
    while gain > tolerance * point.cost and point.cost >= _NOTHING:
        gradient = gradient_of(system, pattern, point.poses, point.residuals)
        found = _Point.of(system, _stepped(system, solver, point.poses, gradient))
        if not found.cost <= point.cost:
            break
        before, gain, point = gain, point.cost - found.cost, found
        if gain > _PACE * before:
            break
    return point, gain


def _stepped(system: System, solver: Solver, poses: Array, gradient: Array) -> Array:
    step = solver.solve(-gradient.ravel()).reshape(gradient.shape)
    return retract(system.planar, poses, step)
