"""Down to the nearby minimum: Gauss-Newton, damped where that makes things worse."""

from __future__ import annotations

from mapmyworld.geometry import Array
from mapmyworld.graph.cholesky import NotPositiveDefiniteError
from mapmyworld.graph.linear_system import Pattern, damped, linearise, pattern_of, solved
from mapmyworld.graph.residuals import retract
from mapmyworld.graph.system import System, edge_chi2

_STEPS = 20  # of Gauss-Newton at most
_DAMPING = 1e-4  # share of the diagonal, at first
_DAMPED_OUT = 1e8  # where no step helps any more
_NOTHING = 1e-18  # cost of a graph without contradiction


def relax(system: System, pattern: Pattern, poses: Array, weights: Array, steps: int) -> Array:
    """Poses after some Gauss-Newton steps on the weighted problem."""
    for _ in range(steps):
        blocks, gradient = linearise(system, pattern, poses, weights)
        poses = retract(system.planar, poses, solved(pattern, blocks, -gradient))
    return poses


def settle(system: System, poses: Array, tolerance: float = 1e-3, steps: int = _STEPS) -> Array:
    """Poses at the nearby minimum: Gauss-Newton, damped where that makes things worse."""
    return descend(system, poses, tolerance, steps)[0]


def descend(system: System, poses: Array, tolerance: float, steps: int) -> tuple[Array, int, bool]:
    """Poses at the nearby minimum, steps taken, and whether it was reached.

    Levenberg-Marquardt that tries the full step first (Marquardt's scaling of the diagonal).
    """
    pattern, cost = pattern_of(system), float(edge_chi2(system, poses).sum())
    damping = 0.0
    for taken in range(1, steps + 1):
        blocks, gradient = linearise(system, pattern, poses)
        while True:
            moved = _moved(system, pattern, poses, damped(pattern, blocks, damping), gradient)
            found = float(edge_chi2(system, moved).sum())
            if found <= cost and moved is not poses:
                break
            damping = max(_DAMPING, 10.0 * damping)
            if damping > _DAMPED_OUT:
                return poses, taken, True
        gain, poses, cost = cost - found, moved, found
        damping = damping / 10.0 if damping > _DAMPING else 0.0
        if gain <= tolerance * cost or cost < _NOTHING:
            return poses, taken, True
    return poses, steps, False


def _moved(system: System, pattern: Pattern, poses: Array, blocks: Array, gradient: Array) -> Array:
    """Poses after a step; the same poses where the equations leave something undetermined."""
    try:
        return retract(system.planar, poses, solved(pattern, blocks, -gradient))
    except NotPositiveDefiniteError:
        return poses
