"""Independent pieces of work on a few threads, with the same result for any number of them."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

_CHUNKS_PER_THREAD = 4  # so that a slow piece does not keep the others waiting


def run_in_chunks(work: Callable[[int, int], None], count: int, threads: int) -> None:
    """`work(first, last)` over all of `range(count)`; pieces share no results."""
    workers = threads or os.cpu_count() or 1
    pieces = min(workers * _CHUNKS_PER_THREAD, count)
    if workers == 1 or pieces < 2:
        if count:
            work(0, count)
        return
    edges = [count * piece // pieces for piece in range(pieces + 1)]
    with ThreadPoolExecutor(workers) as pool:
        jobs = [pool.submit(work, a, b) for a, b in itertools.pairwise(edges)]
        for job in jobs:
            job.result()
