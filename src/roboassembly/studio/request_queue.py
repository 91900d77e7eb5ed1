"""Queue of the requests of one client."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

MOST_WAITING = 64
"""Largest number of waiting requests of one client. Further ones are refused, so that no client fills the memory."""
Request = Callable[[], None]


class RequestQueue:
    """Queue that several threads fill and one thread empties."""

    def __init__(self) -> None:
        self._waiting: queue.Queue[tuple[Request, str]] = queue.Queue(MOST_WAITING)
        self._lock = threading.Lock()
        self._once: set[str] = set()

    def __len__(self) -> int:
        """Return the number of waiting requests."""
        return self._waiting.qsize()

    def add(self, request: Request, once: str = "") -> bool:
        """Add a request; returns whether there was room for it.

        Args:
            request: function to call later.
            once: name of interchangeable requests; at most one request of this name waits at a time. Such a request
                reads the state of the controls when it is called.
        """
        with self._lock:
            if once and once in self._once:
                return True
            try:
                self._waiting.put_nowait((request, once))
            except queue.Full:
                return False
            if once:
                self._once.add(once)
            return True

    def next(self, timeout: float | None) -> Request:
        """Remove and return the oldest request; wait for one if there is none.

        Raises:
            queue.Empty: no request came within `timeout` seconds.
        """
        request, once = self._waiting.get(timeout=timeout)
        with self._lock:
            self._once.discard(once)
        return request
