"""Which images show the same place: words in common, weighed, and smoothed over the whole log."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

Array = NDArray[np.float64]
NEIGHBOURS = 2
"""Nodes to either side that show much the same, as far as a robot gets while it passes one."""
_CHANGES = 0.1  # probability that a known place is followed by an unknown one, or the reverse
_ALIKE = 0.6  # of the best similarity, from which another place is looked at as well


@dataclass(frozen=True, slots=True)
class Candidate:
    """Two nodes, by index, that may show the same place."""

    index: int
    """The later one."""
    other: int
    similarity: float
    """Cosine of their weighed words."""
    posterior: float
    """Probability after smoothing that `index` is at `other` or a neighbour of it."""


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
    holders = np.bincount(counts.indices, minlength=size + 1)
    idf = np.log(max(len(words), 1) / np.maximum(holders, 1))
    weighed = counts.multiply(idf[None, :]).tocsr()
    length = np.sqrt(np.asarray(weighed.multiply(weighed).sum(axis=1))).reshape(-1, 1)
    return scipy.sparse.csr_matrix(weighed.multiply(1.0 / np.maximum(length, 1e-12)))


def find_candidates(
    words: Sequence[NDArray[np.int32]],
    size: int,
    stamps_ns: NDArray[np.int64],
    sessions: NDArray[np.int64],
    *,
    gap_s: float,
    least_similarity: float,
    least_posterior: float,
    most: int,
) -> list[Candidate]:
    """Pairs worth verifying, each node with its `most` best places, most likely first.

    Of each of N images the `words` (K,), `stamps_ns` (N,) and `sessions` (N,). Nodes of one session
    closer than `gap_s` seconds are not the same place again. Of neighbouring places only the best
    is proposed. Places nearly as similar as the best one are proposed too, whatever the filter
    thinks: that they look alike must be known before one is believed.
    """
    looks = _Looks(
        weigh_words(words, size), stamps_ns, sessions, int(gap_s * 1e9), _segment(len(words))
    )
    best: dict[tuple[int, int], Candidate] = {}
    for i, row, posterior in smoothed_places(looks):
        around = _around(posterior)
        worth = (around >= least_posterior) | (row >= _ALIKE * row.max())
        worth &= row >= least_similarity
        order = np.argsort(-(row * (0.2 + around)), kind="stable")
        proposed = _distinct(order[worth[order]], most)
        for j in proposed:
            pair = (max(i, j), min(i, j))
            candidate = Candidate(*pair, float(row[j]), float(around[j]))
            if pair not in best or best[pair].posterior < candidate.posterior:
                best[pair] = candidate
    return sorted(best.values(), key=lambda c: (c.index, -c.posterior * c.similarity, c.other))


@dataclass(frozen=True, slots=True)
class _Looks:
    """How alike nodes look, worked out segment by segment: all pairs of a long log fill memory."""

    vectors: scipy.sparse.csr_matrix
    stamps_ns: NDArray[np.int64]
    sessions: NDArray[np.int64]
    gap_ns: int
    segment: int
    """Nodes that are looked at together: as many as there are segments, to hold least of both."""

    def similarities(self, first: int) -> NDArray[np.float32]:
        """(B, N) of the segment of nodes from `first` on; 0 for what is not the place again."""
        last = min(first + self.segment, len(self.stamps_ns))
        found = (self.vectors[first:last] @ self.vectors.T).toarray().astype(np.float32)
        close = np.abs(self.stamps_ns[first:last, None] - self.stamps_ns) < self.gap_ns
        found[close & (self.sessions[first:last, None] == self.sessions)] = 0.0
        return np.asarray(found)


def smoothed_places(
    looks: _Looks,
) -> Iterator[tuple[int, NDArray[np.float32], NDArray[np.float32]]]:
    """Each node i, from the last to the first, with two rows, (N,) both.

    How alike the others look, and the probability that i is at the place of node j given the whole
    log. A discrete Bayes filter over "at node j" or "at a new place" as in Angeli et al., "Fast and
    incremental method for loop-closure detection using bags of visual words" (2008), run forwards
    and backwards. A place's likelihood grows with how far its similarity stands out of its row.
    Going back, each segment is run forwards once more from the state in which it began.
    """
    firsts = range(0, len(looks.stamps_ns), looks.segment)
    state = (np.zeros(len(looks.stamps_ns)), 1.0)
    begun = []
    for first in firsts:
        begun.append(state)
        *_, state = _forwards(*_likelihoods(looks.similarities(first)), state)
    ahead, new_ahead = np.ones(len(looks.stamps_ns)), 1.0  # likelihood of what follows
    for first, state in zip(reversed(firsts), reversed(begun), strict=True):
        similarity = looks.similarities(first)
        likelihood, unknown = _likelihoods(similarity)
        posterior, new, _ = _forwards(likelihood, unknown, state)
        for k in range(len(similarity) - 1, -1, -1):
            row = posterior[k]
            row *= ahead
            row /= max(float(row.sum()) + new[k] * new_ahead, 1e-30)
            yield first + k, similarity[k], row
            ahead, new_ahead = _backwards(likelihood[k], unknown[k], ahead, new_ahead)


def _likelihoods(similarity: NDArray[np.float32]) -> tuple[NDArray[np.float32], Array]:
    """Likelihood (B, N) of each place and (B,) of a new one; places ruled out have 0."""
    allowed = similarity > 0
    count = np.maximum(allowed.sum(axis=1), 1)
    mean = similarity.sum(axis=1) / count
    spread = np.sqrt(np.maximum((similarity**2).sum(axis=1) / count - mean**2, 0.0))
    limit = (mean + spread)[:, None]
    raised = (similarity - spread[:, None]) / np.maximum(mean, 1e-6)[:, None]
    likelihood = np.where(similarity > limit, np.maximum(raised, 1.0), 1.0) * allowed
    unknown = 1.0 + mean / np.maximum(spread, 1e-6)
    return likelihood.astype(np.float32), np.clip(unknown, 1.0, 10.0)


def _forwards(
    likelihood: NDArray[np.float32], unknown: Array, state: tuple[Array, float]
) -> tuple[NDArray[np.float32], Array, tuple[Array, float]]:
    """Posterior (B, N) of each place and (B,) of a new one, given the nodes so far.

    `state` is the pair of them before the first node; returned last is that after the last.
    """
    posterior, new = np.zeros(likelihood.shape, np.float32), np.zeros(len(likelihood))
    places, at_new = state
    for i in range(len(likelihood)):
        entered = _CHANGES * at_new / _allowed(likelihood[i])
        left = _CHANGES * float(places.sum())
        places = likelihood[i] * ((1.0 - _CHANGES) * _blurred(places) + entered)
        at_new = float(unknown[i]) * ((1.0 - _CHANGES) * at_new + left)
        total = float(places.sum()) + at_new
        places, at_new = places / total, at_new / total
        posterior[i], new[i] = places, at_new
    return posterior, new, (places, at_new)


def _backwards(
    likelihood: NDArray[np.float32], unknown: float, ahead: Array, new_ahead: float
) -> tuple[Array, float]:
    """How likely the nodes from the next one on are, for each place now and for a new one."""
    places, new = likelihood * ahead, unknown * new_ahead
    before = (1.0 - _CHANGES) * _blurred(places) + _CHANGES * new
    entered = _CHANGES * float(places.sum()) / _allowed(likelihood)
    new_before = (1.0 - _CHANGES) * new + entered
    scale = max(new_before, float(before.max()))
    return before / scale, new_before / scale


def _allowed(likelihood: NDArray[np.float32]) -> int:
    return max(int(np.count_nonzero(likelihood)), 1)


def _blurred(places: Array) -> Array:
    """The places (N,) after one step: forwards or backwards by a node or two."""
    return _summed(places) / (2 * NEIGHBOURS + 1)


def _around(posterior: NDArray[np.float32]) -> NDArray[np.float32]:
    """Probability (N,) of being at each place or at one of its neighbours."""
    return _summed(posterior).astype(np.float32)


def _summed(places: Array | NDArray[np.float32]) -> Array:
    """What each place (N,) and its neighbours hold together."""
    summed = np.convolve(places, np.ones(2 * NEIGHBOURS + 1), mode="full")
    return np.asarray(summed[NEIGHBOURS : NEIGHBOURS + len(places)])


def _segment(count: int) -> int:
    return max(math.isqrt(count), 1)


def _distinct(order: NDArray[np.int64], most: int) -> list[int]:
    chosen: list[int] = []
    for j in order:
        if not _is_near(int(j), chosen):
            chosen.append(int(j))
            if len(chosen) == most:
                break
    return chosen


def _is_near(index: int, chosen: Sequence[int]) -> bool:
    return any(abs(index - other) <= NEIGHBOURS for other in chosen)
