"""Maps over items in worker processes, on this machine or on a cluster, and prefetching in a thread.

With one job, maps run in this process.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.process import BaseProcess
from threading import Thread
from typing import Any, TypeVar, cast

from roboassembly.parallel.cluster import Cluster, connected

Item = TypeVar("Item")
Result = TypeVar("Result")
_ONE_THREAD = {
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"),
    "XLA_PYTHON_CLIENT_PREALLOCATE": "false",
    # Else glibc gives large buffers back after each use and gets them again page by page, which takes a third of an
    # expert's update.
    "MALLOC_MMAP_MAX_": "0",
    "MALLOC_TRIM_THRESHOLD_": str(2**30),
}


_clusters: list[str] = []
"""Addresses of the clusters in use, the innermost last; empty if workers run on this machine."""


@contextmanager
def use_cluster(address: str | None, jobs: int) -> Generator[int]:
    """Take workers from a Ray cluster inside the block.

    Args:
        address: address of the cluster, see `connected`; None keeps the workers on this machine.
        jobs: number of workers on this machine.

    Yields:
        The number of workers.

    Raises:
        MissingExtraError: Ray is not installed.
        InputError: no cluster answers there.
    """
    if address is None:
        yield jobs
        return
    ours = ("ROBOASSEMBLY_", "JAX_", "PYTHONPATH")
    kept = {name: value for name, value in os.environ.items() if name.startswith(ours)}
    with connected(address, {**_ONE_THREAD, "XLA_FLAGS": _one_thread_flags(), **kept}) as count:
        _clusters.append(address)
        try:
            yield count
        finally:
            _clusters.pop()


@contextmanager
def worker_pool(
    jobs: int, start: Callable[..., None] | None = None, arguments: tuple[Any, ...] = ()
) -> Generator[Executor]:
    """Yield a pool of worker processes. If the block ends early, also by an error, running tasks are stopped.

    Processes are spawned: a fork would share threads of the planner, the renderer and BLAS, and can hang.

    Args:
        jobs: number of processes.
        start: function that each process runs first, with `arguments`.
        arguments: arguments of `start`.
    """
    if _clusters:
        cluster = Cluster(start, arguments)
        try:
            yield cluster
        except BaseException:
            cluster.shutdown(wait=False, cancel_futures=True)
            raise
        cluster.shutdown()
        return
    others = active_children()
    with ProcessPoolExecutor(jobs, get_context("spawn"), _start_worker, (start, arguments)) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in active_children():
                if process not in others:
                    process.terminate()
            raise


def _start_worker(start: Callable[..., None] | None, arguments: tuple[Any, ...]) -> None:
    """Prepare a worker process, which ends with its parent: a killed parent does not stop its workers."""
    parent = parent_process()
    if parent is not None:
        Thread(target=_end_with, args=(parent,), daemon=True).start()
    if start is not None:
        start(*arguments)


def _end_with(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


def map_ordered(work: Callable[[Item], Result], items: Sequence[Item], jobs: int, chunk: int) -> Iterator[Result]:
    """Yield the result of `work` for each item, in order; a process receives `chunk` items at a time."""
    if jobs == 1:
        yield from map(work, items)
        return
    with worker_pool(jobs) as pool:
        with one_thread_each():
            results = pool.map(work, items, chunksize=chunk)
        yield from results


def map_unordered(work: Callable[[Item], Result], items: Sequence[Item], jobs: int) -> Iterator[Result]:
    """Yield the result of `work` for each item, in order of completion."""
    if jobs == 1:
        yield from map(work, items)
        return
    with worker_pool(jobs) as pool:
        with one_thread_each():
            futures = [pool.submit(work, item) for item in items]
        for done in as_completed(futures):
            yield done.result()


def prefetch(items: Iterator[Item]) -> Iterator[Item]:
    """Yield the same items; a thread makes the next one while one is in use."""
    end = object()
    with ThreadPoolExecutor(1) as pool:
        upcoming = pool.submit(next, items, end)
        while (item := upcoming.result()) is not end:
            upcoming = pool.submit(next, items, end)
            yield cast("Item", item)


@contextmanager
def one_thread_each() -> Generator[None]:
    """Make processes that start inside the block compute with one thread, so that they do not compete for cores."""
    ours = {**_ONE_THREAD, "XLA_FLAGS": _one_thread_flags()}
    before = {name: os.environ.get(name) for name in ours}
    os.environ.update(ours)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _one_thread_flags() -> str:
    return f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false".strip()
