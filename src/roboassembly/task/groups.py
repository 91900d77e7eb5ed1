"""Groups: parts rigidly joined so far, each in a slot of the furniture; and the state that they make up."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import SAME_POINT, Furniture
from roboassembly.poses import SE3, orthonormal, transform_points
from roboassembly.scene import Body, Shape


@dataclass(frozen=True, eq=False)
class Group:
    """Parts held together. The group's own frame is the furniture's frame: its parts sit in slots of it."""

    parts: tuple[int, ...]
    """Ascending part indices."""
    slots: tuple[int, ...]
    """The slot that each part takes; another part's, where equivalent parts are swapped."""
    furniture_from_part: tuple[SE3, ...]
    """Each part in its slot, turned by a symmetry of its shape. Its connection points are not turned with it: shape
    and points are indistinguishable from those of the part whose slot it is, so its points are where that part's are.
    """
    world_from_furniture: SE3
    """Where the group is."""

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
            for part, slot in zip(group.parts, group.slots, strict=True):
                for k in range(len(furniture.parts[slot].points)):
                    mate = furniture.mate_of.get((slot, k))
                    own = corresponding_point(furniture, slot, k, part)
                    if mate is not None and mate[0] in inside and own is not None:
                        taken.add((part, own))
        return taken


def corresponding_point(furniture: Furniture, slot: int, k: int, part: int) -> int | None:
    """The point of `part`, in the place of the like part `slot`, that lies where point `k` of that part would."""
    if part == slot:
        return k
    spot = furniture.parts[slot].points[k].position
    apart = [float(np.linalg.norm(p.position - spot)) for p in furniture.parts[part].points]
    nearest = int(np.argmin(apart)) if apart else -1
    return nearest if apart and apart[nearest] < SAME_POINT else None


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


def body(furniture: Furniture, group: Group, name: str, *, origin: Float[np.ndarray, "3"] | None = None,
         moves: bool = False) -> Body:  # fmt: skip
    """The group as a body whose frame is the group's, shifted to `origin` (in the group's frame)."""
    shift = SE3(np.eye(3), np.zeros(3) if origin is None else origin)
    shapes = tuple(
        Shape(furniture.parts[p].mesh, shift.actInv(pose))
        for p, pose in zip(group.parts, group.furniture_from_part, strict=True)
    )
    return Body(name, shapes, group.world_from_furniture * shift, moves)
