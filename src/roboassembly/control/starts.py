"""Starts of episodes: all parts alone on posts, or some joined already so that one merge is to be made."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from roboassembly.control.randomization import Variation
from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, align_axis, turn_about_vertical
from roboassembly.solvers.disassembly import Disassembly, Split
from roboassembly.task.full.cell import Cell, check_size, ring_layout
from roboassembly.task.full.cell_state import CellState, PlacedGroup
from roboassembly.task.full.posts import Post
from roboassembly.task.full.task import FullTask, initial_robots
from roboassembly.task.plans.full_plan import FullState
from roboassembly.task.rules.connections import UP_AXES
from roboassembly.task.rules.groups import Group, TaskState


@dataclass(frozen=True, eq=False)
class MergeTask:
    """One merge that is to be made."""

    index: int
    """Number of the merge in the order of the piece, from 0."""
    first: tuple[int, ...]
    """Parts of the group that comes out first as the piece is taken apart."""
    second: tuple[int, ...]
    """Parts of the other group."""

    @property
    def groups(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Parts of both groups."""
        return self.first, self.second


def goal_pose(furniture: Furniture, merge: MergeTask) -> SE3:
    """Return the pose of the first group's lowest part in the frame of the second group's, once joined."""
    return furniture.assembled[merge.second[0]].actInv(furniture.assembled[merge.first[0]])


def merge_order(furniture: Furniture) -> list[Split]:
    """Return merges that build a piece, in a feasible order found by disassembly.

    Raises:
        InputError: there is none.
    """
    disassembly = Disassembly(furniture, lambda: False)
    alone = frozenset(frozenset({part}) for part in range(len(furniture.parts)))
    for straight, exhaustive in ((True, False), (False, False), (False, True)):
        order = disassembly.order(alone, set(), straight, exhaustive)
        if order is not None:
            return order
    raise InputError(f"{furniture.name}: no order of merges builds it")


def merge_tasks(furniture: Furniture) -> list[MergeTask]:
    """Return the merges that build a piece, in order.

    Raises:
        InputError: no order of merges builds the piece.
    """
    order = merge_order(furniture)
    return [MergeTask(k, tuple(sorted(a)), tuple(sorted(b))) for k, (a, b) in enumerate(order)]


def groups_before(furniture: Furniture, merges: list[MergeTask], index: int) -> list[tuple[int, ...]]:
    """Return the parts of each group before a merge, those of the lowest part first."""
    groups: set[tuple[int, ...]] = {(part,) for part in range(len(furniture.parts))}
    for merge in merges[:index]:
        groups -= {merge.first, merge.second}
        groups.add(tuple(sorted(merge.first + merge.second)))
    return sorted(groups)


def start_of_merge(task: FullTask, merges: list[MergeTask], index: int, rng: np.random.Generator) -> FullState:
    """Return a state in which all merges before one are made, each group on its post.

    Args:
        task: rules of the piece.
        merges: of the piece.
        index: number of the merge that comes next.
        rng: draws the layout.

    Raises:
        InputError: the furniture does not suit the cell, or no post can hold a group.
    """
    if index == 0:
        return task.initial_state(rng)
    task.check_furniture()
    furniture = task.furniture
    stands = [_stands(furniture, parts, rng) for parts in groups_before(furniture, merges, index)]
    radius, groups, posts = ring_layout(furniture, stands, rng)
    placed = tuple(PlacedGroup(group, post) for group, post in zip(groups, posts, strict=True))
    cell = Cell(radius, check_size(furniture))
    return FullState(TaskState(groups), CellState(placed, initial_robots(rng)), cell)


def _stands(furniture: Furniture, parts: tuple[int, ...], rng: np.random.Generator) -> list[Group]:
    """Return a group with each axis up, turned at random about the vertical."""
    slots = tuple(furniture.assembled[part] for part in parts)
    turns = [turn_about_vertical(rng.uniform(-np.pi, np.pi)) @ align_axis(up, UP_AXES[0]) for up in UP_AXES]
    return [Group(parts, parts, slots, SE3(turn, np.zeros(3))) for turn in turns]


def shifted(state: FullState, variation: Variation, rng: np.random.Generator) -> FullState:
    """Return a state whose groups stand a little elsewhere with their posts, each by draws of its own."""
    ranges = variation.ranges
    draws = [(rng.uniform(-1.0, 1.0, 2), float(rng.uniform(-1.0, 1.0))) for _ in state.cell_state.placed]
    if not (ranges.part_position or ranges.part_angle):
        return state
    placed: list[PlacedGroup] = []
    for (shift, turn), item in zip(draws, state.cell_state.placed, strict=True):
        by = _about(item.post.middle, ranges.part_angle * turn, ranges.part_position * shift)
        group = item.group.moved_to(by * item.group.world_from_furniture)
        placed.append(PlacedGroup(group, _moved_post(item.post, by)))
    groups = TaskState(tuple(item.group for item in placed))
    return replace(state, groups=groups, cell_state=replace(state.cell_state, placed=tuple(placed)))


def _moved_post(post: Post, by: SE3) -> Post:
    return Post(by.act(post.top), None if post.second is None else _moved_post(post.second, by))


def _about(place: Float[np.ndarray, "2"], turn: float, shift: Float[np.ndarray, "2"]) -> SE3:
    """Return the motion that turns about a vertical line and then shifts [m, rad]."""
    rotation = turn_about_vertical(turn)
    middle = np.array([*place, 0.0])
    return SE3(rotation, middle - rotation @ middle + [*shift, 0.0])
