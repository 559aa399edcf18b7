"""Group hypotheses: closures that nothing predicts well, believed for what else they explain.

After a long drift a whole part of a path may be held by closures none of which fits too well for
chance, for the prediction is wide. Where one group of them is assumed to be true and groups that
have nothing to do with it then fit as they never would by chance, it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.backend.connected_components import Index
from mapmyworld.backend.descent import optimised_roughly
from mapmyworld.backend.system import System, believed_edges
from mapmyworld.geometry import Array
from mapmyworld.graph.inlier_recovery import left_out_fits, recoverable

_TRIES = 4  # groups that are assumed to be true, the best predicted first
_SMALLEST = 2  # closures of such a group
_OTHERS = 2  # groups besides it that must come in: one may do so by chance


def explaining(
    system: System,
    poses: Array,
    inliers: NDArray[np.bool_],
    closures: Index,
    groups: Index,
    limit: float,
    scale: float,
) -> NDArray[np.bool_]:
    """(E,) the group that explains most of what is left out, and that; nothing where none does.

    What comes in must be of several other groups, and more than the group itself. `poses`
    (N, 3 or 4, 4), map_from_node, are by the `inliers` (E,); `closures` are edges, `groups` their
    numbers, (K,) both; `limit` and `scale` as of `left_out_fits`.
    """
    number = np.full(len(inliers), -1)
    number[closures] = groups
    best = np.zeros(len(inliers), np.bool_)
    for group in _likeliest(system, poses, inliers, number, limit, scale):
        assumed = (number == group) & ~inliers
        trial = inliers | assumed
        moved = optimised_roughly(believed_edges(system, trial), poses)
        others = recoverable(system, moved, trial, limit, scale)
        enough = len(np.unique(number[others])) >= _OTHERS and others.sum() > assumed.sum()
        if enough and others.sum() + assumed.sum() > best.sum():
            best = others | assumed
    return best


def _likeliest(
    system: System,
    poses: Array,
    inliers: NDArray[np.bool_],
    number: Index,
    limit: float,
    scale: float,
) -> list[int]:
    """Groups left out of which all fit what is predicted, the least by chance first."""
    found = left_out_fits(system, poses, inliers, limit, scale)
    if found is None:
        return []
    of = number[found.candidates]
    order = np.argsort(found.chance, kind="stable")
    names, first, size = np.unique(of[order], return_index=True, return_counts=True)
    fitting = np.array([found.fits[of == name].all() for name in names], np.bool_)
    usable = fitting & (size >= _SMALLEST) & (names >= 0)
    return [int(name) for name in names[usable][np.argsort(first[usable])][:_TRIES]]
