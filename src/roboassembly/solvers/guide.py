"""Guides of the search: they suggest actions. A guide decides the order of branches, not which plans exist."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

State_contra = TypeVar("State_contra", contravariant=True)


@dataclass(frozen=True)
class Suggestion:
    """One action to try."""

    action: tuple[int, ...]
    """`(u, v, k, l, w)`, or `(u, v, k, l, g_a, g_b)` with robots."""
    score: float
    """Probability that the furniture can still be finished after the action, 0 to 1."""


class Guide(Protocol[State_contra]):
    """Function that suggests actions in a state."""

    def __call__(self, task: Any, state: State_contra) -> Sequence[Suggestion]:
        """Return actions to try, the most promising first; any may be wrong, and there may be none."""
        ...
