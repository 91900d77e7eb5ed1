"""Order of an assembly as a tree: every sub-assembly and the two that it is joined from, by slots of the furniture.

Equal parts may swap slots, so a manual speaks of slots: each of them is taken by the part that the furniture has there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.task.rules.groups import TaskState, group_in_place
from roboassembly.task.rules.pairs import PairRule

Parts = frozenset[int]
"""Slots of the furniture."""


@dataclass(frozen=True)
class Halves:
    """Two sub-assemblies that are joined."""

    moving: Parts
    waiting: Parts

    @property
    def merged(self) -> Parts:
        """All of their parts."""
        return self.moving | self.waiting

    @property
    def swapped(self) -> Halves:
        """The same two with the other one moving."""
        return Halves(self.waiting, self.moving)


MergeTree = dict[Parts, Halves]
"""The two halves of each sub-assembly of more than one part."""


def tree_of(furniture: Furniture, actions: Sequence[tuple[int, ...]], name: str = "the plan") -> MergeTree:
    """Return the tree of a plan's actions, in either setting.

    Args:
        furniture: what the plan assembles.
        actions: `(u, v, k, l, ...)` of each merge.
        name: words for the plan in errors.

    Raises:
        InputError: an action joins nothing, or the actions do not assemble the whole piece.
    """
    rule = PairRule(furniture)
    state = TaskState(tuple(group_in_place(furniture, frozenset((p,))) for p in range(len(furniture.parts))))
    merges: list[tuple[Parts, Parts]] = []
    for index, (u, v, k, l, *_) in enumerate(actions):  # noqa: E741
        if not _ends_exist(furniture, state, (u, k), (v, l)):
            raise InputError(f"{name}, step {index}: action {tuple(actions[index])} names no two free points")
        u_group, v_group = state.groups[state.group_of[u]], state.groups[state.group_of[v]]
        merge = rule.judge_in(state, u, k, v, l)
        if merge is None:
            raise InputError(f"{name}, step {index}: action {tuple(actions[index])} joins parts that do not belong so")
        merges.append((frozenset(u_group.parts), frozenset(v_group.parts)))
        state = state.after_merge(merge.merged)
    if not state.complete:
        raise InputError(
            f"{name} ends with {len(state.groups)} separate groups; a manual needs a plan of the whole assembly"
        )
    (whole,) = state.groups
    slot_of = dict(zip(whole.parts, whole.slots, strict=True))
    in_slots = [Halves(*(frozenset(slot_of[p] for p in parts) for parts in pair)) for pair in merges]
    return {halves.merged: halves for halves in in_slots}


def _ends_exist(furniture: Furniture, state: TaskState, a: tuple[int, int], b: tuple[int, int]) -> bool:
    count = len(furniture.parts)
    if not (0 <= a[0] < count and 0 <= b[0] < count) or state.group_of[a[0]] == state.group_of[b[0]]:
        return False
    return all(
        0 <= point < len(state.groups[state.group_of[part]].points_of(furniture, part)) for part, point in (a, b)
    )


def nodes_below(tree: MergeTree, node: Parts) -> Iterator[Parts]:
    """Yield a sub-assembly and all that it is made of, if they have more than one part."""
    if node in tree:
        yield node
        yield from nodes_below(tree, tree[node].waiting)
        yield from nodes_below(tree, tree[node].moving)


@dataclass(frozen=True)
class EqualTrees:
    """Tree in which equal sub-assemblies are built in the same way."""

    tree: MergeTree
    original: dict[Parts, Parts]
    """The first of the equal sub-assemblies, for each of the others."""

    def equals(self, node: Parts) -> list[Parts]:
        """Return a sub-assembly and all that are built like it, the first one first."""
        first = self.original.get(node, node)
        return [first, *(other for other, origin in self.original.items() if origin == first)]


def equalised(furniture: Furniture, tree: MergeTree) -> EqualTrees:
    """Return the tree with equal sub-assemblies built as the first of them is.

    Args:
        furniture: whose tree it is.
        tree: of the whole piece.
    """
    rule, out = PairRule(furniture), dict(tree)
    original: dict[Parts, Parts] = {}
    left = sorted(out, key=lambda node: (-len(node), sorted(node)))
    while left:
        node = left.pop(0)
        if node not in out or node in original:
            continue
        for placed in rule.placements(group_in_place(furniture, node)):
            other = frozenset(placed.slots)
            if other & node or other not in out or other in original:
                continue
            slot = dict(zip(placed.parts, placed.slots, strict=True))
            _build_alike(out, original, node, slot)
        left.sort(key=lambda n: (-len(n), sorted(n)))
    # An image of an image has the same first one.
    for image, first in list(original.items()):
        while first in original:
            first = original[first]
        original[image] = first
    return EqualTrees(out, original)


def _build_alike(tree: MergeTree, original: dict[Parts, Parts], node: Parts, slot: dict[int, int]) -> None:
    """Rewrite the tree below the image of a node as the image of the tree below the node."""

    def image(parts: Parts) -> Parts:
        return frozenset(slot[p] for p in parts)

    for old in list(nodes_below(tree, image(node))):
        del tree[old]
        original.pop(old, None)
    for below in list(nodes_below(tree, node)):
        halves = tree[below]
        tree[image(below)] = Halves(image(halves.moving), image(halves.waiting))
        original[image(below)] = below


def ends_of(furniture: Furniture, halves: Halves) -> tuple[int, int, int, int]:
    """Return `(u, v, k, l)` of the first connection between two halves; all of them dictate the same place."""
    (u, k), (v, l) = next(furniture.joints_between(halves.moving, halves.waiting))  # noqa: E741
    return u, v, k, l
