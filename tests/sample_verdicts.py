"""A verdict for tests that need a constraint to be rejected."""

from mapmyworld.types import Judge, Verdict, Why

REJECTED = Verdict(Judge.LASER, False, Why.LOW_SCORE, {"limit": 0.5})
