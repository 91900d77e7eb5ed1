"""Order of a manual: a plan rearranged for people, and checked by the planner again.

Sub-assemblies are built one after the other, equal ones at once, and equal parts are joined one after the other. The
smaller half moves. For every sub-assembly an axis is chosen that points up while it is joined, so that the piece is
turned seldom, stands by itself, and parts come from above or from the side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from roboassembly.errors import RoboAssemblyError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.manual.exits import Handling
from roboassembly.manual.merge_tree import EqualTrees, Halves, MergeTree, Parts, ends_of, equalised
from roboassembly.planning.problem import Budget
from roboassembly.solvers.disassembly import Disassembly
from roboassembly.solvers.forward import planner_seed
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.plans.plan import Plan, PlanStep
from roboassembly.task.rules.connections import UP_AXES
from roboassembly.task.rules.groups import TaskState

UPRIGHT = 0
"""Index of the axis that points up when the finished piece stands."""
_TURN, _TURN_SMALL = 1.0, 0.3
"""Cost of turning the sub-assembly that waits, and the one that is brought in any case."""
_FALLS, _FALLS_AFTER = 3.0, 2.0
"""Cost of a sub-assembly that does not stand by itself while it waits, and after it is joined."""
_LEVEL, _FROM_BELOW = 0.6, 4.0
"""Cost of a motion from the side, and from below."""
_LARGER = 20.0
"""Cost of moving the larger half."""
_LARGER_BY = 1.02
"""Ratio of sizes from which a half counts as larger."""
_LYING = 0.01
"""Cost of any side up but the one of the finished piece, which decides between equals."""
_SUNK = 0.0009
"""Depth below the waiting half's lowest point at which the moving one is in the ground for the planner [m]."""
_PICTURE = 0.5
"""Cost of a picture."""
_DISASSEMBLY_STATES = 60_000
"""States that another order than the plan's may cost."""
_BUDGETS = (0, 2_000, 20_000)
"""States that the planner may test for one merge, one try after the other."""
_TRIES = 60


class ManualError(RoboAssemblyError):
    """The planner finds no way for a step of the manual."""


@dataclass(frozen=True)
class Choice:
    """How two halves are joined."""

    halves: Halves
    up: int
    """Index of the axis that points up, of `UP_AXES`."""


@dataclass(frozen=True, eq=False)
class CheckedMerge:
    """Merge that the planner has checked."""

    choice: Choice
    step: PlanStep
    way: tuple[SE3, ...]
    """Motions of the moving half out of its place, in the furniture's frame; the first is the identity."""


@dataclass(frozen=True, eq=False)
class ArrangedPlan:
    """Checked order of a manual."""

    plan: Plan
    """The rearranged plan."""
    merges: tuple[CheckedMerge, ...]
    """Its merges in their order."""
    trees: EqualTrees
    handling: Handling

    @cached_property
    def by_node(self) -> dict[Parts, CheckedMerge]:
        """Merge that makes each sub-assembly."""
        return {merge.choice.halves.merged: merge for merge in self.merges}


def arrange(furniture: Furniture, tree: MergeTree, seed: int) -> ArrangedPlan:
    """Return the order of a plan, rearranged for people and checked.

    Args:
        furniture: the piece.
        tree: order of the plan.
        seed: seed of the planner.

    Raises:
        ManualError: the planner finds no path for a merge, whichever half moves and whichever side is up.
    """
    handling = Handling(furniture, seed)
    task = ObjectCentricTask(furniture)
    drafts: list[_Draft] = []
    for rough in (tree, _by_disassembly(furniture, handling)):
        if rough is None:
            continue
        plain = _smaller_moves(handling, rough)
        regrouped = _equal_parts_together(furniture, handling, plain)
        trees = [regrouped] if regrouped == plain else [regrouped, plain]
        drafts += [_Draft(handling, equalised(furniture, t)) for t in trees]
    failed: Halves | None = None
    for _ in range(_TRIES):
        draft = min(drafts, key=lambda d: d.cost)
        if not np.isfinite(draft.cost):
            break
        checked = _check(task, handling, [draft.chosen[node] for node in building_order(draft.trees)], seed)
        if not isinstance(checked, Choice):
            plan, merges = checked
            return ArrangedPlan(plan, merges, draft.trees, handling)
        failed = checked.halves
        for other in drafts:
            other.ban(checked)
    where = "" if failed is None else (
        f" that joins {_names(furniture, failed.moving)} and {_names(furniture, failed.waiting)}"
    )  # fmt: skip
    raise ManualError(f"no manual: no path was found{where}, whichever of them moves and whichever side is up")


