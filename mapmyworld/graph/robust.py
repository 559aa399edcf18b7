"""Which closures are true: those that agree first, then whatever these predict."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.backend.connected_components import held_nodes
from mapmyworld.backend.descent import optimised_roughly
from mapmyworld.backend.factors import between_factors
from mapmyworld.backend.graduated import graduate
from mapmyworld.backend.information import NotPositiveDefiniteError
from mapmyworld.backend.residuals import chi_squared_quantile
from mapmyworld.backend.starts import chordal_start
from mapmyworld.backend.system import System, believed_edges, chosen_edges, edge_chi2
from mapmyworld.config import GraphConfig
from mapmyworld.geometry import Array, Index
from mapmyworld.graph.clusters import groups_of, judge_groups
from mapmyworld.graph.consistency import Consistency, compare_closures, reckon
from mapmyworld.graph.inlier_recovery import recoverable

_GROUP_ROUNDS = 12  # at most, of leaving the worst groups out
_GROWTH_ROUNDS = 30  # at most, of growing from odometry
_BETTER = 0.99  # share of the cost below which another minimum is taken for a better one
_RETRIES = 3  # times that left-out closures are tried again on a better solution
_ENOUGH = 12  # such times at most, of the solution that is kept


@dataclass(frozen=True, slots=True, eq=False)
class RobustSolution:
    """Poses, and the edges that were believed."""

    poses: Array
    """(N, 3 or 4, 4) map_from_node."""
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

    @staticmethod
    def untouched(system: System, poses: Array) -> RobustSolution:
        """Nothing to solve: every edge (E,) believed, every node at its `poses` (N, 3 or 4, 4)."""
        nothing = np.zeros(0, np.int64)
        agreement = Consistency(
            nothing.reshape(0, 2), np.zeros(0), nothing, nothing, np.zeros(0, np.bool_)
        )
        every = np.ones(len(system.tails), np.bool_)
        return RobustSolution(poses, every, edge_chi2(system, poses), np.inf, nothing, agreement)


def solve_robustly(
    system: System, guess: Array, anchors: Index, trusted: NDArray[np.bool_], config: GraphConfig
) -> RobustSolution:
    """Poses and inliers of a graph whose untrusted edges may be wrong.

    Believed at first are the closures that agree with each other; where the solution of these
    leaves some of them out, another one grows from odometry alone, and the cheaper one is solved
    afresh.

    `guess` (N, 3 or 4, 4) is map_from_node, `anchors` (A,) the nodes that keep it, and `trusted`
    (E,) the edges that nobody questions.
    """
    limit = float(chi_squared_quantile(config.inlier_probability, system.dimension))
    closures = np.flatnonzero(~trusted).astype(np.int64)
    consistency = _compare(system, guess, trusted, closures, config)
    groups = groups_of(system, closures, consistency, limit)
    system = replace(system, factors=between_factors(system))  # for all solutions of its parts
    question = _Question(system, trusted, closures, groups, limit, config)
    agreeing = trusted.copy()
    agreeing[closures[consistency.clique]] = True
    start = _fresh_start(system, guess, anchors, agreeing)
    best = _refined(question, optimised_roughly(believed_edges(system, agreeing), start), agreeing)
    if (agreeing & ~best.inliers).any():
        other = _refined(question, *_grown(question, guess))
        best = min(best, other, key=lambda found: _truncated_cost(question, found))
        best = _afresh(question, guess, anchors, best)
    if not best.converged:
        best = _refined(question, best.poses, best.inliers, _ENOUGH)
    chi2 = edge_chi2(system, best.poses)
    return RobustSolution(best.poses, best.inliers, chi2, limit, closures, consistency)


@dataclass(frozen=True, slots=True, eq=False)
class _Question:
    """What is to be decided."""

    system: System
    trusted: NDArray[np.bool_]
    closures: Index
    groups: Index
    limit: float
    config: GraphConfig


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """A solution on the way."""

    poses: Array
    inliers: NDArray[np.bool_]
    converged: bool
    """Whether nothing more came in or left when it was tried last."""


def _afresh(question: _Question, guess: Array, anchors: Index, found: _Found) -> _Found:
    """The solution from a start that knows nothing of what was left out, where that fits better.

    What false closures have bent too far stays bent when they leave: a minimum of its own.
    """
    system, inliers = question.system, found.inliers
    start = _fresh_start(system, guess, anchors, inliers)
    fresh = optimised_roughly(believed_edges(system, inliers), start)
    costs = [edge_chi2(system, poses)[inliers].sum() for poses in (fresh, found.poses)]
    return _refined(question, fresh, inliers) if costs[0] < _BETTER * costs[1] else found


def _truncated_cost(question: _Question, found: _Found) -> float:
    """Squared sigmas of what is believed, and the limit for everything that is not."""
    believed = edge_chi2(question.system, found.poses)[found.inliers].sum()
    return float(believed + question.limit * np.count_nonzero(~found.inliers))


def _grown(question: _Question, guess: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Poses and inliers that grow from odometry: in comes what the solution so far predicts."""
    system, inliers = question.system, question.trusted.copy()
    poses = optimised_roughly(believed_edges(system, inliers), guess)
    for _ in range(_GROWTH_ROUNDS):
        found = recoverable(system, poses, inliers, question.limit, 1.0)
        if not found.any():
            break
        inliers = inliers | found
        poses = optimised_roughly(believed_edges(system, inliers), poses)
    return poses, inliers


