"""Binary descriptors compared by Hamming distance, around projections and exhaustively."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit

_M1 = np.uint64(0x5555555555555555)
_M2 = np.uint64(0x3333333333333333)
_M4 = np.uint64(0x0F0F0F0F0F0F0F0F)
_H01 = np.uint64(0x0101010101010101)


@inner_jit
def _bits(x: np.uint64) -> np.uint64:
    """Set bits of a 64-bit integer; compilers make one instruction of it where there is one."""
    x = x - ((x >> np.uint64(1)) & _M1)
    x = (x & _M2) + ((x >> np.uint64(2)) & _M2)
    x = (x + (x >> np.uint64(4))) & _M4
    return (x * _H01) >> np.uint64(56)


@inner_jit
def _distance(a: NDArray[np.uint64], b: NDArray[np.uint64]) -> int:
    """Bits in which two words of four 64-bit integers differ."""
    total = 0
    for k in range(4):
        total += int(_bits(a[k] ^ b[k]))
    return total


@jit
def match_projected(
    projected: NDArray[np.float32],
    radii: NDArray[np.float32],
    point_words: NDArray[np.uint64],
    pixels: NDArray[np.float32],
    words: NDArray[np.uint64],
    cell: float,
    starts: NDArray[np.int32],
    members: NDArray[np.int32],
    columns: int,
    limit: int,
    ratio: float,
) -> NDArray[np.int32]:
    """(P,) the feature that matches each projected point (P, 2), pixels; -1 for none; one to one.

    A feature, at `pixels` (N, 2), qualifies within `radii` (P,) pixels of the projection, with
    `words` (N, 4) at a Hamming distance from `point_words` (P, 4) of at most `limit` and below
    `ratio` times the second best. `members` (N,) are the features sorted into square cells of
    `cell` pixels, `columns` of them in a row of the image, each from `starts` (C + 1,) on.
    """
    rows = (len(starts) - 1) // columns
    best_of_feature = np.full(len(pixels), 1 << 20, np.int32)
    owner = np.full(len(pixels), -1, np.int32)
    matches = np.full(len(projected), -1, np.int32)
    for i in range(len(projected)):
        u, v, r = projected[i, 0], projected[i, 1], radii[i]
        if not (r > 0.0):
            continue
        left = min(max(int((u - r) / cell), 0), columns - 1)
        right = min(max(int((u + r) / cell), 0), columns - 1)
        top = min(max(int((v - r) / cell), 0), rows - 1)
        bottom = min(max(int((v + r) / cell), 0), rows - 1)
        best, second, found = 1 << 20, 1 << 20, -1
        for row in range(top, bottom + 1):
            for k in range(starts[row * columns + left], starts[row * columns + right + 1]):
                j = members[k]
                du, dv = pixels[j, 0] - u, pixels[j, 1] - v
                if du * du + dv * dv > r * r:
                    continue
                d = _distance(point_words[i], words[j])
                if d < best:
                    best, second, found = d, best, j
                elif d < second:
                    second = d
        if found < 0 or best > limit or best > ratio * second:
            continue
        if best < best_of_feature[found]:
            if owner[found] >= 0:
                matches[owner[found]] = -1
            best_of_feature[found] = best
            owner[found] = i
            matches[i] = found
    return matches


@jit
def match_all(
    a: NDArray[np.uint64], b: NDArray[np.uint64], limit: int, ratio: float
) -> NDArray[np.int32]:
    """(N,) for each word of `a` (N, 4) its mutual best in `b` (M, 4), -1 for none.

    Best at most `limit` bits away, below `ratio` times the second best, and best in both ways.
    """
    n, m = len(a), len(b)
    by_word = np.ascontiguousarray(b.T)  # so that a row of distances is made many at a time
    distances = np.empty(m, np.int32)
    back = np.full(m, 1 << 20, np.int32)
    back_index = np.full(m, -1, np.int32)
    matches = np.full(n, -1, np.int32)
    for i in range(n):
        _distances(a[i], by_word, distances)
        matches[i] = _clear_best(distances, limit, ratio)
        for j in range(m):
            if distances[j] < back[j]:
                back[j] = distances[j]
                back_index[j] = i
    for i in range(n):
        if matches[i] >= 0 and back_index[matches[i]] != i:
            matches[i] = -1
    return matches


@jit
def nearest_words(asked: NDArray[np.uint64], words: NDArray[np.uint64]) -> NDArray[np.int64]:
    """(N,) which of the `words` (W, 4) each of those `asked` (N, 4) differs from in fewest bits."""
    by_word, distances = np.ascontiguousarray(words.T), np.empty(len(words), np.int32)
    found = np.empty(len(asked), np.int64)
    for i in range(len(asked)):
        _distances(asked[i], by_word, distances)
        found[i] = _clear_best(distances, 256, np.inf)
    return found


@inner_jit
def _distances(
    word: NDArray[np.uint64], by_word: NDArray[np.uint64], distances: NDArray[np.int32]
) -> None:
    """Bits in which a word (4,) differs from each column of (4, M); no branches on the way."""
    a0, a1, a2, a3 = word[0], word[1], word[2], word[3]
    for j in range(by_word.shape[1]):
        total = _bits(a0 ^ by_word[0, j]) + _bits(a1 ^ by_word[1, j])
        total += _bits(a2 ^ by_word[2, j]) + _bits(a3 ^ by_word[3, j])
        distances[j] = np.int32(total)


@inner_jit
def _clear_best(distances: NDArray[np.int32], limit: int, ratio: float) -> int:
    """The first least distance, -1 where it is above `limit` or too near the second least."""
    best = np.int32(1 << 20)
    for j in range(len(distances)):
        best = min(best, distances[j])
    if best > limit:
        return -1
    second, found = np.int32(1 << 20), -1
    for j in range(len(distances)):
        if found < 0 and distances[j] == best:
            found = j
        elif distances[j] < second:
            second = distances[j]
    return found if best <= ratio * second else -1
