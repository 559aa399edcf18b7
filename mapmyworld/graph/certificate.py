"""How sure we are that a minimum is the global one: a bound below every possible solution.

For symmetric multipliers L of the rotations' orthogonality, twice the twin's cost is
`trace(X (M - L) X') + trace(L)`; when `M - L + eta` is positive semi-definite, which a Cholesky
factorisation shows, no arrangement of the nodes costs less than half of `trace(L) - eta n d`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.graph.cholesky import NotPositiveDefiniteError, factorise
from mapmyworld.graph.elimination import Symbolic, analyse
from mapmyworld.graph.newton import hessian_blocks, newton_step
from mapmyworld.graph.system import System, edge_chi2
from mapmyworld.graph.twin import (
    Twin,
    certificate_blocks,
    moved,
    multipliers,
    product,
    tangent_bases,
    twin_cost,
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


def certify(system: System, poses: Array) -> Certificate:
    """The certificate of a solution; linear algebra of a few steps of the optimiser."""
    cost = 0.5 * float(edge_chi2(system, poses).sum())
    if len(system.tails) == 0 or cost < 1e-12:
        return Certificate(0.0, 0.0, True)
    twin = twin_of(system, poses)
    nodes, size = len(poses), twin.dimension
    tangents = size * (size + 1) // 2
    symbolic = analyse(nodes, twin.rows, twin.columns, tangents)
    x = _settled(twin, symbolic, twin_poses(system.planar, poses))
    if x is None:
        return Certificate(0.0, 1.0, False)
    multiplied = multipliers(twin, x)
    dual, found = float(np.trace(multiplied, axis1=1, axis2=2).sum()), twin_cost(twin, x)
    blocks = certificate_blocks(twin, multiplied)
    blocks[twin.anchors, 0, 0] += np.abs(blocks[:nodes]).max()
    smaller = analyse(nodes, twin.rows, twin.columns, size + 1)
    for slack in _SLACK:
        eta = slack * found / (nodes * size)
        if _is_positive(smaller, blocks, nodes, eta):
            lower = max(0.0, 0.5 * (dual - eta * nodes * size))
            return Certificate(lower, max(0.0, 1.0 - lower / cost), slack <= _EXACT)
    return Certificate(0.0, 1.0, False)


def _is_positive(symbolic: Symbolic, blocks: Array, nodes: int, eta: float) -> bool:
    """Whether the matrix with `eta` more on the diagonal of rotations is positive definite."""
    inner = np.arange(1, blocks.shape[1])
    raised = blocks.copy()
    raised[np.arange(nodes)[:, None], inner, inner] += eta
    try:
        factorise(symbolic, raised)
    except NotPositiveDefiniteError:
        return False
    return True


def _settled(twin: Twin, symbolic: Symbolic, x: Array) -> Array | None:
    """X at the twin's minimum near X, by damped Newton steps; None where it is not found."""
    cost, damping, rounding = twin_cost(twin, x), 0.0, _ROUNDING * twin_scale(twin, x)
    for _ in range(_STEPS):
        gradient, hessian = _derivatives(twin, x)
        while True:
            step = newton_step(twin, symbolic, gradient, hessian, damping, _FLOOR)
            trial = None if step is None else moved(x, step)
            found = np.inf if trial is None else twin_cost(twin, trial)
            if trial is not None and found <= cost + rounding:
                break
            damping = max(1e-4, 10.0 * damping)
            if damping > _DAMPED_OUT:
                return None
        undamped, gain = damping == 0.0, cost - found
        x, cost, damping = trial, found, damping / 10.0 if damping > 1e-4 else 0.0
        if undamped and gain <= _SETTLED * cost:
            return x
    return None


def _derivatives(twin: Twin, x: Array) -> tuple[Array, Array]:
    """Half the gradient (N, m) and half the Hessian's blocks (B, m, m) along the tangents."""
    blocks = certificate_blocks(twin, multipliers(twin, x))
    bases = tangent_bases(x)
    gradient = np.einsum("nkxp,nxp->nk", bases, product(twin, blocks, x))
    return gradient, hessian_blocks(twin, blocks, bases)


def certainty_of(
    system: System, poses: Array, converged: bool, certificate: Certificate | None
) -> str:
    """A sentence about the minimum: what is proven, else what the residuals say."""
    if not converged:
        return "not converged: raise graph.iterations"
    parts = ["converged", proof_of(certificate)]
    freedom = system.dimension * len(system.tails) - system.size
    if freedom > 0:
        ratio = float(edge_chi2(system, poses).sum()) / freedom
        parts.append(f"squared sigmas are {ratio:.3g} times what the covariances predict")
    return "; ".join(parts)


def proof_of(certificate: Certificate | None) -> str:
    """What is proven of a minimum, in words."""
    if certificate is None:
        return "whether the minimum is global was not examined"
    bound = f"no solution costs less than {certificate.lower_bound:.6g}"
    if certificate.gap <= _PROVEN:
        return f"the global minimum, proven to within {100 * certificate.gap:.2g} % ({bound})"
    if certificate.twin_is_global:
        # The minimum of a graph with isotropic covariances is proven, and lies beside this one.
        return f"very likely the global minimum ({bound}, {100 * certificate.gap:.2g} % below)"
    return "not proven to be the global minimum: take it with care"
