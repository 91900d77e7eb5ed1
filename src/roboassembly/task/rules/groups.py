"""Groups: parts rigidly joined so far, each in a slot of the furniture; and the state that they make up."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import SAME_POINT, ConnectionPoint, Furniture
from roboassembly.geometry.poses import SE3, orthonormal, transform_points
from roboassembly.geometry.scene import Body, Shape


@dataclass(frozen=True, eq=False)
class Group:
    """Parts held together. The group's own frame is the furniture's frame: its parts sit in slots of it."""

    parts: tuple[int, ...]
    """Ascending part indices."""
    slots: tuple[int, ...]
    """The slot that each part takes; another part's, where equivalent parts are swapped."""
    furniture_from_part: tuple[SE3, ...]
    """Each part in its slot, turned by a symmetry of its shape. Its connection points are not turned with it
    (`slot_of_points`).
    """
    world_from_furniture: SE3
    """Where the group is."""

    def slot_of_points(self, part: int) -> int:
        """The slot whose part's connection points a part of this group has.

        A loose part has its own. A joined part is not to be told from the part whose slot it takes, however it was
        turned on its way there, so it has that part's: the same number, in the same order, at the same places.
        """
        return part if len(self.parts) == 1 else self.slots[self.parts.index(part)]

    def points_of(self, furniture: Furniture, part: int) -> tuple[ConnectionPoint, ...]:
        """Connection points of a part of this group, in the frame of the slot that the part takes."""
        return furniture.parts[self.slot_of_points(part)].points

    def part_poses(self) -> tuple[SE3, ...]:
        """`world_from_part` for each part of the group."""
        return tuple(self.world_from_furniture * pose for pose in self.furniture_from_part)

    def moved_to(self, world_from_furniture: SE3) -> Group:
        """The same group elsewhere."""
        return Group(self.parts, self.slots, self.furniture_from_part, orthonormal(world_from_furniture))


@dataclass(frozen=True, eq=False)
class TaskState:
    """Where every part is and what is joined. Immutable: a step makes a new one."""

    groups: tuple[Group, ...]

    @cached_property
    def group_of(self) -> dict[int, int]:
        """Part index to index of its group."""
        return {part: index for index, group in enumerate(self.groups) for part in group.parts}

    @cached_property
    def part_poses(self) -> tuple[SE3, ...]:
        """`world_from_part` by part index."""
        poses = {p: pose for group in self.groups for p, pose in zip(group.parts, group.part_poses(), strict=True)}
        return tuple(poses[p] for p in range(len(poses)))

    @property
    def complete(self) -> bool:
        """All parts in one group."""
        return len(self.groups) == 1

    def occupied(self, furniture: Furniture) -> set[tuple[int, int]]:
        """Connection points `(part, point)` that touch another part of their own group."""
        taken: set[tuple[int, int]] = set()
        for group in self.groups:
            inside = set(group.slots)
            for part, slot in zip(group.parts, group.slots, strict=True) if len(inside) > 1 else ():
                for k in range(len(furniture.parts[slot].points)):
                    mate = furniture.mate_of.get((slot, k))
                    if mate is not None and mate[0] in inside:
                        taken.add((part, k))
        return taken


def point_at_slot(furniture: Furniture, group: Group, told: Group, end: tuple[int, int]) -> tuple[int, int] | None:
    """Part and point of a group at a slot's point, where the group is told in other slots (`PairRule.placements`).

    Args:
        furniture: whose slots they are.
        group: as it is.
        told: the same parts in the same place, told in other slots.
        end: slot that `told` takes, and a point of the part whose slot it is.

    Returns:
        The part in that slot, and the number of its point that lies there; None if it has none there.
    """
    slot, k = end
    part = told.parts[told.slots.index(slot)]
    if group.slot_of_points(part) == slot:
        return part, k
    there = told.world_from_furniture * furniture.assembled[slot]
    here = group.world_from_furniture * furniture.assembled[group.slots[group.parts.index(part)]]
    spots = transform_points(here.inverse() * there, np.array([p.position for p in furniture.parts[slot].points]))
    own = np.array([p.position for p in group.points_of(furniture, part)])
    # A loose part may still be turned about to lay its points on the slot's.
    loose = len(group.parts) == 1
    turns = furniture.classes[furniture.class_of[part]].symmetries if loose else np.eye(3)[None]
    apart = np.linalg.norm((spots @ turns)[:, :, None] - own, axis=3)
    best = int(np.argmax((apart.min(axis=2) < SAME_POINT).sum(axis=1)))
    nearest = int(np.argmin(apart[best, k]))
    return (part, nearest) if apart[best, k, nearest] < SAME_POINT else None


def part_from_points(furniture: Furniture, group: Group, part: int) -> SE3:
    """How far a part is turned under its points: the identity, unless a symmetric part was put in a slot turned."""
    index = group.parts.index(part)
    return group.furniture_from_part[index].actInv(furniture.assembled[group.slots[index]])


def center_of_mass(furniture: Furniture, group: Group) -> Float[np.ndarray, "3"]:
    """Of the group in its own frame (the furniture's), uniform density, metres."""
    weights = np.array([furniture.parts[p].mesh.volume for p in group.parts])
    centers = np.array([pose.translation for pose in group.furniture_from_part])
    return weights @ centers / weights.sum()


def hull_points(furniture: Furniture, group: Group) -> Float[np.ndarray, "n 3"]:
    """Corners of the parts' convex hulls in the group's frame, metres."""
    return np.concatenate(
        [
            transform_points(pose, furniture.parts[p].mesh.hull_vertices)
            for p, pose in zip(group.parts, group.furniture_from_part, strict=True)
        ]
    )


@dataclass(frozen=True, eq=False)
class Circle:
    """A disc of the ground that a group covers, seen from above."""

    center: Float[np.ndarray, "2"]
    """Metres, world."""
    radius: float
    """Metres."""


def footprint(points: Float[np.ndarray, "n 3"]) -> Circle:
    """The circle around the middle of the points' level box."""
    center = 0.5 * (points[:, :2].min(axis=0) + points[:, :2].max(axis=0))
    return Circle(center, float(np.linalg.norm(points[:, :2] - center, axis=1).max()))


def group_footprint(furniture: Furniture, group: Group) -> Circle:
    """The circle that a group covers where it is."""
    pose = group.world_from_furniture
    return footprint(hull_points(furniture, group) @ pose.rotation.T + pose.translation)


def body(furniture: Furniture, group: Group, name: str, *, origin: Float[np.ndarray, "3"] | None = None,
         moves: bool = False) -> Body:  # fmt: skip
    """The group as a body whose frame is the group's, shifted to `origin` (in the group's frame)."""
    shift = SE3(np.eye(3), np.zeros(3) if origin is None else origin)
    shapes = tuple(
        Shape(furniture.parts[p].mesh, shift.actInv(pose))
        for p, pose in zip(group.parts, group.furniture_from_part, strict=True)
    )
    return Body(name, shapes, group.world_from_furniture * shift, moves)
