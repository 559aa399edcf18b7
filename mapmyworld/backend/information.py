"""How certain a solution is: the information of gtsam's linear factors, and what it predicts.

gtsam linearises and orders (METIS), SuperLU factorises. What is asked of covariances is
`J inverse(A) J'` with few rows in J, one sweep up the elimination tree.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import SuperLU, splu

from mapmyworld.backend.factors import FactorGraph, elimination_order, factor_graph
from mapmyworld.backend.system import System
from mapmyworld.errors import GraphError
from mapmyworld.geometry import Array, Index
from mapmyworld.heap import give_back
from mapmyworld.parallel import in_threads

_TOGETHER = 48  # rows at a time: a processor works on several numbers at once


class NotPositiveDefiniteError(GraphError):
    """A matrix that has no Cholesky factor: the graph leaves something undetermined."""


@dataclass(frozen=True, slots=True, eq=False)
class Factorised:
    """A symmetric positive definite matrix as `L D L'`, its unknowns in another order."""

    factors: SuperLU
    order: Index
    """(n,) the unknown at each row of L."""

    @staticmethod
    def of(matrix: csc_array, order: Index) -> Factorised:
        """The factors of a matrix (n, n) of unknowns in this order (n,).

        Raises `NotPositiveDefiniteError` where they have no unique solution.
        """
        try:
            found = splu(matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0,
                         options={"SymmetricMode": True})  # fmt: skip
        except RuntimeError:
            raise NotPositiveDefiniteError("the edges leave a node undetermined") from None
        swapped = (found.perm_r != np.arange(len(order))).any()
        if swapped or not (found.U.diagonal() > 0.0).all():
            raise NotPositiveDefiniteError("the edges leave a node undetermined")
        return Factorised(found, order)

    def solve(self, right: Array) -> Array:
        """The solution (n,) or (n, K) for this right-hand side."""
        found = np.empty(right.shape)
        found[self.order] = self.factors.solve(np.asarray(right[self.order], np.float64))
        return found

    def predict(self, asked: csr_array, groups: Index) -> list[Array]:
        """`J_g inverse(A) J_g'` (k, k) for every group of k rows of `asked`, J (R, n).

        Group g has the rows from `groups[g]` on; `groups` (G + 1,) ends with R.
        """
        from mapmyworld.kernels.prediction import predict

        place, lower = np.argsort(self.order), self.factors.L
        sizes = np.diff(groups)
        ends = np.concatenate([[0], np.cumsum(sizes**2)])
        found = np.zeros(ends[-1])
        given = (
            lower.indptr, lower.indices, lower.data, self.factors.U.diagonal(),
            asked.indptr.astype(np.int32), place[asked.indices], asked.data, groups, ends, found,
        )  # fmt: skip
        together = itertools.pairwise(_together(groups.tolist()))
        for _ in in_threads(lambda some: predict(*some, *given), together, 0):
            pass
        return [
            found[a:b].reshape(size, size)
            for a, b, size in zip(
                ends[:-1].tolist(), ends[1:].tolist(), sizes.tolist(), strict=True
            )
        ]


def _together(groups: Sequence[int]) -> list[int]:
    """Where groups of rows, each from one of `groups` (G + 1,) on, are parted into batches."""
    edges = [0]
    for g in range(1, len(groups) - 1):
        if groups[g + 1] - groups[edges[-1]] > _TOGETHER:
            edges.append(g)
    return [*edges, len(groups) - 1]


def normal_matrix(jacobian: csr_array, order: Index) -> csc_array:
    """`J' J` (n, n) of J (R, n), its unknowns in this order (n,)."""
    ordered = jacobian[:, order]
    return csc_array(ordered.T @ ordered)


@dataclass(frozen=True, slots=True, eq=False)
class Variables:
    """Where gtsam's variables stand among all unknowns."""

    keys: Index
    """(K,) ascending."""
    starts: Index
    """(K + 1,) the first unknown of each."""

    @staticmethod
    def of(values: Any) -> Variables:
        """Those of gtsam's values."""
        dims = values.dims()
        keys = np.array(sorted(dims), np.int64)
        sizes = [dims[key] for key in keys.tolist()]
        return Variables(keys, np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64))

    def unknowns(self, keys: Index) -> Index:
        """(n,) unknowns of these variables (K,), one variable after the other."""
        at = np.searchsorted(self.keys, keys)
        sizes = self.starts[at + 1] - self.starts[at]
        before = np.cumsum(sizes) - sizes
        return np.asarray(np.arange(sizes.sum()) + np.repeat(self.starts[at] - before, sizes))

    def elimination(self, factors: Any) -> Index:
        """(n,) unknowns in METIS's order; raises `NotPositiveDefiniteError` where some are free."""
        order = np.array(elimination_order(factors), np.int64)
        if len(order) < len(self.keys):
            raise NotPositiveDefiniteError("the edges leave a node undetermined")
        return self.unknowns(order)

    def jacobian(self, linear: Any) -> tuple[csr_array, Array]:
        """The whitened derivatives (R, n) of gtsam's linear factors, and their right-hand side
        (R,): less the whitened residuals.
        """
        unknowns = self.unknowns(np.array(linear.keyVector(), np.int64))
        rows, columns, numbers = linear.sparseJacobian_()
        rows, columns = rows.astype(np.int64) - 1, columns.astype(np.int64) - 1
        count, inside = int(rows.max(initial=-1)) + 1, columns < len(unknowns)
        right = np.zeros(count)
        right[rows[~inside]] = numbers[~inside]
        places = rows[inside], unknowns[columns[inside]]
        shape = count, int(self.starts[-1])
        return csr_array((numbers[inside], places), shape=shape), right


@dataclass(frozen=True, slots=True, eq=False)
class Information:
    """The information of all variables of a factor graph, factorised."""

    values: Any
    """gtsam's, which it is at."""
    variables: Variables
    factorised: Factorised

    @staticmethod
    def of(graph: FactorGraph) -> Information:
        """At the graph's values; raises `NotPositiveDefiniteError`."""
        variables = Variables.of(graph.values)
        order = variables.elimination(graph.factors)
        linear = graph.factors.linearize
        normal = normal_matrix(variables.jacobian(linear(graph.values))[0], order)
        give_back()  # gtsam's linear factors: SuperLU's come on top of what is held
        return Information(graph.values, variables, Factorised.of(normal, order))

    def marginals(self, keys: Index) -> list[Array]:
        """The covariance (d, d) of each of these variables (K,)."""
        unknowns = self.variables.unknowns(keys)
        at = np.searchsorted(self.variables.keys, keys)
        sizes = np.diff(self.variables.starts)[at]
        count = int(self.variables.starts[-1])
        places = np.arange(len(unknowns)), unknowns
        own = csr_array((np.ones(len(unknowns)), places), shape=(len(unknowns), count))
        return self.factorised.predict(own, np.concatenate([[0], np.cumsum(sizes)]))


def information_of(system: System, poses: Array) -> Information:
    """The information of the free nodes at `poses` (N, 3 or 4, 4), map_from_node.

    Raises `NotPositiveDefiniteError` where the edges leave a node undetermined.
    """
    return Information.of(factor_graph(system, poses))
