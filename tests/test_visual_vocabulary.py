"""Visual words: given ones find what learned ones would, as files they come back the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formats.vocabulary_files import read_vocabulary, write_vocabulary
from mapmyworld.errors import MapError
from mapmyworld.places.vocabulary import Vocabulary


def some_words(seed: int, count: int) -> dict[int, np.ndarray]:
    random = np.random.default_rng(seed)
    numbers = random.permutation(5 * count)[:count] + 1
    return {int(n): random.integers(0, 256, 32).astype(np.uint8) for n in numbers}


@settings(max_examples=20)
@given(seed=st.integers(0, 1000), count=st.integers(1, 300))
def test_a_given_vocabulary_knows_its_own_words(seed: int, count: int) -> None:
    words = some_words(seed, count)
    vocabulary = Vocabulary.of(words)
    asked = np.stack(list(words.values())).view(np.uint64).reshape(-1, 4)
    assert vocabulary.words(asked).tolist() == list(words)
    assert {k: v.tobytes() for k, v in vocabulary.word_descriptors().items()} == {
        k: v.tobytes() for k, v in words.items()
    }


def test_a_descriptor_is_the_word_that_differs_in_fewest_bits() -> None:
    words = some_words(1, 200)
    asked = np.random.default_rng(2).integers(0, 256, (300, 32)).astype(np.uint8)
    numbers = sorted(words)
    apart = asked[:, None] ^ np.stack([words[n] for n in numbers])
    nearest = np.unpackbits(apart, axis=2).sum(axis=2).argmin(axis=1)
    found = Vocabulary.of(words).words(asked.view(np.uint64).reshape(-1, 4))
    assert found.tolist() == [numbers[k] for k in nearest]
    assert len(Vocabulary.of(words).words(np.zeros((0, 4), np.uint64))) == 0


def test_learned_words_are_descriptors_that_were_seen_and_the_same_each_time() -> None:
    seen = np.random.default_rng(0).integers(0, 9, (400, 4)).astype(np.uint64)
    learned, again = Vocabulary.learned(seen, 3), Vocabulary.learned(seen, 3)
    words = learned.word_descriptors()
    assert list(words) == list(range(1, learned.size + 1))
    known = {row.tobytes() for row in seen}
    assert len({word.tobytes() for word in words.values()} & known) == learned.size > 1
    assert np.array_equal(again.descriptors, learned.descriptors)
    assert Vocabulary.learned(seen[:1], 3).size == 1


def test_words_come_back_from_a_file(tmp_path: Path) -> None:
    words = some_words(3, 50)
    write_vocabulary(tmp_path / "words.txt", words)
    found = read_vocabulary(tmp_path / "words.txt")
    assert found.keys() == words.keys()
    assert all(np.array_equal(found[n], words[n]) for n in words)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no vocabulary|no visual words"),
        ("anything", "no vocabulary"),
        ("WordID Descriptors...32\n", "no visual words"),
        ("WordID Descriptors...32\n1 2 3\n", "line 2"),
        ("WordID Descriptors...32\n1 " + "300 " * 32, "line 2"),
        ("WordID Descriptors...32\n0 " + "30 " * 32, "line 2"),
        ("WordID Descriptors...32\n1 " + "x " * 32, "line 2"),
    ],
)
def test_what_is_no_vocabulary_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "words.txt").write_text(text)
    with pytest.raises(MapError, match=said):
        read_vocabulary(tmp_path / "words.txt")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"places\.vocabulary"):
        read_vocabulary(tmp_path / "none.txt")


def test_long_descriptors_are_no_binary_words(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="binary"):
        write_vocabulary(tmp_path / "words.txt", {1: np.zeros(128, np.float32)})
