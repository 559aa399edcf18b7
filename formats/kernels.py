"""Loops of readers and writers, compiled by numba; to open a log takes no numba."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

Loop = Callable[..., Any]


def compiled(loop: Loop) -> Loop:
    """The same function, compiled when it is called first and kept on disk from then on."""

    @functools.cache
    def kernel() -> Loop:
        from mapmyworld.kernels.compiling import jit

        return jit(loop)

    @functools.wraps(loop)
    def call(*arguments: Any) -> Any:
        return kernel()(*arguments)

    return call
