"""Which images show the same place: words in common, weighed, over the whole log."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from mapmyworld.geometry import Array

NEIGHBOURS = 2
"""Nodes to either side that show much the same, as far as a robot gets while it passes one."""
_ALIKE = 0.6  # of the best similarity, from which another place is looked at as well


def weigh_words(words: Sequence[NDArray[np.int32]], size: int) -> scipy.sparse.csr_matrix:
    """Unit vectors (N, W + 1) of each image's words (K,), weighed by tf-idf; W is `size`.

    Sivic and Zisserman, "Video Google" (2003): share of the image's words, times the logarithm of
    how many images there are for each that holds the word.
    """
    rows = np.repeat(np.arange(len(words)), [len(w) for w in words])
    columns = np.concatenate([*words, np.zeros(0, np.int32)]).astype(np.int64)
    known = columns > 0
    counts = scipy.sparse.csr_matrix(
        (np.ones(np.count_nonzero(known)), (rows[known], columns[known])),
        shape=(len(words), size + 1),
    )
    counts.sum_duplicates()
    weighed = counts.multiply(inverse_frequencies(words, size)[None, :]).tocsr()
    length = np.sqrt(np.asarray(weighed.multiply(weighed).sum(axis=1))).reshape(-1, 1)
    return scipy.sparse.csr_matrix(weighed.multiply(1.0 / np.maximum(length, 1e-12)))


def inverse_frequencies(words: Sequence[NDArray[np.int32]], size: int) -> Array:
    """Logarithm (W + 1,) of how many images there are for each that holds a word (K,)."""
    holders = np.zeros(size + 1)
    for one in words:
        holders[np.unique(one[one > 0])] += 1
    return np.asarray(np.log(max(len(words), 1) / np.maximum(holders, 1)), np.float64)


def find_candidates(
    words: Sequence[NDArray[np.int32]],
    size: int,
    stamps_ns: NDArray[np.int64],
    sessions: NDArray[np.int64],
    *,
    gap_s: float,
    least_similarity: float,
    most: int,
) -> list[tuple[int, int, float]]:
    """Pairs worth verifying, each node with the `most` places that it looks most like.

    By index, the later one first, with the cosine of their weighed words. Of each of N images the
    `words` (K,), `stamps_ns` (N,) and `sessions` (N,). Nodes of one session closer than `gap_s`
    seconds are not the same place again. Of neighbouring places only the best is proposed. Places
    nearly as similar as the best one are proposed too: that they look alike must be known before
    one is believed.
    """
    vectors = weigh_words(words, size)
    best: dict[tuple[int, int], float] = {}
    for i in range(len(words)):
        row = (vectors[i] @ vectors.T).toarray()[0]
        close = np.abs(stamps_ns - stamps_ns[i]) < int(gap_s * 1e9)
        row[close & (sessions == sessions[i])] = 0.0
        worth = (row >= least_similarity) & (row >= _ALIKE * row.max())
        order = np.argsort(-row, kind="stable")
        for j in distinct(order[worth[order]], most):
            best[max(i, j), min(i, j)] = float(row[j])
    pairs = [(*pair, similarity) for pair, similarity in best.items()]
    return sorted(pairs, key=lambda pair: (pair[0], -pair[2], pair[1]))


def distinct(order: NDArray[np.int64], most: int) -> list[int]:
    """The first few indices of `order` (N,) that are no neighbours of each other."""
    chosen: list[int] = []
    for j in order.tolist():
        if len(chosen) < most and all(abs(j - other) > NEIGHBOURS for other in chosen):
            chosen.append(j)
    return chosen
