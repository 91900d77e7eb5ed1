"""Requests of one client that wait for their turn."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

MOST_WAITING = 64
"""Requests of one client. More are refused, so that a client that only asks cannot fill the memory."""
Request = Callable[[], None]


class Requests:
    """A queue that other threads fill and one thread empties."""

    def __init__(self) -> None:
        self._waiting: queue.Queue[tuple[Request, str]] = queue.Queue(MOST_WAITING)
        self._lock = threading.Lock()
        self._once: set[str] = set()

    def add(self, request: Request, once: str = "") -> bool:
        """Let a request wait.

        Args:
            request: called in its turn.
            once: name of requests of which one that waits does for all: each looks at the controls when its turn comes.

        Returns:
            Whether there is room for it.
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
        """The oldest request; waits for one.

        Raises:
            queue.Empty: none came within `timeout` seconds.
        """
        request, once = self._waiting.get(timeout=timeout)
        with self._lock:
            self._once.discard(once)
        return request
