"""What the stages after the track will need, imported while the log is tracked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib import import_module

from mapmyworld.sensing import Plan

_ALWAYS = (
    "mapmyworld.stages.solve_and_judge",
    "mapmyworld.diagnosis",
    "mapmyworld.mapping.occupancy",
)
_WITH_SCANS = (
    "mapmyworld.places.laser_closures",
    "mapmyworld.places.closure_refinement",
    "mapmyworld.odometry.laser_refinement",
    "mapmyworld.places.wheel_check",
)
_WITH_IMAGES = ("mapmyworld.places.visual_closures",)


def needed_after(plan: Plan) -> tuple[str, ...]:
    """Modules that the stages after the track call for such a log."""
    scans = _WITH_SCANS if plan.scan is not None else ()
    return (*_ALWAYS, *scans, *(_WITH_IMAGES if plan.camera is not None else ()))


@contextmanager
def imported_meanwhile(modules: Sequence[str]) -> Iterator[None]:
    """Imports the modules on another thread; waits for it at the end.

    What cannot be imported here is reported where it is used.
    """
    with ThreadPoolExecutor(1) as pool:
        pool.submit(_import_all, modules)
        yield


def _import_all(modules: Sequence[str]) -> None:
    for module in modules:
        import_module(module)
