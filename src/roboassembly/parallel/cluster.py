"""Workers on many machines: tasks of a Ray cluster, behind the face of a process pool.

All machines need this package in the same version, and the same folders under the same paths: results are files of the
run's folder. Tasks of a machine that is lost are begun again on another; as all long work here goes on from what is
written, no more than its last minute is lost.
"""

from __future__ import annotations

import os
import socket
import uuid
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from roboassembly.errors import InputError, MissingExtraError, RoboAssemblyError

_RETRIES = 10
"""Of a task whose machine, or process, was lost."""
_ANSWERS_WITHIN = 10.0
"""Seconds."""
_started: set[str] = set()
"""Of a worker process: pools whose `start` it has had."""


class Cluster(Executor):
    """A pool whose workers are tasks of the Ray cluster that this process is connected to.

    Args:
        start: what each process does first, with `arguments`.
        arguments: of `start`.
    """

    def __init__(self, start: Callable[..., None] | None = None, arguments: tuple[Any, ...] = ()) -> None:
        self._ray = ray = import_module("ray")
        self._task = ray.remote(num_cpus=1, max_retries=_RETRIES)(_work)
        # Large arguments are sent once, not with every task.
        self._told = ray.put((uuid.uuid4().hex, Path.cwd(), start, arguments))
        self._running: dict[Future[Any], Any] = {}

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """As of any executor; errors come back as they were raised."""
        future: Future[Any] = Future()
        future.set_running_or_notify_cancel()
        reference = self._task.remote(self._told, fn, args, kwargs)
        self._running[future] = reference
        reference.future().add_done_callback(lambda done: self._settle(future, done))
        return future

    def _settle(self, future: Future[Any], done: Future[Any]) -> None:
        self._running.pop(future, None)
        error = done.exception()
        if error is None:
            result, raised = done.result()
            _ = future.set_result(result) if raised is None else future.set_exception(raised)
        elif isinstance(error, self._ray.exceptions.RayTaskError):
            future.set_exception(error)
        else:
            future.set_exception(BrokenProcessPool(f"the cluster lost a task: {error}"))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for all tasks, or stop them."""
        for future, reference in list(self._running.items()):
            if cancel_futures:
                self._running.pop(future, None)
                self._ray.cancel(reference, force=True)
            elif wait:
                with suppress(Exception):
                    future.exception()


def _work(
    told: tuple[str, Path, Callable[..., None] | None, tuple[Any, ...]],
    fn: Callable[..., Any],
    args: tuple[Any, ...],
    kwargs: Mapping[str, Any],
) -> tuple[Any, RoboAssemblyError | None]:
    """On a worker. Errors that are raised on purpose are handed over as they are; Ray would wrap them."""
    pool, folder, start, arguments = told
    with suppress(OSError):
        os.chdir(folder)
    try:
        if start is not None and pool not in _started:
            start(*arguments)
        _started.add(pool)
        return fn(*args, **kwargs), None
    except RoboAssemblyError as error:
        return None, error


@contextmanager
def connected(address: str, environment: Mapping[str, str]) -> Iterator[int]:
    """Connect to a cluster; yields how many CPUs it has.

    Args:
        address: `HOST:PORT` of its head, `auto` for the one that this machine is part of, or `local` for one that is
            started here and ends with the block.
        environment: variables for its workers.

    Raises:
        MissingExtraError: without Ray.
        InputError: no cluster answers there.
    """
    try:
        ray = import_module("ray")
    except ModuleNotFoundError:
        raise MissingExtraError("ray", "ray") from None
    try:
        host, colon, port = address.rpartition(":")
        if colon and port.isdigit():
            # Ray itself would go on trying for minutes.
            socket.create_connection((host, int(port)), timeout=_ANSWERS_WITHIN).close()
        ray.init(
            address=address, runtime_env={"env_vars": dict(environment)}, log_to_driver=False, logging_level="ERROR"
        )
    except (OSError, ValueError, RuntimeError) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(
            f"--ray {address}: no cluster answers there ({reason:.120}); `ray start --head` starts one"
        ) from None
    try:
        yield max(1, int(ray.cluster_resources().get("CPU", 1)))
    finally:
        ray.shutdown()
