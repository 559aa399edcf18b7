"""Who runs the jobs: threads here, each minding one process; or the workers of a Dask cluster."""

from __future__ import annotations

import os
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed

from cli.batching.commands import begin_commands, end_commands
from cli.batching.job import Result, failure, run_job
from cli.batching.manifest import Job
from mapmyworld.errors import MissingDependencyError


def run_here(jobs: Sequence[Job], output: str, at_once: int) -> Generator[Result]:
    """Results as they come, `at_once` builds at a time; 0 = as many as cores.

    What runs is ended when the iterator is closed or interrupted.
    """
    begin_commands()
    cores = os.cpu_count() or 1
    count = min(at_once or cores, max(len(jobs), 1))
    pool = ThreadPoolExecutor(count)
    try:
        threads = max(cores // count, 1)
        waiting = [pool.submit(run_job, job, output, threads) for job in jobs]
        for done in as_completed(waiting):
            yield done.result()
    finally:
        end_commands()
        pool.shutdown(wait=True, cancel_futures=True)


def run_on_cluster(jobs: Sequence[Job], output: str, scheduler: str) -> Generator[Result]:
    """Results as they come from a Dask scheduler's workers, which must see the same files.

    Raises `MissingDependencyError` where Dask is not installed or the scheduler not reached.
    """
    try:
        from distributed import Client
        from distributed import as_completed as as_they_come
    except ImportError:
        raise MissingDependencyError(
            "--scheduler needs Dask: pip install 'mapmyworld[distributed]'"
        ) from None
    try:
        client = Client(scheduler, timeout="20s", set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise MissingDependencyError(
            f"--scheduler {scheduler}: cannot be reached ({error}): is it running?"
        ) from None
    with client:
        # A build that fails is a result; an exception is a worker that went, and is tried again.
        waiting = {
            client.submit(run_job, job, output, 1, pure=False, retries=2): job for job in jobs
        }
        for done in as_they_come(waiting, loop=client.loop):  # type: ignore[no-untyped-call]
            lost = done.exception()
            if lost is None:
                yield done.result()
            else:
                yield failure(waiting[done], f"{type(lost).__name__}: {lost}")
