"""Work done ahead on other threads, with results in the order of the items."""

from __future__ import annotations

import functools
import itertools
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, ParamSpec, TypeVar, cast

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

_CHUNKS_PER_THREAD = 4  # so that a slow piece does not keep the others waiting
_AHEAD = 3  # items per thread that are prepared before they are asked for

In = TypeVar("In")
Out = TypeVar("Out")
Given = ParamSpec("Given")


def batches(items: Iterable[In], size: int) -> Iterator[list[In]]:
    """The items in lists of `size`; the last may be shorter."""
    left = iter(items)
    while some := list(itertools.islice(left, size)):
        yield some


def made_ahead(items: Iterable[In], count: int = 32) -> Iterator[In]:
    """The items in order, made by another thread up to `count` ahead of their use.

    An error that making them raises comes where its item would have come.
    """
    left, end = iter(items), object()
    for item in in_threads(lambda _: next(left, end), itertools.count(), 1, count):
        if item is end:
            return
        yield cast(In, item)


def in_threads(
    work: Callable[[In], Out], items: Iterable[In], threads: int, ahead: int = _AHEAD
) -> Iterator[Out]:
    """`work` of each item, in order; 0 threads = as many as cores.

    Only `ahead` items a thread are read before their turn: more where some take far longer than
    others, for which the other threads would wait. An error of `work` is raised where its result
    would have come.
    """
    count = threads or os.cpu_count() or 1
    with ThreadPoolExecutor(count) as pool:
        waiting: deque[Future[Out]] = deque()
        try:
            for item in items:
                waiting.append(pool.submit(work, item))
                if len(waiting) >= ahead * count:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


def run_in_chunks(work: Callable[[int, int], None], count: int, threads: int) -> None:
    """`work(first, last)` over all of `range(count)`; pieces share no results."""
    pieces = min((threads or os.cpu_count() or 1) * _CHUNKS_PER_THREAD, count)
    edges = [count * piece // pieces for piece in range(pieces + 1)] if count else []
    for _ in in_threads(lambda ends: work(*ends), itertools.pairwise(edges), threads):
        pass


def on_one_thread(work: Callable[Given, Out]) -> Callable[Given, Out]:
    """`work`, during which linear algebra keeps to the thread that asks for it.

    The matrices here are small: more threads of OpenBLAS cost up to ten times the processor's time
    and gain none, and sums would depend on their number.
    """

    @functools.wraps(work)
    def limited(*args: Given.args, **kwargs: Given.kwargs) -> Out:
        with _algebra().limit(limits=1, user_api="blas"):
            return work(*args, **kwargs)

    return limited


@functools.cache
def _algebra() -> ThreadpoolController:
    """Libraries of linear algebra, found once, which takes as long as a small graph."""
    import scipy.linalg  # noqa: F401  has a library of its own, which must be there to be found
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
