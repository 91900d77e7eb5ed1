"""The workcell: posts in a ring hold the parts; robots drive between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import WOOD_DENSITY
from roboassembly.geometry.poses import SE3, transform_points, turn_about_vertical
from roboassembly.task.full.posts import Post, most_open, reach_from
from roboassembly.task.rules.groups import Group

LANE = 0.35
"""Distance between the circles of neighbours in the ring [m]."""
BETWEEN_POSTS = 0.9
"""Distance between posts at least [m], wide enough for a platform."""
SMALLEST_RING = 1.6
"""Radius of the ring at least [m]."""
LARGEST = 4.0
"""Distance from corner to corner of furniture that the cell takes [m]."""
ROOMY = 2.26
"""Distance from corner to corner up to which two arms turn and set down furniture in the smallest ring [m]."""
AROUND = 2.0
"""Distance from the ring to the walls [m]."""
PAYLOAD = 3.0
"""Mass that a Panda can carry [kg]."""
_RESTS = 8
"""Number of rest poses in which a part is tried on its post."""


@dataclass(frozen=True, eq=False)
class Cell:
    """Size of the workcell for one piece of furniture."""

    radius: float
    """Radius of the ring of posts [m]."""
    density: float
    """Density at which a robot can carry the whole furniture [kg/m³]."""
    floor: float = field(init=False)
    """Distance from the middle to the walls [m]."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "floor", self.radius + AROUND)


def check_size(furniture: Furniture) -> float:
    """Return the density at which a robot can carry the whole furniture [kg/m³].

    Raises:
        InputError: a part has no grasp, or the furniture is too large for the cell.
    """
    for part in furniture.parts:
        if not part.grasps:
            raise InputError(
                f"{furniture.name}: no hand can hold part '{part.name}'; the full setting needs two opposite sides "
                "less than 76 mm apart on every part"
            )
    across = _across(furniture)
    if across > LARGEST:
        raise InputError(f"{furniture.name} is {across:.2f} m from corner to corner; the cell takes {LARGEST:.2f} m")
    volume = sum(p.mesh.volume for p in furniture.parts)
    return min(WOOD_DENSITY, PAYLOAD / volume)


def _across(furniture: Furniture) -> float:
    """Return the distance of assembled furniture from corner to corner [m]."""
    corners = [
        transform_points(a, p.mesh.hull_vertices) for p, a in zip(furniture.parts, furniture.assembled, strict=True)
    ]
    return float(np.linalg.norm(np.ptp(np.concatenate(corners), axis=0)))


def initial_layout(furniture: Furniture, rng: np.random.Generator) -> tuple[Cell, tuple[Group, ...], tuple[Post, ...]]:
    """Return cell, groups and posts with every part alone on a post of the ring, in a random order and pose.

    Raises:
        InputError: the furniture does not suit the cell, or a post finds no place beneath a part.
    """
    density = check_size(furniture)
    stands: list[list[Group]] = []
    for index, part in enumerate(furniture.parts):
        rotations, likely = part.mesh.resting_rotations
        poses: list[Group] = []
        for rest in rng.choice(len(rotations), size=min(_RESTS, len(rotations)), replace=False, p=likely):
            turn = turn_about_vertical(rng.uniform(-np.pi, np.pi))
            slot = furniture.assembled[index]
            pose = SE3(turn @ rotations[rest], np.zeros(3)) * slot.inverse()
            poses.append(Group((index,), (index,), (slot,), pose))
        stands.append(poses)
    radius, groups, posts = ring_layout(furniture, stands, rng)
    return Cell(radius, density), groups, posts


def ring_layout(
    furniture: Furniture, stands: Sequence[Sequence[Group]], rng: np.random.Generator
) -> tuple[float, tuple[Group, ...], tuple[Post, ...]]:
    """Return the radius of the ring [m], and groups and posts around it in a random order.

    Args:
        furniture: furniture of the groups.
        stands: poses in which each group may stand; it stands in the one that leaves most of its grasps open.
        rng: draws order and angle.

    Raises:
        InputError: a post finds no place beneath a group.
    """
    hung: list[tuple[Group, Post, float]] = []
    for poses in stands:
        best = most_open(furniture, poses)
        if best is None:
            names = ", ".join(f"'{furniture.parts[part].name}'" for part in poses[0].parts)
            raise InputError(f"{furniture.name}: neither one post nor two can hold part {names} from below")
        hung.append((*best, reach_from(furniture, *best)))
    order: list[int] = rng.permutation(len(hung)).tolist()
    widths = np.array([hung[i][2] for i in order])
    chords = np.maximum(widths + np.roll(widths, -1) + LANE, BETWEEN_POSTS)
    radius = max(SMALLEST_RING + max(0.0, _across(furniture) - ROOMY), float(chords.sum()) / (2.0 * np.pi) * 1.05)
    # Each post stands one chord behind the one before it.
    angles = (np.cumsum(chords) - chords) / chords.sum() * 2.0 * np.pi + rng.uniform(0.0, 2.0 * np.pi)
    groups: list[Group] = [hung[0][0]] * len(hung)
    posts: list[Post] = [hung[0][1]] * len(hung)
    for i, angle in zip(order, angles, strict=True):
        shift = radius * np.array([np.cos(angle), np.sin(angle), 0.0])
        group, post, _ = hung[i]
        groups[i] = group.moved_to(SE3(np.eye(3), shift) * group.world_from_furniture)
        posts[i] = post.moved(shift)
    return radius, tuple(groups), tuple(posts)
