"""A verdict for tests that need a constraint to be rejected."""

from mapmyworld.types import Judge, Verdict, Why

REJECTED = Verdict(Judge.LASER, False, Why.LITTLE_EVIDENCE, {"evidence": 12.0, "limit": 30.0})