def _refined(
    question: _Question, poses: Array, inliers: NDArray[np.bool_], rounds: int = _RETRIES
) -> _Found:
    """The solution without what it contradicts, and with all else that it predicts."""
    system, limit = question.system, question.limit
    before, converged = np.zeros(0, np.bool_), False
    for _ in range(rounds):
        poses, inliers = _without_outliers(question, poses, inliers)
        scale = 1.0
        if question.config.groups:
            poses, inliers, scale = _without_strangers(question, poses, inliers)
        found = inliers | recoverable(system, poses, inliers, limit, scale)
        converged = np.array_equal(found, inliers) or np.array_equal(found, before)
        if converged:
            break
        before = inliers = found
        poses = optimised_roughly(believed_edges(system, inliers), poses)
    return _Found(*_without_outliers(question, poses, inliers), converged)


def _without_outliers(
    question: _Question, poses: Array, inliers: NDArray[np.bool_]
) -> tuple[Array, NDArray[np.bool_]]:
    """The solution after graduated non-convexity, where believed edges contradict each other."""
    system, trusted, limit = question.system, question.trusted, question.limit
    while True:
        chi2 = np.where(inliers & ~trusted, edge_chi2(system, poses), 0.0)
        if not (chi2 > limit).any():
            return poses, inliers
        poses, found = graduate(system, poses, trusted, inliers, limit)
        if np.array_equal(found, inliers):  # one hovers about the limit
            found[np.argmax(chi2)] = False
        inliers = found
        poses = optimised_roughly(believed_edges(system, inliers), poses)


def _without_strangers(
    question: _Question, poses: Array, inliers: NDArray[np.bool_]
) -> tuple[Array, NDArray[np.bool_], float]:
    """The solution without groups of closures that all others contradict, the worst ones first."""
    system, inliers, left_out, scale = question.system, inliers.copy(), 0, 1.0
    asked = question.closures, question.groups, question.config.inlier_probability
    for _ in range(_GROUP_ROUNDS):
        try:
            found = judge_groups(system, poses, inliers, *asked)
        except NotPositiveDefiniteError:  # a landmark that is seen once has no covariance
            break
        scale = found.scale
        bad = (found.excess > 1.0) | (found.evidence < np.log(max(1.0, 10.0 * left_out)))
        if not bad.any():
            break
        worst = bad & (found.excess >= 0.5 * found.excess[bad].max())
        for k in np.flatnonzero(worst).tolist():
            inliers[found.members[k]] = False
        left_out += sum(len(found.members[k]) > 2 for k in np.flatnonzero(worst).tolist())
        poses = optimised_roughly(believed_edges(system, inliers), poses)
    return poses, inliers, scale


def _compare(
    system: System, guess: Array, trusted: NDArray[np.bool_], closures: Index, config: GraphConfig
) -> Consistency:
    if system.kinds is not None:
        trusted = trusted & (system.kinds == 0)
    odometry = reckon(chosen_edges(system, trusted), guess)
    limit = float(chi_squared_quantile(config.consistency_probability, system.dimension))
    return compare_closures(chosen_edges(system, closures), odometry, limit)


def _fresh_start(
    system: System, guess: Array, anchors: Index, believed: NDArray[np.bool_]
) -> Array:
    part = chosen_edges(system, believed)
    stay = held_nodes(len(guess), part.tails, part.heads, anchors)
    try:
        return chordal_start(part, guess, np.flatnonzero(stay))
    except NotPositiveDefiniteError:  # nodes that no believed edge holds stay where they are
        return guess
