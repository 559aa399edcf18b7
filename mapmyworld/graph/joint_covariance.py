"""Covariances of edges' residuals, as a factorised solution predicts them.

What a group of edges asks, E' inverse(A) E with few rows in E, needs only the part of the
elimination tree between its nodes and the first clique that sees all of them: E is carried up to
that clique, and the inverse over its front gives the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg.blas import dtrsm

from mapmyworld.geometry import Array
from mapmyworld.graph.cholesky import Factors
from mapmyworld.graph.pose_graph import Index
from mapmyworld.graph.system import System, chosen_edges, jacobians_of, residuals_of

_MANY = 1000  # edges from which on it is worth to compile what carries them all at once


@dataclass(frozen=True, slots=True, eq=False)
class _Carried:
    """A group's question where one clique sees all that is left of it."""

    clique: int
    rows: Array
    """(F, K) of E over the front of that clique."""
    found: Array
    """(K, K) what the cliques below have answered."""


def joint_covariances(
    factors: Factors, system: System, poses: Array, groups: Sequence[Index]
) -> tuple[list[Array], list[Array]]:
    """Residuals (C, d) of every group of edges, and their covariance (C d, C d) together, as the
    solution predicts them.
    """
    if not groups:
        return [], []
    asked = chosen_edges(system, np.concatenate(groups))
    residuals = residuals_of(asked, poses)
    by_tail, by_head = jacobians_of(asked, poses, residuals)
    tree = _Tree.of(factors)
    place = np.argsort(factors.symbolic.order)
    ends = [np.where(system.free[e] < 0, -1, place[e]) for e in (asked.tails, asked.heads)]
    first = np.cumsum([0, *map(len, groups)])
    carried = [
        _carried(tree, ends[0][a:b], ends[1][a:b], by_tail[a:b], by_head[a:b])
        for a, b in zip(first[:-1].tolist(), first[1:].tolist(), strict=True)
    ]
    sizes = [len(group) * system.dimension for group in groups]
    return np.split(residuals, first[1:-1]), _answers(factors, carried, sizes)


def predicted_covariances(factors: Factors, system: System, poses: Array) -> tuple[Array, Array]:
    """Covariances (E, d, d) of the edges' residuals as the solution predicts them, each for
    itself, and these residuals.
    """
    size, residuals = system.dimension, residuals_of(system, poses)
    if len(residuals) < _MANY:
        alone = np.arange(len(residuals)).reshape(-1, 1)
        found = joint_covariances(factors, system, poses, list(alone))[1]
    else:
        carried = _carried_at_once(factors, system, *jacobians_of(system, poses, residuals))
        found = _answers(factors, carried, [size] * len(residuals))
    return np.reshape(found, (-1, size, size)), residuals


def _carried_at_once(
    factors: Factors, system: System, by_tail: Array, by_head: Array
) -> list[_Carried | None]:
    """The question of each edge, eliminated upwards; None where nothing in it moves."""
    from mapmyworld.kernels.edge_questions import carry_up, meeting_cliques

    symbolic, count = factors.symbolic, len(by_tail)
    owner = np.repeat(np.arange(len(symbolic.cliques)), np.diff(symbolic.bounds))
    parents = np.array([clique.parent for clique in symbolic.cliques])
    tree, place = (owner, parents), np.argsort(symbolic.order)
    tails, heads = (
        np.where(system.free[e] < 0, -1, place[e]) for e in (system.tails, system.heads)
    )
    ends, stops = (tails, heads), np.empty(count, np.int64)
    meeting_cliques(*ends, *tree, symbolic.begins, symbolic.rows, stops)
    fronts = (np.diff(symbolic.bounds) + np.diff(symbolic.begins)) * symbolic.size
    offsets = np.concatenate([[0], np.cumsum(np.where(stops < 0, 0, fronts[stops]))])
    found, left = np.zeros(by_tail.shape), np.empty((offsets[-1], symbolic.size))
    layout = symbolic.bounds, symbolic.begins, symbolic.rows, symbolic.starts
    given, answers = (by_tail, by_head), (found, left)
    carry_up(*layout, factors.values, *tree, *ends, *given, stops, offsets, *answers)
    return [
        None if stop < 0 else _Carried(stop, left[a:b], found[k])
        for k, (stop, (a, b)) in enumerate(
            zip(stops.tolist(), pairwise(offsets.tolist()), strict=True)
        )
    ]


