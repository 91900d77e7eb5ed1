"""Stability of the states of a plan: whether each group stands on its own, without a hand or a fixture.

A group is released with its lowest point `GROUND_CLEARANCE` above the ground, as it lies or waits and nudged by `NUDGE`
to four sides, and simulated for `SECONDS`. It is stable if it then has tilted by at most `LARGEST_TILT` and moved
sideways by at most `LARGEST_SHIFT`, each time. Groups on the ground do not touch, so each is simulated alone. The
support polygon decides first where it is exact (`geometry.support`); a report of a plan always asks physics, too.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, align_axis
from roboassembly.geometry.support import SupportHull
from roboassembly.task.layout import GROUND_CLEARANCE
from roboassembly.task.object_centric.stance import NUDGE, nudges, tilt
from roboassembly.task.plans.plan import Plan, PlanStep
from roboassembly.task.plans.stability import GroupRole, GroupStability, PlanStability
from roboassembly.task.rules.connections import UP_AXES
from roboassembly.task.rules.groups import Group, body, center_of_mass, group_in_place, hull_points

SECONDS = 1.0
"""Simulated time for which a group has to keep its pose [s]."""
LARGEST_TILT = float(np.deg2rad(5.0))
"""Largest tilt of a stable group [rad]."""
LARGEST_SHIFT = 0.02
"""Largest level motion of the centre of mass of a stable group [m]."""
_UP = np.array([0.0, 0.0, 1.0])
_DIGITS = 9
"""Decimals of poses that count as the same."""


@dataclass(frozen=True)
class Release:
    """Result of physics: the largest motion of a group within `SECONDS` after it is released."""

    tilt: float
    """Angle between the directions in the group that pointed up before and after [rad]."""
    shift: float
    """Level motion of the centre of mass [m]."""

    @property
    def stable(self) -> bool:
        """Whether the group stands on its own."""
        return self.tilt <= LARGEST_TILT and self.shift <= LARGEST_SHIFT


def support_of(furniture: Furniture, group: Group) -> SupportHull:
    """Return the hull of a group, in its own frame, that says on which sides it rests."""
    return SupportHull(hull_points(furniture, group), center_of_mass(furniture, group))


def polygon_verdict(support: SupportHull, up: Float[np.ndarray, "3"]) -> bool | None:
    """Return whether a group stands on its own with a direction up by its support polygon; None if it cannot tell."""
    return support.rests(up, NUDGE, GROUND_CLEARANCE, LARGEST_TILT, LARGEST_SHIFT)


def release_group(furniture: Furniture, group: Group, *, until_moved: bool = False) -> Release:
    """Return how far a group moves once it is released where it is, by physics.

    Args:
        furniture: furniture of the group.
        group: to be released.
        until_moved: stop at the first release after which it is not where it was.
    """
    from roboassembly.simulation.settle import release

    origin = center_of_mass(furniture, group)
    falling = body(furniture, group, "released", origin=origin, moves=True)
    corners = hull_points(furniture, group) - origin
    turns = [turn @ falling.pose.rotation for turn in (np.eye(3), *nudges())]
    starts = [_above_ground(corners, turn) for turn in turns]
    out = Release(0.0, 0.0)
    for start, end in zip(starts, release(falling, starts, SECONDS), strict=True):
        shift = float(np.linalg.norm((end.translation - start.translation)[:2]))
        out = Release(max(out.tilt, tilt(end.rotation @ falling.pose.rotation.T)), max(out.shift, shift))
        if until_moved and not out.stable:
            break
    return out


def _above_ground(corners: Float[np.ndarray, "n 3"], turn: Float[np.ndarray, "3 3"]) -> SE3:
    """Return the pose above the origin of the world with some rotation."""
    return SE3(turn, np.array([0.0, 0.0, GROUND_CLEARANCE - float((corners @ turn[2]).min())]))


class StandCheck:
    """Whether sub-assemblies of a piece stand with an axis of the furniture up. Results are cached.

    Args:
        furniture: the piece.
    """

    def __init__(self, furniture: Furniture) -> None:
        self._furniture = furniture
        self._supports: dict[frozenset[int], SupportHull] = {}
        self._known: dict[tuple[frozenset[int], int], bool] = {}

    def stands(self, slots: Collection[int], up: int) -> bool:
        """Return whether parts in these slots stand with an axis of `UP_AXES` up, by polygon, else by physics."""
        parts = frozenset(slots)
        if (parts, up) not in self._known:
            group = group_in_place(self._furniture, parts)
            if parts not in self._supports:
                self._supports[parts] = support_of(self._furniture, group)
            sure = polygon_verdict(self._supports[parts], UP_AXES[up])
            if sure is None:
                upright = group.moved_to(SE3(align_axis(UP_AXES[up], _UP), np.zeros(3)))
                sure = release_group(self._furniture, upright, until_moved=True).stable
            self._known[parts, up] = sure
        return self._known[parts, up]


def plan_stability(plan: Plan) -> PlanStability:
    """Return the stability of every group in every state of a plan, by physics.

    A step has two states of its own, the group that waits and the joined group as it is released, and the groups that
    lie on the ground when it is over. The state before the first step has the number -1.
    """
    known: dict[bytes, Release] = {}
    furniture = plan.furniture
    groups = [(p,) for p in range(len(furniture.parts))]
    out: list[GroupStability] = []

    def add(step: int, role: GroupRole, placed: Mapping[int, SE3]) -> None:
        parts = tuple(sorted(placed))
        group = Group(parts, parts, tuple(placed[p] for p in parts), SE3.Identity())
        key = np.round([placed[p].homogeneous for p in parts], _DIGITS).tobytes() + repr(parts).encode()
        if key not in known:
            known[key] = release_group(furniture, group)
        found = known[key]
        out.append(GroupStability(step, role, parts, found.stable, found.tilt, found.shift))

    for parts in groups:
        add(-1, GroupRole.RESTING, {p: plan.initial[p] for p in parts})
    for index, step in enumerate(plan.steps):
        waiting = {p: step.still[p] for p in step.waiting}
        add(index, GroupRole.WAITING, waiting)
        add(index, GroupRole.JOINED, waiting | {p: step.path[-1] * pose for p, pose in step.moving.items()})
        groups = _merged(groups, step)
        for parts in groups:
            add(index, GroupRole.RESTING, {p: step.after[p] for p in parts})
    return PlanStability(tuple(out))


def _merged(groups: list[tuple[int, ...]], step: PlanStep) -> list[tuple[int, ...]]:
    """Return the groups after a step, by their parts."""
    merged = tuple(sorted((*step.moving, *step.waiting)))
    return [*(g for g in groups if not set(g) & set(merged)), merged]


def with_stability(plan: Plan) -> Plan:
    """Return the plan with the stability of its states."""
    return replace(plan, stability=plan_stability(plan))
