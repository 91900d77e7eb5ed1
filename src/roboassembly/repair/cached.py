"""Cached functions of solids, by identity: a solid never changes, and most pairs of parts are looked at many times."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

SIZE = 1024
"""Number of results that each function keeps; a part has about 0.2 MB."""
_CLEAR: list[Callable[[], None]] = []


def cached(function: Callable[P, T]) -> Callable[P, T]:
    """Return a function that keeps its latest results until `forget`; its arguments are hashable."""
    kept = lru_cache(maxsize=SIZE)(function)
    _CLEAR.append(kept.cache_clear)

    @wraps(function)
    def look_up(*args: P.args, **kwargs: P.kwargs) -> T:
        return kept(*args, **kwargs)

    return look_up


def forget() -> None:
    """Drop all results, which keep their solids alive."""
    for clear in _CLEAR:
        clear()