@dataclass(frozen=True, slots=True, eq=False)
class _Tree:
    """The factors, and who eliminates what."""

    factors: Factors
    owner: list[int]
    """(N,) the clique that eliminates each place."""

    @staticmethod
    def of(factors: Factors) -> _Tree:
        cliques = factors.symbolic.cliques
        widths = [c.last - c.first for c in cliques]
        return _Tree(factors, np.repeat(np.arange(len(cliques)), widths).tolist())

    def front_of(self, number: int) -> int:
        """Scalars of a clique's front."""
        below = self.factors.below[number]
        return int(sum(below.shape))

    def place_in(self, number: int, place: int) -> int:
        """The first scalar of a node in a clique's front; -1 where it does not occur."""
        clique, size = self.factors.symbolic.cliques[number], self.factors.symbolic.size
        if place < clique.last:
            return (place - clique.first) * size
        k = int(clique.rows.searchsorted(place))
        if k == len(clique.rows) or clique.rows[k] != place:
            return -1
        return (clique.last - clique.first + k) * size


def _carried(
    tree: _Tree, tails: Index, heads: Index, by_tail: Array, by_head: Array
) -> _Carried | None:
    """The question of a group of edges, eliminated upwards; None where nothing in it moves."""
    size = by_tail.shape[1]
    columns = len(tails) * size
    waiting: dict[int, Array] = {}
    for k, (tail, head) in enumerate(zip(tails.tolist(), heads.tolist(), strict=True)):
        _enter(tree, waiting, columns, k * size, [(tail, by_tail[k]), (head, by_head[k])])
    if not waiting:
        return None
    found = np.zeros((columns, columns))
    while True:
        number = min(waiting)
        front = waiting.pop(number)
        if not waiting:
            return _Carried(number, front, found)
        clique, triangle = tree.factors.symbolic.cliques[number], tree.factors.triangles[number]
        width = len(triangle)
        solved = dtrsm(1.0, triangle, front[:width], lower=1)
        found += solved.T @ solved
        if clique.parent < 0:
            continue
        if clique.parent not in waiting:
            waiting[clique.parent] = np.zeros((tree.front_of(clique.parent), columns))
        update = front[width:] - tree.factors.below[number] @ solved
        waiting[clique.parent][clique.into_parent] += update


def _enter(
    tree: _Tree,
    waiting: dict[int, Array],
    columns: int,
    column: int,
    ends: list[tuple[int, Array]],
) -> None:
    """Enters what an edge asks of its ends, if possible at one clique that sees both."""
    moving = sorted(((p, j) for p, j in ends if p >= 0), key=lambda end: end[0])
    number = -1
    for place, jacobian in moving:
        at = tree.place_in(number, place) if number >= 0 else -1
        if at < 0:
            number = tree.owner[place]
            at = tree.place_in(number, place)
        if number not in waiting:
            waiting[number] = np.zeros((tree.front_of(number), columns))
        size = len(jacobian)
        waiting[number][at : at + size, column : column + size] += jacobian.T


def _answers(
    factors: Factors, carried: Sequence[_Carried | None], sizes: Sequence[int]
) -> list[Array]:
    """What every question comes to, with the inverse over the front of its last clique."""
    found = [np.zeros((size, size)) for size in sizes]
    waiting: dict[int, list[tuple[int, _Carried]]] = {}
    for k, question in enumerate(carried):
        if question is not None:
            waiting.setdefault(question.clique, []).append((k, question))
    if not waiting:
        return found
    for number, front in factors.fronts(np.array(sorted(waiting), np.int64)):
        for k, question in waiting.get(number, ()):
            found[k] = question.found + question.rows.T @ front @ question.rows
    return found
