"""The kernels of a build, compiled by several processes where none has been compiled yet.

numba compiles one kernel after the other and holds a lock meanwhile, so a first start would keep
one core busy for half a minute. Here the kernels that a log needs stand in a pipe by number; this
process and its helpers take one after the other from it and compile it into numba's cache, where
all of them find it. Who compiled what changes nothing but the time. Where this cannot be done,
kernels are compiled when they are called first, as ever.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import Any

from mapmyworld.kernels.first_kernels import KERNELS, FirstKernel
from mapmyworld.types import Progress

_WORTH = 4  # kernels that are missing from which on a helper's own start is worth its time
_MOST = 4  # processes: more would wait for the longest kernel


def compile_missing(needs: frozenset[str], threads: int, progress: Progress) -> None:
    """Compiles the kernels that logs with these `needs` use, but for those in the cache.

    `threads`: processes at once, 0 = as many as cores.
    """
    wanted = _wanted(needs)
    helpers = min(threads or os.cpu_count() or 1, _MOST) - 1
    if not _can_help() or helpers < 1:
        return
    missing = [number for number in wanted if not _is_kept(KERNELS[number])]
    if len(missing) >= _WORTH:
        progress.stage("compile", len(missing), "kernels")
        with _queue_of(missing) as queue, _helpers(queue, helpers):
            for number in _taken(queue):
                progress.update(missing.index(number))
                _compile(KERNELS[number])
        progress.update(len(missing))


def load_kept(needs: frozenset[str]) -> None:
    """Loads from the cache what logs with these `needs` use, as far as it is there."""
    for number in _wanted(needs):
        if _is_kept(KERNELS[number]):
            _compile(KERNELS[number])


def help_compiling(queue: int, master: int) -> None:
    """What a helper does: takes from the same queue until it is empty or the `master` has gone."""
    gc.disable()  # a search for garbage would take more time than it is worth here
    for number in _taken(queue):
        if os.getppid() != master:
            return
        _compile(KERNELS[number])


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


def _taken(queue: int) -> Iterator[int]:
    while number := os.read(queue, 1):
        yield number[0]


@contextmanager
def _helpers(queue: int, count: int) -> Iterator[None]:
    """So many processes that work off the queue; waits for the last kernel they have taken."""
    started: list[subprocess.Popen[bytes]] = []
    try:
        with suppress(OSError):  # no more processes, no memory: the others do it
            started.extend(_helper(queue) for _ in range(count))
        yield
        for helper in started:
            helper.wait()
    finally:
        for helper in started:
            helper.kill()
            helper.wait()


def _helper(queue: int) -> subprocess.Popen[bytes]:
    task = f"import sys; sys.path[:] = {sys.path!r}\n"
    task += f"from {__name__} import help_compiling; help_compiling({queue}, {os.getpid()})"
    nothing = subprocess.DEVNULL
    return subprocess.Popen(
        [sys.executable, "-c", task],
        stdin=nothing, stdout=nothing, stderr=nothing, pass_fds=(queue,),
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
    """Loads it from the cache or compiles it; what fails here is told where it is called."""
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
