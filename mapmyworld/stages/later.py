"""What the stages after the track will need, imported and loaded while the log is tracked.

Kernels run without the interpreter's lock, so most of this is done on a core that would be idle.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module

from mapmyworld.kernels.first_start import load_kept
from mapmyworld.parallel import Aside

_MODULES = {
    "log": (
        "mapmyworld.stages.solve_and_judge",
        "mapmyworld.diagnosis",
        "mapmyworld.mapping.occupancy",
    ),
    "scan": (
        "mapmyworld.places.laser_closures",
        "mapmyworld.places.closure_refinement",
        "mapmyworld.odometry.laser_refinement",
        "mapmyworld.places.wheel_check",
    ),
    "camera": ("mapmyworld.places.visual_closures",),
}
"""Word of `needs_of` -> modules."""


@contextmanager
def made_ready(
    needs: frozenset[str], others: Sequence[str] = (), *, load: bool = True
) -> Iterator[None]:
    """Imports what logs with such `needs` will call, and the `others`; waits for it at the end.

    `load`: kernels as well; not while they are being compiled.
    What cannot be imported here is reported where it is used.
    """
    with Aside() as aside:
        for word, modules in _MODULES.items():
            if word in needs:
                aside.begin(_import_all, modules)
        if load:
            aside.begin(load_kept, needs)
        aside.begin(_import_all, others)
        yield


def _import_all(modules: Sequence[str]) -> None:
    for module in modules:
        import_module(module)
