"""Visual words: binary descriptors, some of those that the log itself shows, or given ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.image_matching import nearest_words

Binary = NDArray[np.uint64]
_ONE_IN = 15  # descriptors is a word: each is seen in several images


@dataclass(frozen=True, slots=True, eq=False)
class Vocabulary:
    """Words by their numbers, from 1 upwards; a descriptor is the word that it is nearest to."""

    numbers: NDArray[np.int32]
    """(W,) ascending."""
    descriptors: Binary
    """(W, 4)."""

    @staticmethod
    def of(words: Mapping[int, NDArray[np.uint8]]) -> Vocabulary:
        """That of given words, number -> descriptor (32,)."""
        numbers = np.array(sorted(words), np.int32)
        descriptors = np.array([words[n] for n in numbers.tolist()], np.uint8)
        return Vocabulary(numbers, descriptors.view(np.uint64).reshape(-1, 4))

    @staticmethod
    def learned(descriptors: Binary, seed: int = 0) -> Vocabulary:
        """Some of these descriptors (N, 4) as they are: medians of many recognise no better."""
        different = np.unique(descriptors, axis=0)
        count = -(-len(different) // _ONE_IN)
        chosen = np.random.default_rng(seed).choice(different, count, replace=False)
        return Vocabulary(np.arange(1, count + 1, dtype=np.int32), chosen)

    @property
    def size(self) -> int:
        """The largest number of a word."""
        return int(self.numbers.max(initial=0))

    def words(self, descriptors: Binary) -> NDArray[np.int32]:
        """The word (N,) of each descriptor (N, 4)."""
        return np.asarray(self.numbers[nearest_words(descriptors, self.descriptors)])

    def word_descriptors(self) -> dict[int, NDArray[np.uint8]]:
        """Word id -> descriptor (32,)."""
        return dict(zip(self.numbers.tolist(), self.descriptors.view(np.uint8), strict=True))
