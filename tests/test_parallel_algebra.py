"""Linear algebra on one thread, whatever the environment."""

from __future__ import annotations

import numpy as np
import scipy.linalg  # noqa: F401  has a library of its own, which must be there to be held
from threadpoolctl import threadpool_info, threadpool_limits

from mapmyworld.parallel import on_one_thread


def threads_of_algebra() -> set[int]:
    np.ones((2, 2)) @ np.ones((2, 2))
    return {found["num_threads"] for found in threadpool_info() if found["user_api"] == "blas"}


def test_work_keeps_to_one_thread_and_gives_the_others_back() -> None:
    with threadpool_limits(2, user_api="blas"):
        assert on_one_thread(threads_of_algebra)() == {1}
        assert threads_of_algebra() == {2}