def _by_disassembly(furniture: Furniture, handling: Handling) -> MergeTree | None:
    """Return the order in which straight disassembly takes single parts off first; None if it finds none quickly."""
    disassembly = Disassembly(furniture, lambda: disassembly.graphs.states > _DISASSEMBLY_STATES)
    singles = frozenset(frozenset((p,)) for p in range(len(furniture.parts)))
    splits = disassembly.order(singles, set(), straight=True, exhaustive=False)
    return None if splits is None else {a | b: Halves(a, b) for a, b in splits}


class _Draft:
    """Tree with the cheapest choices that are not banned.

    Args:
        handling: geometry of the sub-assemblies.
        trees: the order.
    """

    def __init__(self, handling: Handling, trees: EqualTrees) -> None:
        self._handling = handling
        self.trees = trees
        self._banned: set[Choice] = set()
        self.cost, self.chosen = _choose(handling, trees, self._banned)
        self.pictures = _PICTURE * _picture_count(handling, trees)
        self.cost += self.pictures

    def ban(self, choice: Choice) -> None:
        """Choose again without a choice that the planner cannot carry out."""
        halves = self.trees.tree.get(choice.halves.merged)
        if halves is None or choice.halves not in (halves, halves.swapped):
            return
        self._banned.add(choice)
        if self.chosen.get(choice.halves.merged) == choice:
            self.cost, self.chosen = _choose(self._handling, self.trees, self._banned)
            self.cost += self.pictures


def _picture_count(handling: Handling, trees: EqualTrees) -> int:
    """Return how many merges differ from the ones before them, about: a manual has as many pictures."""
    count, before = 0, None
    for node in building_order(trees):
        if node in trees.original:
            continue
        halves = trees.tree[node]
        alike = (
            before is not None
            and before.merged in (halves.moving, halves.waiting)
            and any(_alike(handling.furniture, a, b) for a in (before.moving, before.waiting)
                    for b in (halves.moving, halves.waiting))
        )  # fmt: skip
        count += not alike
        before = halves
    return count


def _names(furniture: Furniture, parts: Parts) -> str:
    names = [f"'{furniture.parts[p].name}'" for p in sorted(parts)]
    return names[0] if len(names) == 1 else f"{names[0]} (with {len(names) - 1} more)"


def building_order(trees: EqualTrees) -> list[Parts]:
    """Return all sub-assemblies in the order in which a manual builds them: equal ones directly after each other."""
    order: list[Parts] = []
    done: set[Parts] = set()

    def build(node: Parts) -> None:
        if len(node) == 1 or node in done:
            return
        for equal in trees.equals(node):
            build(trees.tree[equal].waiting)
            build(trees.tree[equal].moving)
            if equal not in done:
                done.add(equal)
                order.append(equal)

    build(max(trees.tree, key=len))
    return order


def _smaller_moves(handling: Handling, tree: MergeTree) -> MergeTree:
    """Return the tree with the smaller half of each pair moving."""
    return {node: _larger_waits(handling, halves) for node, halves in tree.items()}


def _larger_waits(handling: Handling, halves: Halves) -> Halves:
    """Return the halves with the larger one waiting, or the heavier one if they are equally large."""
    moving, waiting = handling.size(halves.moving), handling.size(halves.waiting)
    if max(moving, waiting) < _LARGER_BY * min(moving, waiting):
        moving, waiting = handling.mass(halves.moving), handling.mass(halves.waiting)
    return halves.swapped if moving > waiting + 1e-6 else halves


