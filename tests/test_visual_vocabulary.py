"""Visual words: given ones find what learned ones would, as files they come back the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formats.vocabulary_files import read_vocabulary, write_vocabulary
from mapmyworld.errors import MapError
from mapmyworld.places.vocabulary import train_vocabulary, vocabulary_of_words


def some_words(seed: int, count: int) -> dict[int, np.ndarray]:
    random = np.random.default_rng(seed)
    numbers = random.permutation(5 * count)[:count] + 1
    return {int(n): random.integers(0, 256, 32).astype(np.uint8) for n in numbers}


@settings(max_examples=20)
@given(seed=st.integers(0, 1000), count=st.integers(1, 300))
def test_a_given_vocabulary_knows_its_own_words(seed: int, count: int) -> None:
    words = some_words(seed, count)
    vocabulary = vocabulary_of_words(words)
    asked = np.stack(list(words.values())).view(np.uint64).reshape(-1, 4)
    assert vocabulary.words(asked).tolist() == list(words)
    assert {k: v.tobytes() for k, v in vocabulary.word_descriptors().items()} == {
        k: v.tobytes() for k, v in words.items()
    }


def test_most_descriptors_come_to_the_word_they_came_to_when_it_was_learned() -> None:
    """A learned vocabulary, written down as words and given again: near words are found again."""
    random = np.random.default_rng(0)
    centres = random.integers(0, 256, (200, 32)).astype(np.uint8)
    noise = np.packbits(random.random((6000, 256)) < 0.04, axis=1)
    seen = (centres[random.integers(0, 200, 6000)] ^ noise).view(np.uint64).reshape(-1, 4)
    learned = train_vocabulary(seen, branches=10, depth=3, seed=0)
    given_again = vocabulary_of_words(learned.word_descriptors())
    agree = np.mean(learned.words(seen) == given_again.words(seen))
    assert agree > 0.7


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
