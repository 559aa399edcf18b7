"""Wraparound hypotheses: starts with a full turn more or less, the other minima of long loops.

An angle is known but for whole turns, and where noise adds up to half a turn around a loop, how
often it turns is a question of cost. Headings alone are a linear problem for every choice, so the
cheapest other choices are found exactly. Carlone and Censi, "From angular manifolds to the integer
lattice" (2014).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mapmyworld.backend.block_matrix import Blocks, colamd_order_of, place_in
from mapmyworld.backend.information import Factorised
from mapmyworld.backend.starts import with_places
from mapmyworld.backend.system import System, fit_of
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import wrap_angle
from mapmyworld.geometry.rotations import so3_exp

_TURN = 2.0 * np.pi
_WORTH = 60.0  # squared sigmas of headings up to which another turn is tried
_NO_LOOP = 1e-9  # share of an edge's weight below which it closes no loop
_ASKED = 10_000_000  # numbers of answers that are held, which are as many as nodes per edge


def wraparound_starts(system: System, poses: Array, count: int) -> Iterator[Array]:
    """What a turn more or less makes of a minimum's poses, (N, 3 or 4, 4) both, likeliest first.

    At most about `count`. In space, where a heading is not a number, loops are wound about three
    axes, both ways.
    """
    turns = system.information[:, 2:3, 2:3] if system.planar else system.information[:, :3, :3]
    weights = np.asarray(turns.trace(0, 1, 2) / turns.shape[1])  # of rotations, a number each
    solver, edges = _headings(system, weights), _asked(system)
    answers = [_solved(system, solver, _at(e, weights)) for e in edges]
    corrected, left = np.zeros(len(poses)), np.zeros(len(weights))
    if system.planar:
        left = fit_of(system, poses).residuals[:, 2]
        corrected = _solved(system, solver, -weights * left)
        left = left + corrected[system.heads] - corrected[system.tails]
    gained = [a[system.heads[e]] - a[system.tails[e]] for e, a in zip(edges, answers, strict=True)]
    stiff = weights[edges] * (1.0 - np.array(gained))
    change = np.array([1.0, -1.0])[:, None] * 2.0 * _TURN * weights[edges] * left[edges]
    cost = np.where(stiff > _NO_LOOP * weights[edges], _TURN**2 * stiff, np.inf) + change
    choices = 1 if system.planar else 3
    for place in np.argsort(cost, axis=None, kind="stable")[: -(-count // choices)].tolist():
        sign, k = divmod(place, len(edges))
        if cost[sign, k] > _WORTH:
            return
        for turned in _turned(system, poses, corrected - (1 - 2 * sign) * _TURN * answers[k]):
            yield with_places(system, turned)


def _turned(system: System, poses: Array, angles: Array) -> Iterator[Array]:
    """Poses turned by angles (N,): in space about the axes of the first node that stays."""
    if system.planar:
        turned = poses.copy()
        turned[:, 2] = wrap_angle(poses[:, 2] + angles)
        yield turned
        return
    for axis in poses[np.flatnonzero(system.free < 0)[0], :3, :3].T:
        turned = poses.copy()
        turned[:, :3, :3] = so3_exp(angles[:, None] * axis) @ poses[:, :3, :3]
        yield turned


def _asked(system: System) -> Index:
    """Edges (A,) that stand for all: of edges one behind the other, which share every loop, one.

    Of a very large graph only some.
    """
    links_of = np.bincount(np.concatenate([system.tails, system.heads]))
    alike = (links_of[system.tails] == 2) & (system.heads == system.tails + 1)
    found = np.flatnonzero(~alike)
    every = -(-len(found) * len(system.free) // _ASKED)
    return found[:: max(1, every)]


def _at(edge: int, weights: Array) -> Array:
    found = np.zeros(len(weights))
    found[edge] = weights[edge]
    return found


def _headings(system: System, weights: Array) -> Factorised:
    """The equations of all headings; those of nodes that stay are held."""
    order = colamd_order_of(len(system.free), system.tails, system.heads)
    place, moves = place_in(order), system.free >= 0
    ends, inside = (system.tails, system.heads), moves[system.tails] & moves[system.heads]
    rows = np.concatenate([*ends, ends[0][inside], ends[1][inside]])
    columns = np.concatenate([*ends, ends[1][inside], ends[0][inside]])
    pulls = np.concatenate([weights, weights, -weights[inside], -weights[inside]])
    pulls[~moves[rows]] = 0.0
    matrix = Blocks.summed(len(order), place[rows], place[columns], pulls[:, None, None])
    return matrix.plus(1.0 - moves[order, None, None].astype(np.float64)).factorised(order)


def _solved(system: System, solver: Factorised, pull: Array) -> Array:
    """Headings (N,) for which edges pull (E,) at their heads, and as much against their tails."""
    count = len(system.free)
    right = np.bincount(system.heads, pull, count) - np.bincount(system.tails, pull, count)
    right[system.free < 0] = 0.0
    return solver.solve(np.asarray(right, np.float64))
