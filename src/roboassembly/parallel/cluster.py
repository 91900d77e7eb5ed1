"""Workers on many machines: tasks of a Ray cluster, with the interface of a process pool.

All machines need the same version of this package, and the same folders under the same paths: results are files in the
folder of the run. If a machine is lost, its tasks start again on another one. Long tasks continue from their files, so
they lose no more than a minute.
"""

from __future__ import annotations

import os
import socket
import uuid
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from roboassembly.errors import InputError, MissingExtraError, RoboAssemblyError

_RETRIES = 10
"""Number of retries of a task whose machine or process was lost."""
_CONNECT_TIMEOUT = 10.0
"""Time in which a cluster must answer [s]."""
_started: set[str] = set()
"""Pools whose `start` this worker process has run."""


class Cluster(Executor):
    """Executor whose workers are tasks of the Ray cluster that this process is connected to.

    Args:
        start: function that each process runs first, with `arguments`.
        arguments: arguments of `start`.
    """

    def __init__(self, start: Callable[..., None] | None = None, arguments: tuple[Any, ...] = ()) -> None:
        self._ray = ray = import_module("ray")
        self._task = ray.remote(num_cpus=1, max_retries=_RETRIES)(_work)
        # Ray sends these once, not with every task.
        self._setup = ray.put((uuid.uuid4().hex, Path.cwd(), start, arguments))
        self._running: dict[Future[Any], Any] = {}

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a task; the future raises the task's own errors."""
        future: Future[Any] = Future()
        future.set_running_or_notify_cancel()
        reference = self._task.remote(self._setup, fn, args, kwargs)
        self._running[future] = reference
        sent: Future[Any] = reference.future()
        sent.add_done_callback(lambda done: self._settle(future, done))
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
        """Wait for all tasks, or cancel them."""
        for future, reference in list(self._running.items()):
            if cancel_futures:
                self._running.pop(future, None)
                self._ray.cancel(reference, force=True)
            elif wait:
                with suppress(Exception):
                    future.exception()


def _work(
    setup: tuple[str, Path, Callable[..., None] | None, tuple[Any, ...]],
    fn: Callable[..., Any],
    args: tuple[Any, ...],
    kwargs: Mapping[str, Any],
) -> tuple[Any, RoboAssemblyError | None]:
    """Run a task on a worker; returns its result, or the package's own error, which Ray would wrap if raised."""
    pool, folder, start, arguments = setup
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
def connected(address: str, environment: Mapping[str, str]) -> Generator[int]:
    """Connect to a cluster; yields its number of CPUs.

    Args:
        address: `HOST:PORT` of its head, `auto` for the cluster of this machine, or `local` for a cluster that starts
            here and ends with the block.
        environment: environment variables of its workers.

    Raises:
        MissingExtraError: Ray is not installed.
        InputError: no cluster answers there.
    """
    try:
        ray = import_module("ray")
    except ModuleNotFoundError:
        raise MissingExtraError("ray", "ray") from None
    try:
        host, colon, port = address.rpartition(":")
        if colon and port.isdigit():
            # Ray itself tries for minutes.
            socket.create_connection((host, int(port)), timeout=_CONNECT_TIMEOUT).close()
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
