"""Threads that take memory from one heap."""

from __future__ import annotations

import ctypes
import subprocess
import sys

import pytest

THREADS = """
import ctypes, threading
import numpy as np
from mapmyworld.heap import share_one_heap
{first}
together = threading.Barrier(4)
def work():
    together.wait()
    held = [np.ones(20_000) for _ in range(20)]
    together.wait()
every = [threading.Thread(target=work) for _ in range(4)]
[thread.start() for thread in every]
[thread.join() for thread in every]
libc = ctypes.CDLL(None)
libc.malloc_info(0, ctypes.c_void_p.in_dll(libc, "stdout"))
libc.fflush(None)
"""


def heaps(first: str) -> int:
    """How many glibc has after four threads took memory."""
    program = [sys.executable, "-c", THREADS.format(first=first)]
    found = subprocess.run(program, capture_output=True, text=True, check=True)
    return found.stdout.count("<heap nr=")


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_info"), reason="not glibc")
def test_all_threads_take_memory_from_one_heap() -> None:
    assert heaps("share_one_heap()") == 1 < heaps("pass")
