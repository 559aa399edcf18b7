"""How kernels are compiled: at their first call, kept on disk, without the interpreter's lock.

What no kernel needs is left out, for a first start waits for it: a way in from C, errors of
division by zero (a quotient is infinite or no number, as numpy's), and for a kernel that only
kernels call the way in from Python.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def jit(kernel: Kernel) -> Kernel:
    """A kernel that Python calls."""
    return _compiled(kernel, no_cpython_wrapper=False)


def inner_jit(kernel: Kernel) -> Kernel:
    """A kernel that only kernels may call: from Python, the call would end the process."""
    return _compiled(kernel, no_cpython_wrapper=True)


def _compiled(kernel: Kernel, *, no_cpython_wrapper: bool) -> Kernel:
    options = {
        "nogil": True,
        "error_model": "numpy",
        "no_cfunc_wrapper": True,
        "no_cpython_wrapper": no_cpython_wrapper,
    }
    compiled: Kernel
    try:
        compiled = njit(cache=True, **options)(kernel)
    except RuntimeError:  # no folder that may be written: each start compiles what it calls
        compiled = njit(**options)(kernel)
    return compiled
