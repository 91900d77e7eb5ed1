"""Work on many pieces, in processes of their own unless there is to be one only, on this machine or on a cluster; or
ahead of use, in a thread."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import active_children, get_context
from typing import Any, TypeVar, cast

from roboassembly.parallel.cluster import Cluster, connected

Item = TypeVar("Item")
Result = TypeVar("Result")
_ONE_THREAD = {
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"),
    "XLA_PYTHON_CLIENT_PREALLOCATE": "false",
}


_spread: list[str] = []
"""The cluster that `workers` come from, if any."""


@contextmanager
def use_cluster(address: str | None, jobs: int) -> Iterator[int]:
    """Within the block, workers come from a Ray cluster.

    Args:
        address: as `connected` takes it; None leaves them on this machine.
        jobs: to use on this machine.

    Yields:
        How many to use.

    Raises:
        MissingExtraError: without Ray.
        InputError: no cluster answers there.
    """
    if address is None:
        yield jobs
        return
    ours = ("ROBOASSEMBLY_", "JAX_", "PYTHONPATH")
    kept = {name: value for name, value in os.environ.items() if name.startswith(ours)}
    with connected(address, {**_ONE_THREAD, "XLA_FLAGS": _one_thread_flags(), **kept}) as count:
        _spread.append(address)
        try:
            yield count
        finally:
            _spread.pop()


@contextmanager
def worker_pool(
    jobs: int, start: Callable[..., None] | None = None, arguments: tuple[Any, ...] = ()
) -> Iterator[Executor]:
    """Processes to work in. When what they are used for ends early, be it by an error, they end too; by itself a pool
    would first do all that it was given.

    Spawned: a fork would share threads of the planner, the renderer and BLAS, and can hang.

    Args:
        jobs: how many.
        start: what each does first, with `arguments`.
        arguments: of `start`.
    """
    if _spread:
        cluster = Cluster(start, arguments)
        try:
            yield cluster
        except BaseException:
            cluster.shutdown(wait=False, cancel_futures=True)
            raise
        cluster.shutdown()
        return
    others = active_children()
    with ProcessPoolExecutor(jobs, get_context("spawn"), start, arguments) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in active_children():
                if process not in others:
                    process.terminate()
            raise


def map_ordered(work: Callable[[Item], Result], items: Sequence[Item], jobs: int, chunk: int) -> Iterator[Result]:
    """What `work` gives for each item, in their order; `chunk` of them go to a process at a time."""
    if jobs == 1:
        yield from map(work, items)
        return
    with worker_pool(jobs) as pool:
        with one_thread_each():
            results = pool.map(work, items, chunksize=chunk)
        yield from results


def map_unordered(work: Callable[[Item], Result], items: Sequence[Item], jobs: int) -> Iterator[Result]:
    """What `work` gives for each item, as they are done."""
    if jobs == 1:
        yield from map(work, items)
        return
    with worker_pool(jobs) as pool:
        with one_thread_each():
            futures = [pool.submit(work, item) for item in items]
        for done in as_completed(futures):
            yield done.result()


def prefetch(items: Iterator[Item]) -> Iterator[Item]:
    """The same items, each made in a thread while the one before it is in use."""
    end = object()
    with ThreadPoolExecutor(1) as pool:
        upcoming = pool.submit(next, items, end)
        while (item := upcoming.result()) is not end:
            upcoming = pool.submit(next, items, end)
            yield cast("Item", item)


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Processes started meanwhile compute with one thread, so that they do not fight for cores."""
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
