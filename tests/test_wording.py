"""Verdicts in words: each ground has its own, and nothing but numbers goes in."""

from __future__ import annotations

import dataclasses
import string
from typing import get_args

import numpy as np
import pytest

from mapmyworld.types import ConstraintKind, Judge, Judged, Person, Source, Verdict, Why
from mapmyworld.types.wording import _SOURCES, _VERDICTS, _length, in_words, reason_of


@pytest.mark.parametrize("why", list(Why))
def test_every_ground_is_worded(why: Why) -> None:
    text = in_words(Verdict(Judge.LASER, False, why, _numbers(_VERDICTS[why])))
    assert text
    assert "{" not in text


def test_sources_are_worded_by_their_own_fields() -> None:
    for source in get_args(Source):
        known = {field.name for field in dataclasses.fields(source)}
        assert set(_numbers(_SOURCES.get(source, ""))) <= known


def test_what_a_person_wrote_is_shown_as_written() -> None:
    edit = Person("pin", "{the} | dock")
    pin = Judged(1, 1, ConstraintKind.PRIOR, np.eye(4), np.eye(6), edit)
    assert reason_of(pin) == "by hand: pin: {the} | dock"


def test_a_verdict_without_its_numbers_is_named_by_its_ground() -> None:
    """As a damaged map may hold it."""
    assert in_words(Verdict(Judge.LASER, False, Why.LOW_SHARE)) == "low share of matches agrees"


@pytest.mark.parametrize(("why", "name"), [(Why.LOW_SHARE, "share")])
def test_a_share_that_misses_its_limit_does_not_round_up_to_it(why: Why, name: str) -> None:
    text = in_words(Verdict(Judge.LASER, False, why, {name: 0.6996, "limit": 0.7}))
    assert "69%" in text
    assert text.count("70%") == 1


@pytest.mark.parametrize(
    ("metres", "text"),
    [(2.5e-15, "0.0 mm"), (7e-5, "0.1 mm"), (0.00123, "1.2 mm"), (0.0099, "9.9 mm"),
     (0.0234, "0.0234 m"), (1.5, "1.5 m")],
)  # fmt: skip
def test_a_length_has_no_more_digits_than_say_something(metres: float, text: str) -> None:
    assert _length(metres) == text


@pytest.mark.parametrize("overlap", [np.inf, np.nan])
def test_a_share_that_is_no_number_is_named_by_its_ground(overlap: float) -> None:
    """As a damaged map may hold it."""
    numbers = {"share": overlap, "limit": 0.7}
    assert (
        in_words(Verdict(Judge.LASER, False, Why.LOW_SHARE, numbers))
        == "low share of matches agrees"
    )


def _numbers(template: str) -> dict[str, float]:
    """One for each name in a template but the note."""
    names = {name for _, name, _, _ in string.Formatter().parse(template) if name}
    return dict.fromkeys(names - {"note"}, 1)