def _equal_parts_together(furniture: Furniture, handling: Handling, tree: MergeTree) -> MergeTree:
    """Return the tree with equal parts that are joined to one trunk directly after each other, where they can be."""
    out = dict(tree)
    whole = max(tree, key=len)
    trunks = [whole, *(h.moving for h in tree.values() if len(h.moving) > 1)]
    for top in trunks:
        chain: list[Parts] = []
        node = top
        while node in out:
            chain.append(out[node].moving)
            node = out[node].waiting
        chain.reverse()
        root = node
        for after in range(len(chain) - 1):
            for later in range(after + 2, len(chain)):
                if _alike(furniture, chain[after], chain[later]) and not _alike(
                    furniture, chain[after], chain[after + 1]
                ):
                    moved = [*chain[: after + 1], chain[later], *chain[after + 1 : later], *chain[later + 1 :]]
                    if _can_follow(handling, root, moved, after + 1, later):
                        chain = moved
        _replace_chain(out, top, root, chain)
    return out


def _alike(furniture: Furniture, a: Parts, b: Parts) -> bool:
    """Whether two sub-assemblies are single parts of one shape."""
    return len(a) == len(b) == 1 and furniture.class_of[min(a)] == furniture.class_of[min(b)]


def _can_follow(handling: Handling, root: Parts, movers: list[Parts], first: int, last: int) -> bool:
    """Whether the movers of a range touch what is there before them, and come straight out of it."""
    trunk = root.union(*movers[:first])
    for mover in movers[first : last + 1]:
        halves = Halves(mover, trunk)
        if not handling.touch(mover, trunk) or not len(handling.directions(halves)):
            return False
        trunk = halves.merged
    return True


def _replace_chain(tree: MergeTree, top: Parts, root: Parts, movers: list[Parts]) -> None:
    node = top
    while node != root:
        node = tree.pop(node).waiting
    for mover in movers:
        halves = Halves(mover, node)
        node = halves.merged
        tree[node] = halves


def _choose(handling: Handling, trees: EqualTrees, banned: set[Choice]) -> tuple[float, dict[Parts, Choice]]:
    """Return the cheapest choice for every sub-assembly and their cost, by dynamic programming over the tree.

    The cost is infinite if nothing is left to choose.
    """
    tables: dict[Parts, list[tuple[float, Choice | None, int, int]]] = {}

    def table(node: Parts) -> list[tuple[float, Choice | None, int, int]]:
        """Return cost, choice, and axes of the waiting and of the moving half, for each axis that may point up."""
        if node not in tables:
            best: list[tuple[float, Choice | None, int, int]] = [(np.inf, None, 0, 0)] * len(UP_AXES)
            halves = _larger_waits(handling, trees.tree[node])
            for option, extra in ((halves, 0.0), (halves.swapped, _LARGER)):
                waiting, moving = _costs(option.waiting, _TURN), _costs(option.moving, _TURN_SMALL)
                for up in range(len(UP_AXES)):
                    if Choice(option, up) in banned:
                        continue
                    own = extra + _own_cost(handling, option, up)
                    cost = own + waiting[up][0] + moving[up][0]
                    if cost < best[up][0] - 1e-9:
                        best[up] = (cost, Choice(option, up), waiting[up][1], moving[up][1])
            tables[node] = best
        return tables[node]

    def _costs(parts: Parts, turn: float) -> list[tuple[float, int]]:
        """Return the least cost of having built a half when an axis is up, and the axis that was up before."""
        if len(parts) == 1:
            return [(0.0, up) for up in range(len(UP_AXES))]
        costs = [row[0] for row in table(parts)]
        out: list[tuple[float, int]] = []
        for up in range(len(UP_AXES)):
            cost, _, before = min((c + turn * (b != up), b != up, b) for b, c in enumerate(costs))
            out.append((cost, before))
        return out

    # Deep trees are built from below, so that nothing recurses far.
    for node in sorted(trees.tree, key=len):
        table(node)
    whole = max(trees.tree, key=len)
    final = [row[0] + _TURN * (up != UPRIGHT) for up, row in enumerate(table(whole))]
    chosen: dict[Parts, Choice] = {}
    stack = [(whole, int(np.argmin(final)))]
    while stack:
        node, up = stack.pop()
        _, choice, waiting_up, moving_up = table(node)[up]
        if choice is None:
            return np.inf, {}
        chosen[node] = choice
        stack += [
            (half, before)
            for half, before in ((choice.halves.waiting, waiting_up), (choice.halves.moving, moving_up))
            if len(half) > 1
        ]
    return min(final), _alike_chosen(trees, chosen, banned)


