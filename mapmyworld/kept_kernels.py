"""Compiled kernels, loaded from numba's cache without what only compiling needs."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

# Calls ask for these two when they are first made, and threads would import them crosswise.
import numba.cpython.numbers
import numba.np.arrayobj  # noqa: F401
from numba.core import config
from numba.core.caching import FunctionCache
from numba.core.runtime import rtsys

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def keep(compiled: Kernel) -> Kernel:
    """The same numba kernel, kept on disk once it was compiled, as `cache=True` has it."""
    if not config.DISABLE_JIT:  # NUMBA_DISABLE_JIT leaves Python's own function
        compiled._cache = _Cache(compiled.py_func)  # type: ignore[attr-defined]
    return compiled


class _Cache(FunctionCache):  # type: ignore[misc]
    """numba's own, which would first learn all it can compile: 0.3 s for a program's start.

    What a kernel compiled now needs, numba learns when it compiles. It would also keep a kernel
    whose own file is the same while another kernel that it calls has changed.
    """

    def __init__(self, py_func: Callable[..., Any]) -> None:
        super().__init__(py_func)
        file = self._cache_file
        if hasattr(file, "_source_stamp"):  # else another numba than those we know
            file._source_stamp = (file._source_stamp, *_sources_stamp())

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The kernel for arguments of these types; None where it is not kept."""
        if not hasattr(self, "_load_overload"):  # another numba than those we know
            return super().load_overload(sig, target_context)
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)


@functools.cache
def _sources_stamp() -> tuple[int, int]:
    """When the last of all files of kernels was changed, and how large they are together."""
    package = Path(__file__).parent
    files = [*package.glob("kernels/*.py"), *package.glob("*/kernels/*.py")]
    found = [file.stat() for file in files]
    return max((one.st_mtime_ns for one in found), default=0), sum(one.st_size for one in found)
