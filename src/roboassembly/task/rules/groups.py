"""Groups of rigidly joined parts, each part in a slot of the furniture; and the state that the groups make up."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import SAME_POINT, ConnectionPoint, Furniture
from roboassembly.geometry.poses import SE3, orthonormal, transform_points
from roboassembly.geometry.scene import Body, Shape


@dataclass(frozen=True, eq=False)
class Group:
    """Rigidly joined parts. The group's own frame is the furniture's frame, and its parts sit in slots of it."""

    parts: tuple[int, ...]
    """Ascending part indices."""
    slots: tuple[int, ...]
    """Slot that each part takes: another part's where equivalent parts are swapped."""
    furniture_from_part: tuple[SE3, ...]
    """Pose of each part in its slot, turned by a symmetry of its shape. Its connection points are not turned with it
    (`slot_of_points`).
    """
    world_from_furniture: SE3
    """Pose of the group."""

    def slot_of_points(self, part: int) -> int:
        """Return the slot whose connection points a part of this group has.

        A loose part has its own points. A joined part looks like the part whose slot it takes, so it has that part's
        points: the same number, in the same order, at the same places.
        """
        return part if len(self.parts) == 1 else self.slots[self.parts.index(part)]

    def points_of(self, furniture: Furniture, part: int) -> tuple[ConnectionPoint, ...]:
        """Return the connection points of a part of this group, in the frame of the slot that the part takes."""
        return furniture.parts[self.slot_of_points(part)].points

    def part_poses(self) -> tuple[SE3, ...]:
        """Return `world_from_part` for each part of the group."""
        return tuple(self.world_from_furniture * pose for pose in self.furniture_from_part)

    def moved_to(self, world_from_furniture: SE3) -> Group:
        """Return the same group at another pose."""
        return Group(self.parts, self.slots, self.furniture_from_part, orthonormal(world_from_furniture))


@dataclass(frozen=True, eq=False)
class TaskState:
    """Groups of all parts, with their poses. Immutable: a step makes a new one."""

    groups: tuple[Group, ...]

    @cached_property
    def group_of(self) -> dict[int, int]:
        """Index of the group of each part."""
        return {part: index for index, group in enumerate(self.groups) for part in group.parts}

    @cached_property
    def part_poses(self) -> tuple[SE3, ...]:
        """`world_from_part` by part index."""
        poses = {p: pose for group in self.groups for p, pose in zip(group.parts, group.part_poses(), strict=True)}
        return tuple(poses[p] for p in range(len(poses)))

    @property
    def complete(self) -> bool:
        """Whether all parts are in one group."""
        return len(self.groups) == 1

    def others(self, *parts: int) -> tuple[Group, ...]:
        """Return the groups that have none of some parts."""
        removed = {self.group_of[part] for part in parts}
        return tuple(group for index, group in enumerate(self.groups) if index not in removed)

    def after_merge(self, merged: Group) -> TaskState:
        """Return the state with a merged group in place of the groups of its parts."""
        return TaskState((*self.others(*merged.parts), merged))

    def occupied(self, furniture: Furniture) -> set[tuple[int, int]]:
        """Return connection points `(part, point)` that touch another part of their own group."""
        occupied: set[tuple[int, int]] = set()
        for group in self.groups:
            inside = set(group.slots)
            for part, slot in zip(group.parts, group.slots, strict=True) if len(inside) > 1 else ():
                for k in range(len(furniture.parts[slot].points)):
                    mate = furniture.mate_of.get((slot, k))
                    if mate is not None and mate[0] in inside:
                        occupied.add((part, k))
        return occupied


def group_in_place(furniture: Furniture, slots: Collection[int]) -> Group:
    """Return parts in their own slots as a group, in the furniture's frame."""
    own = tuple(sorted(slots))
    return Group(own, own, tuple(furniture.assembled[p] for p in own), SE3.Identity())


