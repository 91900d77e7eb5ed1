"""What the search may be guided by: something that suggests actions. It orders branches; nothing hangs on it."""

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
    """How likely the furniture can still be finished after it, 0 to 1."""


class Guide(Protocol[State_contra]):
    """Suggests what to do in a state."""

    def __call__(self, task: Any, state: State_contra) -> Sequence[Suggestion]:
        """Actions worth trying, the most promising first; any may be wrong, and there may be none."""
        ...
