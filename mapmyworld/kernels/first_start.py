"""The kernels of a build, compiled by several processes where none has been compiled yet.

numba compiles one kernel after the other and holds a lock meanwhile, so a first start would keep
one core busy for half a minute. Here the kernels that a log needs stand in a pipe by number; this
process and its helpers take one after the other from it and compile it into numba's cache, where
all of them find it; what tracking calls comes first, so that helpers do the rest while the log is
tracked. Who compiled what changes nothing but the time. Where this cannot be done, kernels are
compiled when they are called first, as ever.
"""

from __future__ import annotations

import os
import select
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import Any

from mapmyworld.heap import no_search_for_garbage
from mapmyworld.kernels.first_kernels import KERNELS, FirstKernel
from mapmyworld.types import Progress

_WORTH = 4  # kernels that are missing from which on a helper's own start is worth its time
_MOST = 4  # processes: more would wait for the longest kernel


@contextmanager
def compiled_ahead(needs: frozenset[str], threads: int, progress: Progress) -> Iterator[bool]:
    """Compiles the kernels that logs with these `needs` use, but for those in the cache.

    At its beginning those are there that tracking calls, at its end all: helpers go on meanwhile.
    Gives whether none was missing. `threads`: processes at once, 0 = as many as cores.
    """
    helpers = min(threads or os.cpu_count() or 1, _MOST) - 1
    if not _can_help() or helpers < 1:
        yield True
        return
    missing = [number for number in _wanted(needs) if not _is_kept(KERNELS[number])]
    if len(missing) < _WORTH:
        yield not missing
        return
    first = {number for number in missing if needs & KERNELS[number].tracking}
    missing.sort(key=lambda number: number not in first)
    with _queue_of(missing) as queue, _helpers(queue, helpers) as reported:
        work = _Shared(queue, reported, missing, progress)
        work.do(first)
        yield False
        work.do(set(missing))


class _Shared:
    """Work on a queue that helpers work off as well, who indicate what they have done."""

    def __init__(
        self, queue: int, reported: int, missing: Sequence[int], progress: Progress
    ) -> None:
        self._queue, self._reported, self._progress = queue, reported, progress
        self._missing = set(missing)
        self._count = len(missing)

    def do(self, wanted: set[int]) -> None:
        """Takes kernels from the queue until all that are wanted are done, by whom ever."""
        self._listen(0.0)
        if not self._missing & wanted:
            return
        self._progress.stage("compile", self._count, "kernels")
        with no_search_for_garbage():
            while self._missing & wanted and self._step():
                self._progress.update(self._count - len(self._missing))

    def _step(self) -> bool:
        """Compiles the next kernel, or waits for helpers; False where they ended before time.

        What they had taken is then compiled when it is called.
        """
        if number := os.read(self._queue, 1):
            _compile(KERNELS[number[0]])
            self._missing.discard(number[0])
            self._listen(0.0)
            return True
        return self._listen(None)

    def _listen(self, seconds: float | None) -> bool:
        """Notes what helpers have done, waiting for news so long (None = for ever).

        False where none of them will say any more.
        """
        while select.select([self._reported], [], [], seconds)[0]:
            done = os.read(self._reported, 256)
            if not done:
                return False
            self._missing.difference_update(done)
            seconds = 0.0
        return True


def load_kept(needs: frozenset[str]) -> None:
    """Loads from the cache what logs with these `needs` use, as far as it is there."""
    for number in _wanted(needs):
        if _is_kept(KERNELS[number]):
            _compile(KERNELS[number])


def help_compiling(queue: int, reported: int, master: int) -> None:
    """What a helper does: takes from the same queue until it is empty or the `master` has gone.

    It writes each number that is done into `reported`.
    """
    with no_search_for_garbage():
        while number := os.read(queue, 1):
            if os.getppid() != master:
                return
            _compile(KERNELS[number[0]])
            os.write(reported, number)


def _wanted(needs: frozenset[str]) -> list[int]:
    return [number for number, kernel in enumerate(KERNELS) if kernel.needed_by in needs]


def _can_help() -> bool:
    """Whether processes may pass on open pipes, and Python's own interpreter runs this one."""
    return os.name == "posix" and os.path.basename(sys.executable or "").startswith("python")


@contextmanager
def _queue_of(numbers: Sequence[int]) -> Iterator[int]:
    """A pipe from which every reader takes the next number, a byte; at its end it is empty."""
    reading, writing = os.pipe()
    try:
        os.write(writing, bytes(numbers))
        os.close(writing)
        yield reading
    finally:
        os.close(reading)


@contextmanager
def _helpers(queue: int, count: int) -> Iterator[int]:
    """Gives a pipe in which so many processes indicate what they did; waits for them at the end."""
    started: list[subprocess.Popen[bytes]] = []
    reading, writing = os.pipe()
    try:
        with suppress(OSError):  # no more processes, no memory: the others do it
            started.extend(_helper(queue, writing) for _ in range(count))
        os.close(writing)
        yield reading
        for helper in started:
            helper.wait()
    finally:
        for helper in started:
            helper.kill()
            helper.wait()
        os.close(reading)


def _helper(queue: int, reported: int) -> subprocess.Popen[bytes]:
    task = f"import sys; sys.path[:] = {sys.path!r}\n"
    task += (
        f"from {__name__} import help_compiling; help_compiling({queue}, {reported}, {os.getpid()})"
    )
    nothing = subprocess.DEVNULL
    return subprocess.Popen(
        [sys.executable, "-c", task],
        stdin=nothing, stdout=nothing, stderr=nothing, pass_fds=(queue, reported),
    )  # fmt: skip


def _is_kept(kernel: FirstKernel) -> bool:
    """Whether numba's cache holds it for all its signatures, or cannot hold it."""
    try:
        compiled = _dispatcher(kernel)
        kept = compiled._cache._cache_file._load_index()
        codegen = compiled.targetctx.codegen()
        return all(compiled._cache._index_key(s, codegen) in kept for s in _signatures(kernel))
    except Exception:  # another numba, a cache that is off, a folder nobody may read
        return True


def _compile(kernel: FirstKernel) -> None:
    """Loads it from the cache or compiles it; what fails here is reported where it is called."""
    try:
        for signature in _signatures(kernel):
            _dispatcher(kernel).compile(signature)
    except Exception:
        return


def _dispatcher(kernel: FirstKernel) -> Any:
    return getattr(import_module(f"mapmyworld.kernels.{kernel.module}"), kernel.name)


def _signatures(kernel: FirstKernel) -> list[Any]:
    from numba.core.sigutils import normalize_signature

    return [normalize_signature(f"({types})")[0] for types in kernel.signatures]
