"""Actions that join two given sub-assemblies, the most promising first; the search tries them in this order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from roboassembly.furniture.jaws import APPROACHES
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.solvers.disassembly import Disassembly, Parts
from roboassembly.task.rules.connections import UP_AXES
from roboassembly.task.rules.groups import Group, TaskState, point_at_slot
from roboassembly.task.rules.pairs import Merge

if TYPE_CHECKING:
    # Actions without robots are found without their libraries.
    from roboassembly.task.full.grips import Grip
    from roboassembly.task.full.task import FullTask
    from roboassembly.task.object_centric.stability import StandCheck
    from roboassembly.task.plans.full_plan import FullState

_HOPELESS = -0.5
"""Score below which the first round skips an action: it would end in the ground or approach from below."""
_SUNK = 0.005
"""Depth below the waiting group's lowest point at which the moving one certainly ends in the ground: more than the
clearance between ground and waiting group, and than what equal parts differ by [m]."""
_ARMS = 8
"""Number of actions tried per pair of groups that pass all tests without arms."""
Action = tuple[int, ...]
End = tuple[int, int]
"""Part and its connection point."""
_GripTest = Callable[[Group, Group, Merge, "Grip", int], bool]
"""Test of one grip: `(u_group, v_group, merge, grip, robot)`."""


def ends(
    furniture: Furniture, state: TaskState, assigned: TaskState, leaving: Parts, staying: Parts
) -> Iterator[tuple[End, End]]:
    """Yield the pairs of connection points that touch when two groups are joined, that of the leaving group first.

    Args:
        furniture: furniture that is assembled.
        state: state in which both are groups.
        assigned: same state with every slot claimed once.
        leaving: slots of the leaving group in `assigned`.
        staying: slots of the staying group in `assigned`.
    """
    group_in = {slot: index for index, g in enumerate(assigned.groups) for slot in g.slots}
    for a, b in furniture.joints_between(leaving, staying):
        leaving_end, staying_end = (
            point_at_slot(furniture, state.groups[group_in[end[0]]], assigned.groups[group_in[end[0]]], end)
            for end in (a, b)
        )
        if leaving_end is not None and staying_end is not None:
            yield leaving_end, staying_end


@dataclass(frozen=True)
class JoinOption:
    """Way to join two sub-assemblies: which of them moves, and which axis points up meanwhile."""

    moving: Parts
    waiting: Parts
    up: int
    """Index of the axis, of `UP_AXES`: the component `w` of an action."""
    score: float
    """Score; join_options whose exit rises most have the highest."""

    def unstable(self, stand_check: StandCheck) -> int:
        """Return the number of groups, of the waiting and the joined one, that do not stand on their own."""
        return sum(not stand_check.stands(group, self.up) for group in (self.waiting, self.moving | self.waiting))


def join_options(disassembly: Disassembly, leaving: Parts, staying: Parts, straight: bool) -> list[JoinOption]:
    """Return ways to join two sub-assemblies, the most promising first; those that end in the ground are left out.

    Args:
        disassembly: disassembly of the furniture.
        leaving: slots of a sub-assembly.
        staying: slots of the other one.
        straight: leave out ways that need more than a straight exit.
    """
    out: list[JoinOption] = []
    for moving, waiting in ((leaving, staying), (staying, leaving)):
        directions = disassembly.exits(moving, waiting)
        low_moving, low_waiting = disassembly.graphs.lowest(moving), disassembly.graphs.lowest(waiting)
        for w, up in enumerate(UP_AXES):
            if low_moving[w] < low_waiting[w] - _SUNK:
                continue
            rise = max((float(d @ up) for d in directions), default=0.0)
            sinks = low_moving[w] < low_waiting[w] - 1e-3
            score = round(rise - 3.0 * sinks - 0.2 * (len(moving) > len(waiting)), 3)
            if score > _HOPELESS or not straight:
                out.append(JoinOption(moving, waiting, w, score))
    out.sort(key=lambda way: -way.score)
    return out


def upright(
    disassembly: Disassembly,
    state: TaskState,
    assigned: TaskState,
    leaving: Parts,
    staying: Parts,
    straight: bool,
    stand_check: StandCheck | None = None,
) -> list[Action]:
    """Return actions `(u, v, k, l, w)`, one for each of `join_options`, in their order.

    Args:
        disassembly: disassembly of the furniture.
        state: state in which both are groups.
        assigned: same state with every slot claimed once.
        leaving: slots of the leaving group in `assigned`.
        staying: slots of the staying group in `assigned`.
        straight: as in `join_options`.
        stand_check: says which groups stand on their own; actions with few that do not come first. None if that does
            not matter.
    """
    pair = next(ends(disassembly.furniture, state, assigned, leaving, staying), None)
    if pair is None:
        return []
    left, stayed = pair
    out: list[Action] = []
    found = join_options(disassembly, leaving, staying, straight)
    if stand_check is not None:
        found.sort(key=lambda way: way.unstable(stand_check))
    for way in found:
        (u, k), (v, l) = (left, stayed) if way.moving == leaving else (stayed, left)  # noqa: E741
        out.append((u, v, k, l, way.up))
    return out


def grasping(task: FullTask, state: FullState, assigned: TaskState, leaving: Parts, staying: Parts) -> Iterator[Action]:
    """Yield actions `(u, v, k, l, g_a, g_b)` that pass all tests without arms, the heavier group with R_b first.

    Args:
        task: task with the rules.
        state: state in which both are groups.
        assigned: same state with every slot claimed once.
        leaving: slots of the leaving group in `assigned`.
        staying: slots of the staying group in `assigned`.
    """
    furniture = task.furniture
    pairs = list(ends(furniture, state.groups, assigned, leaving, staying))
    heavy = [sum(furniture.parts[p].mesh.volume for p in slots) for slots in (leaving, staying)]
    if heavy[0] > heavy[1]:
        pairs = [(b, a) for a, b in pairs]
    given = 0
    for roles in (pairs, [(b, a) for a, b in pairs]):
        for action in fitting(task, state.groups, roles):
            yield action
            given += 1
            if given == _ARMS:
                return


def fitting(task: FullTask, state: TaskState, pairs: list[tuple[End, End]], *, lazy: bool = False) -> Iterator[Action]:
    """Yield actions that pass the cheap tests, in a shuffled order that tries different ones early.

    Tests that depend only on a pair or only on a grasp run once for each.

    Args:
        task: task with the rules.
        state: state that contains both groups.
        pairs: points to be joined, that of R_a's group first.
        lazy: test each grasp only when its turn comes; faster for a caller that needs only the first action.
    """
    groups = {part: state.groups[state.group_of[part]] for part in {end[0] for pair in pairs for end in pair}}

    def grip_of(part: int, grasp: int) -> Grip | None:
        return task.free_grip(groups[part], part, grasp)

    grasps = {
        part: [
            g
            for g in range(APPROACHES * len(task.furniture.parts[part].grasps))
            if lazy or grip_of(part, g) is not None
        ]
        for part in groups
    }
    tries = [
        (u_end, v_end, g_a, g_b) for u_end, v_end in pairs for g_a, g_b in product(grasps[u_end[0]], grasps[v_end[0]])
    ]
    merges = {(a, b): task.merge(state, (a[0], b[0], a[1], b[1])) for a, b in pairs}
    known: dict[tuple[object, ...], bool] = {}

    def passes(test: _GripTest, u: int, v: int, merge: Merge, grip: Grip, robot: int) -> bool:
        # Most pairs of two groups make the same merge.
        key = (test, robot, grip.part, grip.grasp, _rounded(merge.furniture_from_u), _rounded(merge.furniture_from_v))
        if key not in known:
            known[key] = test(groups[u], groups[v], merge, grip, robot)
        return known[key]

    for index in np.random.default_rng(0).permutation(len(tries)):
        u_end, v_end, g_a, g_b = tries[int(index)]
        (u, k), (v, m) = u_end, v_end
        merge, grip_a, grip_b = merges[u_end, v_end], grip_of(u, g_a), grip_of(v, g_b)
        if merge is None or grip_a is None or grip_b is None:
            continue
        # `grip_has_room` takes a tenth of the time of `grip_fits`, so both grips pass it first.
        tests = product((task.grip_has_room, task.grip_fits), ((grip_a, 0), (grip_b, 1)))
        if not all(passes(test, u, v, merge, grip, robot) for test, (grip, robot) in tests):
            continue
        if task.grips_failure(groups[u], groups[v], merge, grip_a, grip_b) is None:
            yield u, v, k, m, g_a, g_b


def _rounded(pose: SE3) -> bytes:
    return (np.round(pose.homogeneous, 6) + 0.0).tobytes()
