"""Which closures agree with each other, judged by odometry between their ends.

Pairwise consistency maximisation: Mangelson, Dominic, Eustice, Vasudevan, "Pairwise consistent
measurement set maximization for robust multi-robot map merging" (2018). Two closures and the
odometry between their ends make a loop; it must come back to where it began, within the
uncertainty of its four parts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mapmyworld.backend.connected_components import components
from mapmyworld.backend.factors import turned
from mapmyworld.backend.starts import along_tree, spanning_tree
from mapmyworld.backend.system import System
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import compose_planar, invert_planar, planar_adjoint, planar_log
from mapmyworld.geometry.rigid import invert, se3_adjoint, se3_log, transported

_PARTNERS = 12  # nearest closures each one is compared with
_EVIDENCE = 6.0  # log-likelihood ratio of true to chance from which two closures support each other
_ROUNDING = 1e-9  # of the largest entry, by which a singular covariance is made larger
_SMALLEST = 1e-300  # volume, so that its logarithm exists
_REACH = 200  # nodes of odometry between the ends of compared closures, at most


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """Dead reckoning along trusted edges, with its growing uncertainty."""

    poses: Array
    """(N, 3) or (N, 4, 4), each chain in a frame of its own."""
    spread: Array
    """(N, d, d) covariance since the chain's first node, of perturbations in that frame."""
    chain: Index
    """(N,) which chain a node belongs to."""


@dataclass(frozen=True, slots=True, eq=False)
class Consistency:
    """How closures agree."""

    pairs: Index
    """(P, 2) positions of compared closures, the lower first."""
    chi2: Array
    """(P,) squared sigmas by which their loop fails to close."""
    supporters: Index
    """(K,) partners a closure agrees with."""
    partners: Index
    """(K,) partners it was compared with."""
    clique: NDArray[np.bool_]
    """(K,) in the largest found set of mutually agreeing closures of its group, of two at least."""


def compare_closures(closures: System, odometry: Odometry, limit: float) -> Consistency:
    """The agreement of K closures, edges, with those that join the same sections of the path.

    They agree up to `limit` squared sigmas.
    """
    count = len(closures.tails)
    closures = turned(closures, closures.tails > closures.heads)
    pairs = _near_pairs(odometry.chain, closures.tails, closures.heads)
    chi2, volume = _loop_chi2(closures, odometry, pairs)
    evidence = (
        np.log(alternatives(closures.planar, closures.measured)) - 0.5 * chi2 - np.log(volume)
    )
    agree = (chi2 <= limit) & (evidence >= _EVIDENCE)
    differ = chi2 > limit
    supporters = np.bincount(pairs[agree].ravel(), minlength=count)
    partners = np.bincount(pairs.ravel(), minlength=count)
    clique = largest_agreeing_sets(count, pairs, differ, supporters)
    return Consistency(pairs, chi2, supporters, partners, clique)


def _near_pairs(chain: Index, tails: Index, heads: Index) -> Index:
    """(P, 2) closures whose ends lie near along the path, in the same chains."""
    if len(tails) < 2:
        return np.zeros((0, 2), np.int64)
    places = np.column_stack([tails, heads]).astype(np.float64)
    neighbours = min(_PARTNERS + 1, len(tails))
    distance, partner = cKDTree(places).query(places, neighbours, p=1, distance_upper_bound=_REACH)
    first = np.repeat(np.arange(len(tails)), neighbours)
    second, found = partner.ravel(), np.isfinite(distance.ravel())
    pairs = np.column_stack([first, second])[found & (first != second)]
    same = chain[tails[pairs]] == chain[tails[pairs[:, :1]]]
    same &= chain[heads[pairs]] == chain[heads[pairs[:, :1]]]
    return np.unique(np.sort(pairs[same.all(axis=1)], axis=1), axis=0).reshape(-1, 2)


