"""Visual words: a tree of binary descriptors learned from the log itself, or given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.image_matching import nearest_and_votes, nearest_leaves

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
        """The word (N,) of each descriptor (N, 4), down the tree to the nearest child each time."""
        leaves = nearest_leaves(descriptors, self.centres, self.first_child, self.children)
        return np.asarray(self.word[leaves], np.int32)

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
    leaves = nearest_leaves(descriptors, tree.centres, tree.first_child, tree.children)
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
    centres = descriptors[random.permutation(len(descriptors))[:count]]
    votes = np.zeros((len(centres), 256), np.int64)
    labels = np.zeros(len(descriptors), np.int64)
    agreed, before = 0, -1
    while agreed > before:
        nearest_and_votes(descriptors, centres, labels, votes)
        bits = np.packbits(votes > 0, axis=1, bitorder="little").view(np.uint64)
        used = np.bincount(labels, minlength=len(centres)) > 0
        centres = np.where(used[:, None], bits, centres)
        agreed, before = int(np.abs(votes).sum()), agreed
    nearest_and_votes(descriptors, centres, labels, votes)
    used_rows, labels = np.unique(labels, return_inverse=True)
    return [centres[k] for k in used_rows], labels
