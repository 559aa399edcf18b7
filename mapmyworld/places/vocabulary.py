"""Visual words: a tree of binary descriptors learned from the log itself, or given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Binary = NDArray[np.uint64]
_BRANCHES = 10  # children of a word in its tree
_DEPTH = 4  # levels of the tree: at most branches^depth words, ten thousand


@dataclass(frozen=True, slots=True, eq=False)
class Vocabulary:
    """A tree whose leaves are the words, ids from 1 upwards."""

    centres: Binary
    """(T, 4) descriptor of each node of the tree; row 0 is the root and means nothing."""
    first_child: NDArray[np.int32]
    """(T,) row of the first child, -1 for a leaf; siblings lie side by side."""
    children: NDArray[np.int32]
    """(T,) how many."""
    word: NDArray[np.int32]
    """(T,) id of a leaf's word, 0 for inner nodes."""

    @property
    def size(self) -> int:
        """The largest number of a word."""
        return int(self.word.max(initial=0))

    def words(self, descriptors: Binary) -> NDArray[np.int32]:
        """The word (N,) of each descriptor (N, 4)."""
        return np.asarray(self.word[self.leaves(descriptors)], np.int32)

    def leaves(self, descriptors: Binary) -> NDArray[np.int64]:
        """(N,) rows of the leaves of descriptors (N, 4), down to the nearest child each time."""
        found = np.zeros(len(descriptors), np.int64)
        while len(inner := np.flatnonzero(self.first_child[found] >= 0)):
            counts = self.children[found[inner], None]
            child = np.minimum(np.arange(counts.max()), counts - 1)  # the last one again and again
            rows = self.first_child[found[inner], None] + child
            nearest = _distances(descriptors[inner, None], self.centres[rows]).argmin(axis=1)
            found[inner] = rows[np.arange(len(inner)), nearest]
        return found

    def word_descriptors(self) -> dict[int, NDArray[np.uint8]]:
        """Word id -> descriptor (32,)."""
        leaves = np.flatnonzero(self.word > 0)
        return {int(self.word[leaf]): self.centres[leaf].view(np.uint8) for leaf in leaves}


def train_vocabulary(
    descriptors: Binary, *, branches: int = _BRANCHES, depth: int = _DEPTH, seed: int = 0
) -> Vocabulary:
    """A tree of k-medians on binary descriptors (N, 4), each bit of a centre by majority.

    After Nister and Stewenius, "Scalable recognition with a vocabulary tree" (2006).
    """
    random = np.random.default_rng(seed)
    centres: list[Binary] = [np.zeros(4, np.uint64)]
    first_child, children, level = [-1], [0], [0]
    members = [np.arange(len(descriptors))]
    current = 0
    while current < len(centres):
        mine = members[current]
        if level[current] < depth and len(mine) > 2 * branches:
            found, labels = _cluster(descriptors[mine], branches, random)
            if len(found) > 1:
                first_child[current], children[current] = len(centres), len(found)
                for k, centre in enumerate(found):
                    centres.append(centre)
                    first_child.append(-1)
                    children.append(0)
                    level.append(level[current] + 1)
                    members.append(mine[labels == k])
        members[current] = np.zeros(0, np.int64)
        current += 1
    leaves = np.array(first_child) < 0
    leaves[0] = False
    return Vocabulary(
        np.stack(centres),
        np.array(first_child, np.int32),
        np.array(children, np.int32),
        np.where(leaves, np.cumsum(leaves), 0).astype(np.int32),
    )


def vocabulary_of_words(words: Mapping[int, NDArray[np.uint8]], *, seed: int = 0) -> Vocabulary:
    """A vocabulary of given words, number -> descriptor (32,): a tree to find them by."""
    numbers = np.array(sorted(words), np.int32)
    descriptors = np.stack([words[n] for n in numbers.tolist()]).view(np.uint64).reshape(-1, 4)
    tree = train_vocabulary(descriptors, seed=seed)
    leaves = tree.leaves(descriptors)
    order = np.argsort(leaves, kind="stable")
    parents, starts, counts = np.unique(leaves[order], return_index=True, return_counts=True)
    first_child, children = tree.first_child.copy(), tree.children.copy()
    first_child[parents], children[parents] = len(tree.centres) + starts, counts
    none = np.zeros(len(order), np.int32)
    return Vocabulary(
        np.concatenate([tree.centres, descriptors[order]]),
        np.concatenate([first_child, none - 1]).astype(np.int32),
        np.concatenate([children, none]).astype(np.int32),
        np.concatenate([np.zeros(len(tree.centres), np.int32), numbers[order]]),
    )


def _cluster(
    descriptors: Binary, count: int, random: np.random.Generator
) -> tuple[list[Binary], NDArray[np.int64]]:
    """At most `count` centres and the nearest one of each descriptor; none without members."""
    words = np.ascontiguousarray(descriptors.T)
    bits = _packed(np.unpackbits(descriptors.view(np.uint8), axis=1, bitorder="little").T)
    centres = descriptors[random.permutation(len(descriptors))[:count]]
    labels, agreed, before = _nearest(centres, words), 0, -1
    while agreed > before:
        members = labels == np.arange(len(centres))[:, None]
        ones = np.bitwise_count(bits & _packed(members)[:, None]).sum(axis=2, dtype=np.int64)
        votes = 2 * ones - members.sum(axis=1, keepdims=True)
        majority = np.packbits(votes > 0, axis=1, bitorder="little").view(np.uint64)
        centres = np.where(members.any(axis=1, keepdims=True), majority, centres)
        labels = _nearest(centres, words)
        agreed, before = int(np.abs(votes).sum()), agreed
    used, labels = np.unique(labels, return_inverse=True)
    return list(centres[used]), labels


def _nearest(centres: Binary, words: Binary) -> NDArray[np.int64]:
    """(N,) the nearest of `centres` (K, 4) to each of the descriptors whose words are (4, N)."""
    distances = np.bitwise_count(centres[:, :, None] ^ words).sum(axis=1, dtype=np.int16)
    return np.asarray(distances.argmin(axis=0))


def _packed(bits: NDArray[np.generic]) -> Binary:
    """Rows of bits (R, N) as words (R, M), the last one filled up with zeros."""
    filled = np.zeros((len(bits), -(-bits.shape[1] // 64) * 64), np.bool_)
    filled[:, : bits.shape[1]] = bits
    return np.packbits(filled, axis=1).view(np.uint64)


def _distances(a: Binary, b: Binary) -> NDArray[np.int64]:
    """Bits in which words (..., 4) of a and b differ, (...)."""
    return np.asarray(np.bitwise_count(a ^ b).sum(axis=-1), np.int64)
