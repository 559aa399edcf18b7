"""Shares as words."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mapmyworld.types.wording import percent_below


def test_what_misses_a_limit_does_not_round_up_to_it() -> None:
    assert percent_below(0.6996, 0.7) == ("69%", "70%")


@given(st.floats(0, 1), st.integers(1, 100))
def test_what_is_shown_misses_the_limit_as_well(share: float, limit: int) -> None:
    shown, needed = percent_below(min(share, limit / 100 - 1e-9), limit / 100)
    assert int(shown[:-1]) < int(needed[:-1])
