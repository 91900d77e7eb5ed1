"""Record of the stability of a plan's states: which groups stand on their own, and which must be held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property


class GroupRole(StrEnum):
    """Role of a group in a state of a plan."""

    WAITING = "waiting"
    """It waits, with the chosen axis up, while the other group comes."""
    JOINED = "joined"
    """It was just joined, and is released."""
    RESTING = "resting"
    """It lies on the ground between two steps."""


@dataclass(frozen=True)
class GroupStability:
    """Stability of one group in one state."""

    step: int
    """Index of the step; -1 before the first one."""
    role: GroupRole
    parts: tuple[int, ...]
    """Ascending part indices."""
    stable: bool
    """Whether it stands on its own."""
    tilt: float
    """Largest tilt by physics [rad]."""
    shift: float
    """Largest level motion of its centre of mass by physics [m]."""


@dataclass(frozen=True)
class PlanStability:
    """Stability of all groups in all states of a plan, in their order."""

    groups: tuple[GroupStability, ...]

    @cached_property
    def unstable(self) -> tuple[GroupStability, ...]:
        """Groups that do not stand on their own."""
        return tuple(group for group in self.groups if not group.stable)

    @property
    def stable(self) -> bool:
        """Whether every group stands on its own in every state."""
        return not self.unstable

    def group_to_hold(self, step: int) -> GroupStability | None:
        """Return the group that a hand or a fixture must hold in a step; None if all stand."""
        return next((group for group in self.unstable if group.step == step), None)

    @property
    def steps_held(self) -> tuple[int, ...]:
        """Indices of the steps in which a group must be held, ascending."""
        return tuple(sorted({group.step for group in self.unstable}))


def group_name(names: Sequence[str], parts: Sequence[int]) -> str:
    """Return words for a group, such as `post_left (+2)`: its first part, and how many others."""
    return names[parts[0]] + (f" (+{len(parts) - 1})" if len(parts) > 1 else "")