def _loop_chi2(closures: System, odometry: Odometry, pairs: Index) -> tuple[Array, Array]:
    """(P,) squared sigmas by which `measured_k^-1 * odometry * measured_m * odometry` misses the
    identity, and the volume (P,) of its uncertainty.
    """
    planar, tails, heads = closures.planar, closures.tails, closures.heads
    measured, (k, m) = closures.measured, pairs.T
    spread = np.linalg.inv(closures.information)
    adjoint = planar_adjoint if planar else se3_adjoint
    compose = compose_planar if planar else np.matmul
    inverse = invert_planar if planar else invert
    poses = odometry.poses
    back = inverse(measured[k])
    to_tail = compose(back, inverse(poses[tails[k]]))
    around = compose(compose(to_tail, poses[tails[m]]), measured[m])
    to_head = compose(around, inverse(poses[heads[m]]))
    error = compose(to_head, poses[heads[k]])
    covariance = spread[k] + transported(adjoint(around), spread[m])
    for ends, here in ((tails, to_tail), (heads, to_head)):
        covariance += transported(adjoint(here), _between_spread(odometry, ends[k], ends[m]))
    covariance = definite(covariance)
    residual = planar_log(error) if planar else se3_log(error)
    solved = np.linalg.solve(covariance, residual[..., None])[..., 0]
    volume = np.sqrt(np.abs(np.linalg.det(2.0 * np.pi * covariance)))
    return np.einsum("ei,ei->e", residual, solved), np.maximum(volume, _SMALLEST)


def definite(covariance: Array) -> Array:
    """The covariances, those that rounding made singular a little larger, in place.

    (K, d, d) both, before and after.
    """
    lost = ~(np.linalg.det(covariance) > 0.0)
    size = covariance.shape[-1]
    more = _ROUNDING * np.abs(covariance[lost]).max(axis=(1, 2), initial=_ROUNDING)
    covariance[lost] += more[:, None, None] * np.eye(size)
    return covariance


def alternatives(planar: bool, measured: Array) -> float:
    """The volume of relative poses that a false closure could have measured instead.

    A ball of positions (m, m^2 or m^3) as wide as the longest `measured` (K, 3 or 4, 4), times all
    rotations.
    """
    places = measured[:, :2] if planar else measured[:, :3, 3]
    reach = max(1.0, float(np.linalg.norm(places, axis=1).max(initial=0.0)))
    if planar:
        return np.pi * reach**2 * 2.0 * np.pi
    return 4.0 / 3.0 * np.pi * reach**3 * 8.0 * np.pi**2


def _between_spread(odometry: Odometry, a: Index, b: Index) -> Array:
    """Covariance of the odometry between nodes of one chain, in the chain's frame."""
    later, earlier = np.maximum(a, b), np.minimum(a, b)
    return odometry.spread[later] - odometry.spread[earlier]


def largest_agreeing_sets(
    count: int,
    pairs: Index,
    differ: NDArray[np.bool_],
    supporters: Index,
) -> NDArray[np.bool_]:
    """(K,) members of cliques: greedy, most supported first, ties to the earlier closure.

    A closure joins unless a compared member of the clique disagrees with it; it starts one only
    with a supporter. Of the compared `pairs` (P, 2), some `differ` (P,), a mask; `supporters` (K,)
    counts those of each closure.
    """
    foes: list[set[int]] = [set() for _ in range(count)]
    for a, b in pairs[differ].tolist():
        foes[a].add(b)
        foes[b].add(a)
    chosen = np.zeros(count, np.bool_)
    banned = np.zeros(count, np.bool_)
    for seed in np.lexsort((np.arange(count), -supporters)).tolist():
        if supporters[seed] == 0 or banned[seed]:
            continue
        if not chosen[seed] and not any(chosen[f] for f in foes[seed]):
            chosen[seed] = True
        if chosen[seed]:
            for foe in foes[seed]:
                banned[foe] |= not chosen[foe]
    return chosen


def reckon(trusted: System, guess: Array) -> Odometry:
    """Poses and covariances of all N nodes by the trusted edges between them alone.

    Roots keep their `guess` (N, 3 or 4, 4).
    """
    planar, heads = trusted.planar, trusted.heads
    tree = spanning_tree(trusted, len(guess))
    poses = along_tree(planar, guess, tree.parents, tree.motions)
    adjoint = planar_adjoint(poses) if planar else se3_adjoint(poses)
    size = 3 if planar else 6
    step = np.zeros((len(guess), size, size))
    moved = tree.edges >= 0
    # An edge's covariance lives in the frame of the node that it points to.
    end = adjoint[heads[tree.edges[moved]]]
    step[moved] = transported(end, np.linalg.inv(trusted.information[tree.edges[moved]]))
    parents = tree.parents
    while not np.array_equal(parents, parents[parents]):
        step = step + step[parents]
        parents = parents[parents]
    return Odometry(poses, step, components(len(guess), trusted.tails, heads))
