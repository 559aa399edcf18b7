"""Numbers in text: the quick reader says what `float` says, or leaves it to `float`."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formats.logs.decimal_text import read_decimals

PLAIN = st.from_regex(r"-?[0-9]{1,8}(\.[0-9]{0,7})?", fullmatch=True)


@given(st.lists(PLAIN, min_size=1, max_size=8))
def test_plain_decimals_are_read_to_the_last_bit(words: list[str]) -> None:
    line = "  ".join(words) + " host\n"
    values = np.full(len(words), np.nan)
    end = read_decimals(np.frombuffer(line.encode(), np.uint8), 0, values)
    assert line[end:] == " host\n"
    for word, value in zip(words, values, strict=True):
        assert value == float(word)
        assert math.copysign(1.0, value) == math.copysign(1.0, float(word))


@pytest.mark.parametrize("word", ["", "-", ".", "1.2.3", "1e5", "nan", "0x1", "9" * 17 + ".5"])
def test_what_is_not_plain_is_left_to_float(word: str) -> None:
    assert read_decimals(np.frombuffer(word.encode(), np.uint8), 0, np.empty(1)) == -1


def test_too_few_numbers_are_none() -> None:
    assert read_decimals(np.frombuffer(b"1 2", np.uint8), 0, np.empty(3)) == -1
