"""Which closures are true: consistency first, then graduated non-convexity.

Graduated non-convexity with truncated least squares: Yang, Antonante, Tzoumas, Carlone,
"Graduated non-convexity for robust spatial perception" (2020). Odometry keeps weight 1; closures
end with weight 0 or 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config.graph import GraphConfig
from mapmyworld.geometry import Array
from mapmyworld.graph.cholesky import NotPositiveDefiniteError
from mapmyworld.graph.clusters import allowed, evidence_of, groups_of, judge_groups
from mapmyworld.graph.consistency import Consistency, alternatives, compare_closures
from mapmyworld.graph.dead_reckoning import reckon
from mapmyworld.graph.joint_covariance import predicted_covariances
from mapmyworld.graph.linear_system import (
    Pattern,
    damped,
    information_factors,
    linearise,
    pattern_of,
    solved,
)
from mapmyworld.graph.pose_graph import Index, components
from mapmyworld.graph.residuals import chi_squared_quantile, retract
from mapmyworld.graph.starts import chordal_start
from mapmyworld.graph.system import System, believed_edges, chosen_edges, edge_chi2

_GROWTH = 1.4  # of the control parameter between two rounds, as in the paper
_ROUNDS = 100  # at most
_CANDIDATES = 400  # closures left out that are tried again at once, best fitting first
_STEPS = 20  # of Gauss-Newton at most
_DAMPING = 1e-4  # share of the diagonal, at first
_DAMPED_OUT = 1e8  # where no step helps any more
_NOTHING = 1e-18  # cost of a graph without contradiction
_GROUP_ROUNDS = 12  # at most, of leaving the worst groups out
_RETRIES = 3  # times that left-out closures are tried again on a better solution


@dataclass(frozen=True, slots=True, eq=False)
class RobustSolution:
    poses: Array
    inliers: NDArray[np.bool_]
    """(E,) edges that were believed in the end; trusted ones always."""
    chi2: Array
    """(E,) squared sigmas of every edge at `poses`."""
    limit: float
    """The chi-squared up to which an edge can be true."""
    closures: Index
    """(K,) positions of the edges that were questioned."""
    consistency: Consistency
    """Of these closures."""

    def moved(self, poses: Array, chi2: Array) -> RobustSolution:
        """The same verdicts at other poses."""
        return replace(self, poses=poses, chi2=chi2)

    @staticmethod
    def untouched(system: System, poses: Array, trusted: NDArray[np.bool_]) -> RobustSolution:
        """Nothing to solve: every edge believed, every node where it was."""
        nothing = np.zeros(0, np.int64)
        agreement = Consistency(
            nothing.reshape(0, 2), np.zeros(0), nothing, nothing, np.zeros(0, np.bool_)
        )
        every = np.ones(len(trusted), np.bool_)
        return RobustSolution(poses, every, edge_chi2(system, poses), np.inf, nothing, agreement)


def solve_robustly(
    system: System, guess: Array, anchors: Index, trusted: NDArray[np.bool_], config: GraphConfig
) -> RobustSolution:
    """Poses and inliers of a graph whose untrusted edges may be wrong."""
    limit = float(chi_squared_quantile(config.inlier_probability, system.dimension))
    closures = np.flatnonzero(~trusted).astype(np.int64)
    consistency = _compare(system, guess, trusted, closures, config)
    inliers = trusted.copy()
    inliers[closures[consistency.clique]] = True
    groups = groups_of(system, closures, consistency, limit)
    poses = settle(believed_edges(system, inliers), _fresh_start(system, guess, anchors, inliers))
    for _ in range(_RETRIES):
        poses, inliers = _without_misfits(system, poses, trusted, inliers, limit)
        scale = 1.0
        if config.groups:
            poses, inliers, scale = _without_strangers(
                system, poses, inliers, closures, groups, config
            )
        found = inliers | _admissible(system, poses, inliers, limit, scale)
        if np.array_equal(found, inliers):
            break
        inliers = found
        poses = settle(believed_edges(system, inliers), poses)
    poses, inliers = _without_misfits(system, poses, trusted, inliers, limit)
    return RobustSolution(poses, inliers, edge_chi2(system, poses), limit, closures, consistency)


def _without_misfits(
    system: System,
    poses: Array,
    trusted: NDArray[np.bool_],
    inliers: NDArray[np.bool_],
    limit: float,
) -> tuple[Array, NDArray[np.bool_]]:
    """The solution after graduated non-convexity, where believed edges contradict each other."""
    while ((edge_chi2(system, poses) > limit) & inliers & ~trusted).any():
        poses, inliers = graduate(system, poses, trusted, inliers, limit)
        poses = settle(believed_edges(system, inliers), poses)
    return poses, inliers


def _without_strangers(
    system: System,
    poses: Array,
    inliers: NDArray[np.bool_],
    closures: Index,
    groups: Index,
    config: GraphConfig,
) -> tuple[Array, NDArray[np.bool_], float]:
    """The solution without groups of closures that all others contradict, the worst ones first."""
    inliers, left_out = inliers.copy(), 0
    for _ in range(_GROUP_ROUNDS):
        found = judge_groups(system, poses, inliers, closures, groups, config.inlier_probability)
        bad = (found.excess > 1.0) | (found.evidence < np.log(max(1.0, 10.0 * left_out)))
        if not bad.any():
            break
        worst = bad & (found.excess >= 0.5 * found.excess[bad].max())
        for k in np.flatnonzero(worst).tolist():
            inliers[found.members[k]] = False
        left_out += sum(len(found.members[k]) > 2 for k in np.flatnonzero(worst).tolist())
        poses = settle(believed_edges(system, inliers), poses)
    return poses, inliers, found.scale


def _admissible(
    system: System, poses: Array, inliers: NDArray[np.bool_], limit: float, scale: float
) -> NDArray[np.bool_]:
    """(E,) edges left out that the solution predicts, and too well to be chance.

    The prediction's own uncertainty counts: a closure after a long drift may miss by metres and
    be true. Where many closures look false, fitting by chance becomes likely, and a lone closure
    must fit the better: expected are at most 0.1 false ones.
    """
    part = components(len(poses), system.tails[inliers], system.heads[inliers])
    within = part[system.tails] == part[system.heads]  # nothing predicts what joins two parts
    candidates = np.flatnonzero(~inliers & within)
    chi2 = edge_chi2(system, poses)[candidates]
    candidates = candidates[np.argsort(chi2, kind="stable")[:_CANDIDATES]]
    admitted = np.zeros(len(inliers), np.bool_)
    if len(candidates) == 0:
        return admitted
    fit, volume = innovations(system, poses, inliers, candidates)
    space = float(np.log(alternatives(system.planar, system.measured[~inliers])))
    evidence = evidence_of(fit, volume, space, scale, system.dimension)
    false_ones = np.count_nonzero(~inliers) - np.count_nonzero(fit <= limit)
    needed = np.log(max(1.0, 10.0 * false_ones))
    admitted[candidates] = (fit <= limit * allowed(scale)) & (evidence >= needed)
    return admitted


def innovations(
    system: System, poses: Array, inliers: NDArray[np.bool_], candidates: Index
) -> tuple[Array, Array]:
    """Squared sigmas (C,) of edges against what the inliers predict, and the volume of that."""
    part = believed_edges(system, inliers)
    factors = information_factors(part, poses)
    tested = replace(chosen_edges(system, candidates), free=part.free)
    predicted, residuals = predicted_covariances(factors, tested, poses)
    covariance = np.linalg.inv(tested.information) + predicted
    fit = np.einsum(
        "ei,ei->e", residuals, np.linalg.solve(covariance, residuals[..., None])[..., 0]
    )
    volume = np.sqrt(np.maximum(np.linalg.det(2.0 * np.pi * covariance), 0.0))  # not by rounding
    return fit, np.maximum(volume, 1e-300)


def _compare(
    system: System, guess: Array, trusted: NDArray[np.bool_], closures: Index, config: GraphConfig
) -> Consistency:
    if system.kinds is not None:
        trusted = trusted & (system.kinds == 0)
    odometry = reckon(
        system.planar,
        guess,
        system.tails[trusted],
        system.heads[trusted],
        system.measured[trusted],
        system.information[trusted],
    )
    limit = float(chi_squared_quantile(config.consistency_probability, system.dimension))
    return compare_closures(
        system.planar,
        odometry,
        system.tails[closures],
        system.heads[closures],
        system.measured[closures],
        system.information[closures],
        limit,
    )


def _fresh_start(
    system: System, guess: Array, anchors: Index, believed: NDArray[np.bool_]
) -> Array:
    part = chosen_edges(system, believed)
    try:
        return chordal_start(
            system.planar, guess, anchors, part.tails, part.heads, part.measured, part.information
        )
    except NotPositiveDefiniteError:  # nodes that no believed edge holds stay where they are
        return guess


def graduate(
    system: System,
    start: Array,
    trusted: NDArray[np.bool_],
    tried: NDArray[np.bool_],
    limit: float,
) -> tuple[Array, NDArray[np.bool_]]:
    """Poses and inliers (E,) among the `tried` edges; the others play no part."""
    part, fixed = believed_edges(system, tried), trusted[tried]
    pattern = pattern_of(part)
    weights = np.ones(len(fixed))
    poses = relax(part, pattern, start, weights, 3)
    chi2 = edge_chi2(part, poses)
    control = first_control(chi2[~fixed], limit)
    for _ in range(_ROUNDS):
        weights = np.where(fixed, 1.0, truncated_weights(chi2, limit, control))
        poses = relax(part, pattern, poses, weights, 1)
        chi2 = edge_chi2(part, poses)
        decided = (weights < 1e-3) | (weights > 1.0 - 1e-3)
        if decided.all() and control > 1.0:
            break
        control *= _GROWTH
    inliers = np.zeros(len(tried), np.bool_)
    inliers[np.flatnonzero(tried)] = fixed | (weights > 0.5)
    return poses, inliers


def first_control(chi2: Array, limit: float) -> float:
    """The control parameter at which the loss is convex over the largest residual."""
    worst = float(chi2.max(initial=0.0))
    return 1e3 if 2.0 * worst <= limit else limit / (2.0 * worst - limit)


def truncated_weights(chi2: Array, limit: float, control: float) -> Array:
    """Weights (E,) in closed form (equation 14 of the paper)."""
    middle = np.sqrt(limit * control * (control + 1.0) / np.maximum(chi2, 1e-12)) - control
    weights = np.clip(middle, 0.0, 1.0)
    weights[chi2 >= limit * (control + 1.0) / control] = 0.0
    weights[chi2 <= limit * control / (control + 1.0)] = 1.0
    return weights


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
            step = solved(pattern, damped(pattern, blocks, damping), -gradient)
            moved = retract(system.planar, poses, step)
            found = float(edge_chi2(system, moved).sum())
            if found <= cost:
                break
            damping = max(_DAMPING, 10.0 * damping)
            if damping > _DAMPED_OUT:
                return poses, taken, True
        gain, poses, cost = cost - found, moved, found
        damping = damping / 10.0 if damping > _DAMPING else 0.0
        if gain <= tolerance * cost or cost < _NOTHING:
            return poses, taken, True
    return poses, steps, False
