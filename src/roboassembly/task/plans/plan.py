"""Record of an object-centric assembly: paths and poses. `plan.json` stores it, the viewer shows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Generic, TypeVar

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.task.plans.stability import PlanStability
from roboassembly.task.setting import SettingName


@dataclass(frozen=True, eq=False)
class PlanStep:
    """Record of one merge: a group moves along a path to its mate, and the merged group is released and settles."""

    action: tuple[int, ...]
    """`(u, v, k, l, w)` in the object-centric setting."""
    moving: dict[int, SE3]
    """`group_from_part` of each part of u's group. The frame of the group is at its centre of mass."""
    waiting: tuple[int, ...]
    """Parts of v's group."""
    still: dict[int, SE3]
    """World pose of every part that does not move during the path, v's group at its `w` pose included."""
    path: tuple[SE3, ...]
    """`world_from_group` way-points of the moving group, start to mating pose. Between two of them the translation
    is linear and the rotation spherical-linear."""
    settling: tuple[SE3, ...]
    """Motions of the world, every `SETTLING_INTERVAL` seconds, that take the merged group from its mating pose to its
    pose at that time. The first is the identity."""
    after: tuple[SE3, ...]
    """World pose of every part when the step is over."""
    planning_steps: int
    """Configurations tested for collision."""
    planner: str
    """Planner that found the path: `retreat` or `rrt-connect`."""
    planning_seconds: float
    """Wall time of the planning [s]; not part of `plan.json`."""


SETTLING_INTERVAL = 0.05
"""Simulated time between two poses of `PlanStep.settling` [s]."""


Motion = TypeVar("Motion")


@dataclass(frozen=True, eq=False)
class UprightResult(Generic[Motion]):
    """Whether the finished piece ends on its feet, and the motion that sets it there.

    The merges' `planning_steps` do not include those of this motion.
    """

    success: bool
    """Whether the piece stands on its feet at the end."""
    reason: str
    """Reason why the piece does not stand; empty if it does."""
    motion: Motion | None
    """Motion that sets the piece on its feet; None if none was found or the piece stood already."""
    planning_steps: int
    """Configurations tested for collision, failed attempts included."""
    planning_seconds: float
    """Wall time [s]; not part of `plan.json`."""


@dataclass(frozen=True, eq=False)
class UprightMotion:
    """Motion of the finished piece as one body along a path to its feet, after which it is released and settles."""

    moving: dict[int, SE3]
    """Pose of every part in the frame of the piece, whose origin is its centre of mass."""
    path: tuple[SE3, ...]
    """`world_from_piece` way-points. Between two of them the translation is linear and the rotation
    spherical-linear."""
    settling: tuple[SE3, ...]
    """Motions of the world that take the piece from the end of the path to rest, as in `PlanStep.settling`."""
    after: tuple[SE3, ...]
    """World pose of every part at rest."""
    planner: str
    """Planner that found the path."""


@dataclass(frozen=True, eq=False)
class Insertion:
    """Record of one fastener: it goes straight into a group that lies on the ground, or that is raised meanwhile."""

    fastener: int
    """Index into the furniture's fasteners."""
    after: int
    """Index of the step after which it goes in; -1 before the first one, the number of steps once the piece stands."""
    part: int
    """Part with which it moves from then on."""
    part_from_fastener: SE3
    path: tuple[SE3, ...]
    """`world_from_fastener` way-points from outside to its place. Between two of them the translation is linear and the
    rotation spherical-linear."""
    lift: float
    """Height by which its group is raised while it goes in [m]."""
    planning_steps: int
    """Configurations tested for collision, failed attempts included."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Plan of a whole assembly in the object-centric setting."""

    setting: ClassVar[SettingName] = "object-centric"

    furniture: Furniture
    initial: tuple[SE3, ...]
    """World pose of every part before the first step."""
    steps: tuple[PlanStep, ...]
    success: bool
    seed: int
    upright: UprightResult[UprightMotion] | None = None
    """Whether the piece ends on its feet; None if it is not assembled or `set_upright` was not called."""
    stability: PlanStability | None = None
    """Groups that stand on their own in each state; None if nobody asked."""
    insertions: tuple[Insertion, ...] = ()
    """Fasteners that go in, in their order; empty if there are none, or nobody asked for them."""
    not_inserted: tuple[tuple[int, str], ...] = ()
    """Index of each fastener for which no way in was found, and the reason."""

    @property
    def final_poses(self) -> tuple[SE3, ...]:
        """World pose of every part at the end."""
        if self.upright is not None and self.upright.motion is not None:
            return self.upright.motion.after
        return self.steps[-1].after if self.steps else self.initial