def _alike_chosen(trees: EqualTrees, chosen: dict[Parts, Choice], banned: set[Choice]) -> dict[Parts, Choice]:
    """Return the choices; what is built like another sub-assembly has the same half moving where that is not banned."""
    for node, first in trees.original.items():
        like, halves = chosen[first], trees.tree[node]
        same = trees.tree[first].moving == like.halves.moving
        choice = replace(chosen[node], halves=halves if same else halves.swapped)
        if choice not in banned:
            chosen[node] = choice
    return chosen


def _own_cost(handling: Handling, halves: Halves, up: int) -> float:
    """Return the cost of joining two halves while an axis is up; infinite if the moving half would be in the ground."""
    if handling.lowest(halves.moving, up) < handling.lowest(halves.waiting, up) - _SUNK:
        return np.inf
    cost = _LYING * (up != UPRIGHT)
    cost += _FALLS * (not handling.stands(halves.waiting, up))
    cost += _FALLS_AFTER * (not handling.stands(halves.merged, up))
    directions = handling.directions(halves)
    if len(directions):
        rising = float((directions @ UP_AXES[up]).max())
        cost += 0.0 if rising > 0.7 else _LEVEL if rising > -0.3 else _FROM_BELOW
    return cost


def _check(
    task: ObjectCentricTask, handling: Handling, order: list[Choice], seed: int
) -> tuple[Plan, tuple[CheckedMerge, ...]] | Choice:
    """Return the plan of an order, or the choice that the planner cannot carry out."""
    state = task.initial_state(np.random.default_rng(seed))
    initial = state.part_poses
    merges: list[CheckedMerge] = []
    for choice in order:
        planned = _planned(task, handling, state, choice, seed)
        if planned is None:
            return choice
        step, state = planned
        merges.append(CheckedMerge(choice, step, _way_out(task.furniture, choice, step)))
    return Plan(task.furniture, initial, tuple(m.step for m in merges), True, seed), tuple(merges)


def _planned(
    task: ObjectCentricTask, handling: Handling, state: TaskState, choice: Choice, seed: int
) -> tuple[PlanStep, TaskState] | None:
    """Plan one merge with more and more states; returns its record and the state after it, None if all fail."""
    moving, waiting = choice.halves.moving, choice.halves.waiting
    for states in _BUDGETS:
        motions = ()
        if states:
            # Whether two halves come apart at all depends on their shapes alone, and is asked once for all choices.
            if not handling.exits.separable(moving, waiting, states):
                continue
            motions = handling.exits.motions(moving, waiting)
        action = (*ends_of(task.furniture, choice.halves), choice.up)
        outcome = task.step(state, action, planner_seed(seed, action), Budget(states=states), motions)
        if outcome.step is not None:
            return outcome.step, outcome.state
    return None


def _way_out(furniture: Furniture, choice: Choice, step: PlanStep) -> tuple[SE3, ...]:
    still = min(choice.halves.waiting)
    world = step.still[still] * furniture.assembled[still].inverse()
    goal = step.path[-1]
    return tuple(world.inverse() * pose * goal.inverse() * world for pose in reversed(step.path))