def point_at_slot(furniture: Furniture, group: Group, described: Group, end: tuple[int, int]) -> tuple[int, int] | None:
    """Return part and point of a group at a slot's point, for a group described by other slots (`PairRule.placements`).

    Args:
        furniture: whose slots they are.
        group: as it is.
        described: the same parts in the same place, described by other slots.
        end: slot that `described` takes, and a point of the part whose slot it is.

    Returns:
        The part in that slot, and the number of its point that lies there; None if it has none there.
    """
    slot, k = end
    part = described.parts[described.slots.index(slot)]
    if group.slot_of_points(part) == slot:
        return part, k
    there = described.world_from_furniture * furniture.assembled[slot]
    here = group.world_from_furniture * furniture.assembled[group.slots[group.parts.index(part)]]
    spots = transform_points(here.inverse() * there, np.array([p.position for p in furniture.parts[slot].points]))
    own = np.array([p.position for p in group.points_of(furniture, part)])
    # A loose part may still be turned about to lay its points on the slot's.
    loose = len(group.parts) == 1
    turns = furniture.classes[furniture.class_of[part]].symmetries if loose else np.eye(3)[None]
    distance = np.linalg.norm((spots @ turns)[:, :, None] - own, axis=3)
    best = int(np.argmax((distance.min(axis=2) < SAME_POINT).sum(axis=1)))
    nearest = int(np.argmin(distance[best, k]))
    return (part, nearest) if distance[best, k, nearest] < SAME_POINT else None


def part_from_points(furniture: Furniture, group: Group, part: int) -> SE3:
    """Return `part_from_points`: the identity, unless a symmetric part was turned as it took its slot."""
    index = group.parts.index(part)
    return group.furniture_from_part[index].actInv(furniture.assembled[group.slots[index]])


def center_of_mass(furniture: Furniture, group: Group) -> Float[np.ndarray, "3"]:
    """Return the centre of mass of a group of uniform density in the group's frame [m]."""
    parts = [furniture.parts[p] for p in group.parts]
    weights = np.array([part.mesh.volume for part in parts])
    centers = np.array([f.act(p.center_of_mass) for f, p in zip(group.furniture_from_part, parts, strict=True)])
    return weights @ centers / weights.sum()


def hull_points(furniture: Furniture, group: Group) -> Float[np.ndarray, "n 3"]:
    """Return the corners of the parts' convex hulls in the group's frame [m]."""
    return np.concatenate(
        [
            transform_points(pose, furniture.parts[p].mesh.hull_vertices)
            for p, pose in zip(group.parts, group.furniture_from_part, strict=True)
        ]
    )


@dataclass(frozen=True, eq=False)
class Circle:
    """Disc of the ground that a group covers, seen from above."""

    center: Float[np.ndarray, "2"]
    """Position in the world [m]."""
    radius: float
    """Radius [m]."""


def footprint(points: Float[np.ndarray, "n 3"]) -> Circle:
    """Return the circle around points, centred on the middle of their level bounding box."""
    center = 0.5 * (points[:, :2].min(axis=0) + points[:, :2].max(axis=0))
    return Circle(center, float(np.linalg.norm(points[:, :2] - center, axis=1).max()))


def group_footprint(furniture: Furniture, group: Group) -> Circle:
    """Return the circle that a group covers where it is."""
    pose = group.world_from_furniture
    return footprint(hull_points(furniture, group) @ pose.rotation.T + pose.translation)


def body(furniture: Furniture, group: Group, name: str, *, origin: Float[np.ndarray, "3"] | None = None,
         moves: bool = False) -> Body:  # fmt: skip
    """Return a group as a body whose frame is the group's, shifted to `origin` (in the group's frame)."""
    shift = SE3(np.eye(3), np.zeros(3) if origin is None else origin)
    shapes = tuple(
        Shape(furniture.parts[p].mesh, shift.actInv(pose))
        for p, pose in zip(group.parts, group.furniture_from_part, strict=True)
    )
    return Body(name, shapes, group.world_from_furniture * shift, moves)
