"""RVL against the slow coder and decoder of the tests, and against damage."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rtabmap_decoder import rvl, rvl_words

from formats.rvl import rvl_decode

# Zeros and equal neighbours are what RVL lives of; any 16-bit value must do.
DEPTHS = arrays(
    np.uint16,
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    elements=st.one_of(st.just(0), st.integers(0, 65535), st.integers(900, 910)),
)


@given(DEPTHS)
@settings(max_examples=200)
def test_round_trip_and_independent_decoder(depth: np.ndarray) -> None:
    words = rvl_words(depth)
    np.testing.assert_array_equal(rvl_decode(words, *depth.shape), depth)
    assert rvl(words, depth.size) == depth.ravel().tolist()


@given(st.binary(max_size=64), st.integers(1, 40))
@settings(max_examples=200)
def test_any_bytes_give_an_image_or_an_error(words: bytes, width: int) -> None:
    with contextlib.suppress(ValueError):
        assert rvl_decode(words, 3, width).shape == (3, width)


def test_cut_data_are_refused() -> None:
    depth = np.arange(1, 1001, dtype=np.uint16).reshape(20, 50) * 60
    words = rvl_words(depth)
    for length in range(0, len(words) - 4, 4):
        with pytest.raises(ValueError, match="do not hold"):
            rvl_decode(words[:length], 20, 50)
