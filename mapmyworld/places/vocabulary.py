"""Visual words: a tree of descriptors learned from the log itself, or given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Descriptors = NDArray[np.uint8] | NDArray[np.float32]
_ROUNDS = 8  # of k-means at each branching; later rounds move little
_SAMPLE = 4000  # descriptors that decide on one branching, at most


@dataclass(frozen=True, slots=True, eq=False)
class Vocabulary:
    """A tree whose leaves are the words, ids from 1 upwards."""

    centres: Descriptors
    """(T, D) descriptor of each node of the tree; row 0 is the root and means nothing."""
    first_child: NDArray[np.int32]
    """(T,) row of the first child, -1 for a leaf; siblings lie side by side."""
    children: NDArray[np.int32]
    """(T,) how many."""
    word: NDArray[np.int32]
    """(T,) id of a leaf's word, 0 for inner nodes."""

    @property
    def size(self) -> int:
        return int(self.word.max(initial=0))

    def words(self, descriptors: Descriptors) -> NDArray[np.int32]:
        """The word (N,) of each descriptor (N, D), down the tree to the nearest child each time."""
        vectors, centres = as_vectors(descriptors), as_vectors(self.centres)
        node = np.zeros(len(vectors), np.int64)
        active = np.arange(len(vectors))
        while len(active) and self.first_child[0] >= 0:
            for parent in np.unique(node[active]):
                mine = active[node[active] == parent]
                start = self.first_child[parent]
                near = centres[start : start + self.children[parent]]
                node[mine] = start + np.argmax(vectors[mine] @ near.T, axis=1)
            active = active[self.first_child[node[active]] >= 0]
        return self.word[node]

    def word_descriptors(self) -> dict[int, NDArray[np.generic]]:
        """Word id -> descriptor (D,)."""
        leaves = np.flatnonzero(self.word > 0)
        return {int(self.word[leaf]): self.centres[leaf] for leaf in leaves}


def train_vocabulary(
    descriptors: Descriptors, *, branches: int = 10, depth: int = 4, seed: int = 0
) -> Vocabulary:
    """A tree of k-means on descriptors (N, D): bits by majority, real values by the mean direction.

    After Nister and Stewenius, "Scalable recognition with a vocabulary tree" (2006).
    """
    vectors = as_vectors(descriptors)
    random = np.random.default_rng(seed)
    centres: list[NDArray[np.float32]] = [np.zeros(vectors.shape[1], np.float32)]
    first_child, children, level = [-1], [0], [0]
    members = [np.arange(len(vectors))]
    current = 0
    while current < len(centres):
        mine = members[current]
        if level[current] < depth and len(mine) > 2 * branches:
            found, labels = _cluster(vectors[mine], branches, random, descriptors.dtype == np.uint8)
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
    word = np.where(leaves, np.cumsum(leaves), 0).astype(np.int32)
    return Vocabulary(
        _from_vectors(np.stack(centres), descriptors.dtype == np.uint8),
        np.array(first_child, np.int32),
        np.array(children, np.int32),
        word,
    )


def as_vectors(descriptors: Descriptors) -> NDArray[np.float32]:
    """Unit vectors (N, D') whose products order descriptors as their distances do."""
    if descriptors.dtype == np.uint8:
        bits = np.unpackbits(np.ascontiguousarray(descriptors), axis=1)
        return bits.astype(np.float32) * 2.0 - 1.0
    vectors = np.sqrt(np.maximum(np.asarray(descriptors, np.float32), 0.0))
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, 1e-9), np.float32)


def _from_vectors(vectors: NDArray[np.float32], binary: bool) -> Descriptors:
    if binary:
        return np.packbits((vectors > 0).astype(np.uint8), axis=1)
    return np.square(vectors)


def _cluster(
    vectors: NDArray[np.float32], count: int, random: np.random.Generator, binary: bool
) -> tuple[list[NDArray[np.float32]], NDArray[np.int64]]:
    """At most `count` centres and the nearest one of each vector; no centre without members."""
    picks = random.permutation(len(vectors))[:_SAMPLE]
    sample = vectors[np.sort(picks)]
    centres = vectors[picks[:count]].copy()
    for _ in range(_ROUNDS):
        labels = np.argmax(sample @ centres.T, axis=1)
        moved = np.stack(
            [_middle(sample[labels == k], centres[k], binary) for k in range(len(centres))]
        )
        if np.array_equal(moved, centres):
            break
        centres = moved
    labels = np.argmax(vectors @ centres.T, axis=1)
    used, labels = np.unique(labels, return_inverse=True)
    return [centres[k] for k in used], labels


def _middle(
    members: NDArray[np.float32], old: NDArray[np.float32], binary: bool
) -> NDArray[np.float32]:
    if len(members) == 0:
        return old
    total = members.sum(axis=0)
    if binary:
        return np.where(total >= 0, np.float32(1.0), np.float32(-1.0))
    return np.asarray(total / max(float(np.linalg.norm(total)), 1e-9), np.float32)
