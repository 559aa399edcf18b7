"""What a first start compiles before it needs it: the kernels for what the plan has found."""

from __future__ import annotations

from contextlib import AbstractContextManager

from mapmyworld.kernels.first_start import compiled_ahead
from mapmyworld.sensing import Plan
from mapmyworld.types import Progress


def compile_ahead(plan: Plan, threads: int, progress: Progress) -> AbstractContextManager[bool]:
    """Compiles by several processes what the stages after the plan will call.

    To be held while the log is tracked: helpers go on meanwhile. Gives whether all was there.
    """
    return compiled_ahead(needs_of(plan), threads, progress)


def needs_of(plan: Plan) -> frozenset[str]:
    """The words of `kernels.first_kernels` that hold for a plan."""
    holds = {
        "log": True,
        "scan": plan.scan is not None,
        "camera": plan.camera is not None,
        "odometry": plan.odometry is not None,
        "sight": plan.scan is None and plan.odometry is None,
    }
    return frozenset(word for word, true in holds.items() if true)
