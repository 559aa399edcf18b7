"""Kernels over ranges of particles on a few threads, with the same bytes for any number."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import Any

from mapmyworld.particles.kernels import Surfaces


class Workers:
    """Splits `range(count)` into one piece a thread; the kernels release the interpreter lock."""

    def __init__(self, threads: int) -> None:
        self._threads = threads or os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self._threads) if self._threads > 1 else None

    def __enter__(self) -> Workers:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown()

    def run(self, kernel: Callable[..., None], count: int, arguments: tuple[Any, ...]) -> None:
        """`kernel(first, last, *arguments)` over all of `range(count)`."""
        if self._pool is None or count < 2:
            kernel(0, count, *arguments)
            return
        pieces = min(self._threads, count)
        edges = [count * piece // pieces for piece in range(pieces + 1)]
        jobs = [
            self._pool.submit(kernel, first, last, *arguments)
            for first, last in itertools.pairwise(edges[1:])
        ]
        kernel(edges[0], edges[1], *arguments)
        for job in jobs:
            job.result()

    def run_maps(
        self,
        kernel: Callable[..., None],
        maps: Surfaces,
        count: int,
        arguments: tuple[Any, ...],
    ) -> None:
        """The same for kernels whose first argument is the maps."""

        def bound(first: int, last: int, *rest: Any) -> None:
            kernel(maps, first, last, *rest)

        self.run(bound, count, arguments)
