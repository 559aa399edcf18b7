"""Times as decimal seconds: exact both ways."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formats.decimal_stamps import nanoseconds_from_text, seconds_text


@given(st.integers(-(1 << 63) + 1, (1 << 63) - 1))
def test_text_and_nanoseconds_are_the_same_time(stamp_ns: int) -> None:
    assert nanoseconds_from_text(seconds_text(stamp_ns)) == stamp_ns


@pytest.mark.parametrize(
    ("text", "stamp_ns"),
    [
        ("1305031102.175304", 1305031102175304000),
        ("1", 1_000_000_000),
        (".5", 500_000_000),
        ("1.305031102175304e9", 1305031102175304000),
        ("0.1234567891", 123456789),
        ("-2.5", -2_500_000_000),
    ],
)
def test_every_spelling_is_read(text: str, stamp_ns: int) -> None:
    assert nanoseconds_from_text(text) == stamp_ns


@pytest.mark.parametrize(
    "text", ["", ".", "nan", "inf", "1e99", "9223372036.854775808", "1.2.3", "²"]
)
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is no time"):
        nanoseconds_from_text(text)
