"""Inlier recovery: closures left out that the solution predicts too well for chance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.backend.connected_components import components
from mapmyworld.backend.information import NotPositiveDefiniteError, information_of
from mapmyworld.backend.predictions import predictions
from mapmyworld.backend.system import System, believed_edges, chosen_edges, edge_chi2
from mapmyworld.geometry import Array, Index
from mapmyworld.graph.clusters import HEAVY, chance_of
from mapmyworld.graph.consistency import alternatives

_CANDIDATES = 3000  # closures left out that are tried again at once, best fitting first
_LOGARITHMS = -690.0, 690.0  # of volumes that a float can hold
_FALSE = 0.2  # false closures that chance may let into a whole graph, expected


def recoverable(
    system: System, poses: Array, inliers: NDArray[np.bool_], limit: float, scale: float
) -> NDArray[np.bool_]:
    """(E,) edges left out that the solution predicts, and too well to be chance.

    The prediction's own uncertainty counts: a closure after a long drift may miss by metres and be
    true. Where many closures look false, fitting by chance becomes likely, and a lone closure must
    fit the better. Those that chance hardly explains may miss by more than stated.

    Left out are those not of `inliers` (E,), which led to `poses` (N, 3 or 4, 4), map_from_node.
    `limit` is in squared sigmas; `scale` is the typical group's, as in `Judgement`.
    """
    recovered = np.zeros(len(inliers), np.bool_)
    part = components(len(poses), system.tails[inliers], system.heads[inliers])
    within = part[system.tails] == part[system.heads]  # nothing predicts what joins two components
    candidates = np.flatnonzero(~inliers & within)
    chi2 = edge_chi2(system, poses)[candidates]
    candidates = candidates[np.argsort(chi2, kind="stable")[:_CANDIDATES]]
    if len(candidates) == 0:
        return recovered
    try:
        fit, volume = innovations(system, poses, inliers, candidates)
    except NotPositiveDefiniteError:  # a landmark that is seen once has no covariance
        return recovered
    space = float(np.log(alternatives(system.planar, system.measured[~inliers])))
    farthest = np.full(len(fit), HEAVY * limit * max(scale, 1.0))
    chance, most = (chance_of(f, volume, space, system.dimension) for f in (fit, farthest))
    lucky = expected_below(chance, most[fit > farthest])
    recovered[candidates] = (fit <= farthest) & (lucky <= _FALSE)
    return recovered


def expected_below(chance: Array, most: Array) -> Array:
    """(C,) false closures, of L with at most chances `most` (L,) to fit at all, that would fit by a
    chance as small as `chance` (C,).
    """
    ordered = np.sort(most)
    below = np.searchsorted(ordered, chance)
    return np.concatenate([[0.0], np.cumsum(ordered)])[below] + chance * (len(most) - below)


def innovations(
    system: System, poses: Array, inliers: NDArray[np.bool_], candidates: Index
) -> tuple[Array, Array]:
    """Squared sigmas of edges against what the inliers (E,) predict, and its volume, (C,) both.

    Edges at positions `candidates` (C,), at `poses` (N, 3 or 4, 4).
    """
    part = believed_edges(system, inliers)
    tested = replace(chosen_edges(system, candidates), free=part.free)
    alone = list(np.arange(len(candidates)).reshape(-1, 1))
    found = predictions(information_of(part, poses), tested, poses, alone)
    missed = np.stack([one.residuals for one in found])
    predicted, axes = np.linalg.eigh(np.stack([one.covariance for one in found]))
    variances = 1.0 + np.maximum(predicted, 0.0)  # of whitened residuals: rounding takes none
    fit = (np.einsum("eia,ei->ea", axes, missed) ** 2 / variances).sum(1)
    stated = np.linalg.slogdet(tested.information)[1]
    volume = np.exp(np.clip(0.5 * (np.log(2.0 * np.pi * variances).sum(1) - stated), *_LOGARITHMS))
    return fit, volume
