"""Threads of the BLAS library that NumPy calls."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache
from typing import Any

from threadpoolctl import ThreadpoolController


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()


def one_blas_thread() -> AbstractContextManager[Any]:
    """Return a context in which NumPy multiplies matrices in one thread.

    For small matrices, several threads wait for each other longer than they work, most of all on a busy machine; and
    sums come out the same whatever the number of cores.
    """
    return _controller().limit(limits=1, user_api="blas")
