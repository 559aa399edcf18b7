"""How confident we are that a minimum is the global one: a bound below every possible solution.

For symmetric multipliers L of the rotations' orthogonality, twice the relaxation's cost is
`trace(X (M - L) X') + trace(L)`; when `M - L + eta` is positive semi-definite, which its
factorisation shows, no arrangement of the nodes costs less than half of `trace(L) - eta n d`.
Rosen, Carlone, Bandeira, Leonard, "SE-Sync" (2019).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapmyworld.backend.block_matrix import Blocks, diagonals
from mapmyworld.backend.convex_relaxation import (
    Relaxation,
    moved,
    multiplied_out,
    multipliers,
    relaxation_of,
    relaxation_poses,
    tangent_bases,
)
from mapmyworld.backend.information import Factorised, NotPositiveDefiniteError
from mapmyworld.backend.system import Fit, System
from mapmyworld.geometry import Array

_SLACK = (1e-4, 1e-2, 0.1)  # shares of the cost that eta may take off the bound
_EXACT = 1e-4  # of these, up to which the relaxation's minimum counts as its global one
_PROVEN = 0.02  # gap up to which the bound alone is called a proof


@dataclass(frozen=True, slots=True, eq=False)
class Certificate:
    """What is proven about a solution."""

    lower_bound: float
    """No arrangement of the nodes costs less; zero where nothing is known."""
    gap: float
    """By what share of its cost the solution could still be improved, at most."""
    relaxation_is_global: bool
    """Whether the relaxation's minimum beside this solution is proven to be its global one."""

    @property
    def trusted(self) -> bool:
        """Whether there is no reason to look for a better minimum."""
        return self.relaxation_is_global or self.gap <= _PROVEN


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
    cost, relaxation = solved.cost, relaxation_of(system, solved.residuals, equal=equal)
    found = _multipliers_at_minimum(
        relaxation, relaxation_poses(system.planar, solved.poses)[relaxation.order]
    )
    if found is None:
        return Certificate(0.0, 1.0, False)
    dual = float(found.trace(0, 1, 2).sum())
    for slack in _SLACK:
        if _is_positive(relaxation, found, 2.0 * slack * cost):
            lower = max(0.0, 0.5 * dual - slack * cost)
            return Certificate(lower, max(0.0, 1.0 - lower / cost), slack <= _EXACT)
    return Certificate(0.0, 1.0, False)


def _is_positive(relaxation: Relaxation, multiplied: Array, slack: float) -> bool:
    """Whether `M - L` is positive definite with so much more on its rotations, over all of them."""
    nodes, size = multiplied.shape[:2]
    more = np.zeros((nodes, size + 1))
    more[:, 1:] = slack / (nodes * size)
    more[relaxation.anchors, 0] += relaxation.matrix.matrix.data.max()
    try:
        _less(relaxation, multiplied).plus(diagonals(more)).factorised(np.arange(nodes))
    except NotPositiveDefiniteError:
        return False
    return True


def _less(relaxation: Relaxation, multiplied: Array) -> Blocks:
    """`S = M - L`; positive semi-definite at a global minimum."""
    nodes, size = multiplied.shape[:2]
    blocks = np.zeros((nodes, size + 1, size + 1))
    blocks[:, 1:, 1:] = -multiplied
    return relaxation.matrix.plus(blocks)


def _multipliers_at_minimum(relaxation: Relaxation, x: Array) -> Array | None:
    """L (N, d, d) at the relaxation's minimum near X; None where there is none nearby.

    One step of Newton's method leads to its rotations, near enough: more change no verdict. Where
    translations are the best for these, the trace of L is the relaxation's cost.
    """
    pulled = multiplied_out(relaxation.matrix, x)
    found, cost = multipliers(relaxation, x, pulled), float(np.vdot(pulled, x))
    if abs(cost - float(found.trace(0, 1, 2).sum())) <= _EXACT * cost:
        return found
    slope = _gradient(relaxation, x, pulled, found)
    try:
        step = _curvature(relaxation, x, found).solve(-slope.ravel())
        x = _with_translations(relaxation, moved(x, step.reshape(slope.shape)))
    except NotPositiveDefiniteError:
        return None
    return multipliers(relaxation, x, multiplied_out(relaxation.matrix, x))


def _with_translations(relaxation: Relaxation, x: Array) -> Array:
    """X (N, d, d + 1) with the translations that cost least for its rotations."""
    whole, found = relaxation.matrix, x.copy()
    alone = whole.with_blocks(whole.matrix.data[:, :1, :1])
    firm = np.zeros((len(x), 1))
    firm[relaxation.anchors] = alone.matrix.data.max()
    slope = multiplied_out(whole, x)[:, :, 0]
    found[:, :, 0] -= alone.plus(diagonals(firm)).factorised(np.arange(len(x))).solve(slope)
    return found


def _gradient(relaxation: Relaxation, x: Array, pulled: Array, multiplied: Array) -> Array:
    """(N, m) how the cost grows along the tangents; nothing where anchors would move."""
    slope = pulled.copy()
    slope[:, :, 1:] -= x[:, :, 1:] @ multiplied
    gradient = np.einsum("nkxp,nxp->nk", tangent_bases(x), slope)
    gradient[relaxation.anchors] = 0.0
    return np.asarray(gradient)


def _curvature(relaxation: Relaxation, x: Array, multiplied: Array) -> Factorised:
    """Second derivatives of the cost along the tangents; raises `NotPositiveDefiniteError`."""
    nodes, size = x.shape[:2]
    bases, less = tangent_bases(x), _less(relaxation, multiplied)
    laid = less.matrix
    rows = np.repeat(np.arange(nodes), np.diff(laid.indptr))
    flat, stacked = bases.reshape(*bases.shape[:2], -1), bases.reshape(nodes, -1, size + 1)
    left = (stacked[rows] @ laid.data).reshape(len(rows), *flat.shape[1:])
    blocks = left @ np.swapaxes(flat[laid.indices], 1, 2)
    # Landmarks have no rotation; the first node of every component does not move.
    firm = np.zeros(flat.shape[:2])
    firm[relaxation.anchors] = firm[relaxation.points, : bases.shape[1] - size] = np.abs(
        blocks
    ).max()
    return less.with_blocks(blocks).plus(diagonals(firm)).factorised(np.arange(nodes))


def certainty_of(
    freedom: int, cost: float, converged: bool, certificate: Certificate | None, starts: list[str]
) -> str:
    """Sentences about a minimum of this cost: what is certified, and how large residuals are.

    `freedom` counts the numbers that edges measure beyond those that are unknown; `starts` are
    those that were followed.
    """
    if not converged:
        return "Not converged: raise graph.iterations."
    sentences = ["Converged.", proof_of(certificate, starts)]
    if freedom > 0:
        ratio = 2.0 * cost / freedom
        sentences.append(f"Normalised residual {ratio:.3g} (1 = consistent).")
    return " ".join(sentences)


def proof_of(certificate: Certificate | None, starts: list[str] | None = None) -> str:
    """What is certified of a minimum, in words; where too little, which starts were tried."""
    if certificate is None:
        return "Global optimality not examined."
    share = certificate.gap
    if share <= _PROVEN:
        return f"Global optimality certified (gap {100 * share:.2g} %)."
    gap = f"gap {100 * share:.2g} %" if share < 1.0 else "no bound known"
    stated = f"Global optimality not certified ({gap})."
    if not starts:
        return stated
    kinds = ", ".join(dict.fromkeys(starts))
    return f"{stated} Best of {len(starts)} start{'s' * (len(starts) > 1)} ({kinds})."
