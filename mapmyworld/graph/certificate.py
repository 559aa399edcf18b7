"""How sure we are that a minimum is the global one: a bound below every possible solution.

For symmetric multipliers L of the rotations' orthogonality, twice the twin's cost is
`trace(X (M - L) X') + trace(L)`; when `M - L + eta` is positive semi-definite, which a Cholesky
factorisation shows, no arrangement of the nodes costs less than half of `trace(L) - eta n d`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.graph.block_solver import solver_of
from mapmyworld.graph.cholesky import NotPositiveDefiniteError
from mapmyworld.graph.newton import hessian_blocks, newton_step
from mapmyworld.graph.system import Fit, System
from mapmyworld.graph.twin import (
    Twin,
    certificate_blocks,
    moved,
    multipliers,
    product,
    slope,
    tangent_bases,
    twin_of,
    twin_poses,
    twin_scale,
)

_STEPS = 15  # of Newton's method at most, from the solution to the twin's minimum
_SETTLED = 1e-4  # share of the cost that a step gains, from which on the twin counts as settled
_ROUNDING = 1e-15  # of the terms that cancel in the cost
_DAMPED_OUT = 1e3  # share of the diagonal at which no step helps any more
_FLOOR = 1e-12  # share of the largest diagonal that every step is damped by
_SLACK = (1e-4, 1e-2, 0.1)  # shares of the cost that eta may take off the bound
_EXACT = 1e-4  # of these, up to which the twin's minimum counts as its global one
_PROVEN = 0.02  # gap up to which the bound alone is called a proof


@dataclass(frozen=True, slots=True, eq=False)
class Certificate:
    """What is proven about a solution."""

    lower_bound: float
    """No arrangement of the nodes costs less; zero where nothing is known."""
    gap: float
    """By what share of its cost the solution could still be improved, at most."""
    twin_is_global: bool
    """Whether the twin's minimum beside this solution is proven to be the twin's global one."""

    @property
    def trusted(self) -> bool:
        """Whether there is no reason to look for a better minimum."""
        return self.twin_is_global or self.gap <= _PROVEN


def certify(system: System, solved: Fit) -> Certificate:
    """The certificate of a solution; linear algebra of a few steps of the optimiser."""
    cost = solved.cost
    if len(system.tails) == 0 or cost < 1e-12:
        return Certificate(0.0, 0.0, True)
    certificate = _certified(system, solved, equal=False)
    if not (certificate.trusted or system.planar):
        other = _certified(system, solved, equal=True)
        certificate = other if other.trusted else certificate
    return certificate


def _certified(system: System, solved: Fit, *, equal: bool) -> Certificate:
    cost, twin = solved.cost, twin_of(system, solved.residuals, equal=equal)
    found = _settled(twin, twin_poses(system.planar, solved.poses))
    if found is None:
        return Certificate(0.0, 1.0, False)
    for slack in _SLACK:
        if found.proven or _is_positive(twin, found.multiplied, slack * found.cost):
            lower = max(0.0, 0.5 * (found.dual - slack * found.cost))
            return Certificate(lower, max(0.0, 1.0 - lower / cost), slack <= _EXACT)
    return Certificate(0.0, 1.0, False)


@dataclass(frozen=True, slots=True, eq=False)
class _Settled:
    """The twin at its minimum, or so near to it that this one is proven."""

    multiplied: Array
    """Lagrange multipliers (N, d, d)."""
    cost: float
    dual: float
    """Twice what the twin costs, and what its dual does."""
    proven: bool
    """Whether the certificate matrix is positive definite with the smallest slack."""


def _is_positive(twin: Twin, multiplied: Array, slack: float) -> bool:
    """Whether the certificate matrix is positive definite with `slack` more on its rotations.

    That is the sum over all of them.
    """
    nodes, size = multiplied.shape[:2]
    blocks, inner = certificate_blocks(twin, multiplied), np.arange(1, size + 1)
    blocks[twin.anchors, 0, 0] += blocks.max()
    blocks[:nodes, inner, inner] += slack / (nodes * size)
    try:
        solver_of(nodes, twin.rows, twin.columns, blocks)
    except NotPositiveDefiniteError:
        return False
    return True


def _settled(twin: Twin, x: Array) -> _Settled | None:
    """The twin's minimum near X, by damped Newton steps; None where it is not found.

    Where X nearly closes the gap to the dual, before the first step or after any, a proof is tried.
    """
    pulled, settled = product(twin, twin.blocks, x), False
    cost, damping, rounding = float(np.vdot(pulled, x)), 0.0, _ROUNDING * twin_scale(twin, x)
    for _ in range(_STEPS + 1):
        reached = _state(twin, x, cost, pulled)
        if reached.proven or settled:
            return reached
        gradient, hessian = derivatives(twin, x, pulled, reached.multiplied)
        while True:
            step = newton_step(twin, gradient, hessian, damping, _FLOOR)
            if step is not None:
                trial = moved(x, step)
                pulled = product(twin, twin.blocks, trial)
                found = float(np.vdot(pulled, trial))
                if found <= cost + rounding:
                    break
            damping = max(1e-4, 10.0 * damping)
            if damping > _DAMPED_OUT:
                return None
        settled = damping == 0.0 and cost - found <= _SETTLED * found
        x, cost, damping = trial, found, damping / 10.0 if damping > 1e-4 else 0.0
    return None


def _state(twin: Twin, x: Array, cost: float, pulled: Array) -> _Settled:
    multiplied = multipliers(twin, x, pulled)
    dual = float(np.add.reduce(multiplied.trace(0, 1, 2)))
    near = abs(cost - dual) <= _EXACT * cost
    proven = near and _is_positive(twin, multiplied, _SLACK[0] * cost)
    return _Settled(multiplied, cost, dual, proven)


def derivatives(twin: Twin, x: Array, pulled: Array, multiplied: Array) -> tuple[Array, Array]:
    """Half the gradient (N, m) and half the Hessian's blocks (B, m, m) along the tangents.

    `pulled` is X M.
    """
    bases = tangent_bases(x)
    gradient = np.einsum("nkxp,nxp->nk", bases, slope(x, pulled, multiplied))
    return gradient, hessian_blocks(twin, certificate_blocks(twin, multiplied), bases)


def certainty_of(
    freedom: int, cost: float, converged: bool, certificate: Certificate | None, starts: list[str]
) -> str:
    """A sentence about a minimum of this cost: what is proven, else what the residuals say.

    `freedom` counts the numbers that edges measure beyond those that are unknown; `starts` are
    those that were followed.
    """
    if not converged:
        return "not converged: raise graph.iterations"
    parts = ["converged", proof_of(certificate, starts)]
    if freedom > 0:
        ratio = 2.0 * cost / freedom
        parts.append(f"squared sigmas are {ratio:.3g} times what the covariances predict")
    return "; ".join(parts)


def proof_of(certificate: Certificate | None, starts: list[str] | None = None) -> str:
    """What is proven of a minimum, in words; where it is not the global one, what was tried."""
    if certificate is None:
        return "whether the minimum is global was not examined"
    bound, share = f"no solution costs less than {certificate.lower_bound:.6g}", certificate.gap
    if share <= _PROVEN:
        return f"the global minimum, proven to within {100 * share:.2g} % ({bound})"
    known = [f"{bound}, {100 * share:.2g} % below" if share < 1.0 else "no bound below it is known"]
    if certificate.twin_is_global:
        known.append("it lies beside the proven minimum of the same graph with simpler covariances")
    if starts:
        kinds = ", ".join(dict.fromkeys(starts))
        ends = f"cheapest end of {len(starts)} starts" if len(starts) > 1 else "end of one start"
        known.append(f"it is the {ends} ({kinds})")
    return f"not proven to be the global minimum: {'; '.join(known)}"
