"""Groups of closures that agree with each other, each judged as one by all that is not in it.

Agreement within a group proves little: identical corridors agree with each other too. So a group
must fit what the rest of the graph predicts without it, and must fit too well for chance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from mapmyworld.backend.connected_components import components
from mapmyworld.backend.descent import optimised_roughly
from mapmyworld.backend.information import information_of
from mapmyworld.backend.predictions import Prediction, predictions
from mapmyworld.backend.residuals import chi_squared_quantile
from mapmyworld.backend.system import System, believed_edges
from mapmyworld.geometry import Array, Index
from mapmyworld.graph.consistency import Consistency, alternatives

_NEAR = 30  # nodes of path between the ends of closures of one group, at most
_LARGEST = 60  # closures of a group that are compared with the rest, at most: they stand for all
HEAVY = 2.0
"""Times the limit that a lone closure may reach where chance does not explain it."""
_UNBIASED = 1e-6  # share of a group's information left by the rest, below which nothing predicts it


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """Groups against the rest of the graph."""

    members: tuple[Index, ...]
    """(C,) positions of the edges of every group."""
    excess: Array
    """(G,) squared sigmas over what may be: above one is contradicted.

    What may be follows the typical group where that misses by more than stated.
    """
    evidence: Array
    """(G,) logarithm of how much likelier the group's best fit is than chance."""
    scale: float
    """Squared sigmas of the typical group over what its covariances indicate."""


def groups_of(system: System, closures: Index, consistency: Consistency, limit: float) -> Index:
    """(K,) number of the group of every closure: those that agree and lie near along the path.

    `closures` (K,) are positions of edges; they agree within `limit` squared sigmas.
    """
    pairs = consistency.pairs
    tails = np.minimum(system.tails, system.heads)[closures]
    heads = np.maximum(system.tails, system.heads)[closures]
    apart = np.abs(np.diff(tails[pairs], axis=1)) + np.abs(np.diff(heads[pairs], axis=1))
    agree = (consistency.chi2 <= limit) & (apart[:, 0] <= _NEAR)
    return components(len(closures), pairs[agree, 0], pairs[agree, 1])


def chance_of(fit: Array, volume: Array, space: float, freedom: int) -> Array:
    """(K,) chance that a false closure comes within squared sigmas `fit` (K,) of a prediction.

    The share that this ellipsoid around the prediction, of `volume` (K,), has of all alternatives,
    of which `space` is the logarithm of the volume.
    """
    ball = 0.5 * freedom * np.log(np.maximum(fit, 1e-9) / 2.0) - gammaln(0.5 * freedom + 1.0)
    return np.asarray(np.exp(np.minimum(ball + np.log(volume) - space, 0.0)))


def evidence_of(fit: Array, volume: Array, space: float, scale: float, freedom: int) -> Array:
    """(K,) logarithm of how much likelier `fit` (K,) is of a true closure than of chance.

    `fit` is in squared sigmas; `volume` (K,) is that of the prediction, `space` the logarithm of
    that of all alternatives. Where covariances are stated too large, true ones show it by how well
    they fit: believed is what scale, between the typical one and the stated one, suits each best.
    """
    sharp = np.clip(fit / freedom, min(max(scale, 1e-4), 1.0), 1.0)
    normalised = fit / sharp + freedom * np.log(sharp)
    return np.asarray(space - np.log(volume) - 0.5 * normalised)


def judge_groups(
    system: System,
    poses: Array,
    inliers: NDArray[np.bool_],
    closures: Index,
    groups: Index,
    probability: float,
) -> Judgement:
    """Every group among the `inliers` against the solution that the others would give.

    Leaving a group of information W out changes its residuals r to those that the rest predicts;
    with P, their covariance by the whole solution, the squared sigmas become
    `r' W (W - W P W)^-1 W r`, all at the price of one factorisation. Of a large group some stand
    for all.

    `poses` (N, 3 or 4, 4) are that solution, `inliers` (E,) its edges, `closures` (K,) positions of
    edges and `groups` (K,) the number of the group of each.
    """
    members = _members(inliers, closures, groups)
    kept = tuple(m[:: -(-len(m) // _LARGEST)] for m in members)
    compared = inliers.copy()
    for every, some in zip(members, kept, strict=True):
        compared[every] = False
        compared[some] = True
    part = believed_edges(system, compared)
    if (compared != inliers).any():
        poses = optimised_roughly(part, poses)
    space = np.log(alternatives(system.planar, system.measured[closures]))
    found = np.zeros((len(kept), 3))
    anchored = replace(system, free=part.free)
    predicted = predictions(information_of(part, poses), anchored, poses, kept)
    for k, one in enumerate(predicted):
        found[k] = _left_out(one, system.information[kept[k]])
    chi2, freedom, volume = found.T
    scale = float(np.median(chi2 / chi_squared_quantile(0.5, freedom))) if len(kept) else 1.0
    fit = chi2 * system.dimension / freedom
    evidence = evidence_of(fit, volume, space, scale, system.dimension)
    most = np.where(freedom == system.dimension, HEAVY, 1.0) * max(scale, 1.0)
    excess = chi2 / (most * chi_squared_quantile(probability, freedom))
    return Judgement(members, excess, evidence, scale)


def _members(inliers: NDArray[np.bool_], closures: Index, groups: Index) -> tuple[Index, ...]:
    """(C,) positions of the believed edges of every group; arguments as of `judge_groups`."""
    believed = np.flatnonzero(inliers[closures])
    order = believed[np.argsort(groups[believed], kind="stable")]
    split = np.split(order, np.flatnonzero(np.diff(groups[order])) + 1)
    return tuple(closures[m] for m in split if len(m))


def _left_out(predicted: Prediction, information: Array) -> tuple[float, float, float]:
    """Squared sigmas of a group of C edges, their degrees of freedom, and the prediction's volume.

    The volume is that of the best predicted member; none where the group is all that holds a part.
    """
    count, size = information.shape[:2]
    # What is left of the identity says how well the rest predicts each direction.
    values, vectors = np.linalg.eigh(np.eye(count * size) - predicted.covariance)
    if values[0] < _UNBIASED:
        return 0.0, 1.0, 1e-300
    along = vectors.T @ predicted.residuals
    spread = ((vectors / values) @ vectors.T).reshape(count, size, count, size)
    own = spread[np.arange(count), :, np.arange(count)]
    stated = np.linalg.det(information)
    volume = float(np.sqrt(np.linalg.det(2.0 * np.pi * own) / stated).min())
    return float(np.sum(along**2 / values)), float(count * size), max(volume, 1e-300)
