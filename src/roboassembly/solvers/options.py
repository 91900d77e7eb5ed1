"""Which actions join two sub-assemblies, the most promising first: for the search, once it knows what to join."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product

import numpy as np

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.solvers.disassembly import Disassembly, Parts
from roboassembly.task.full.grips import Grip, MateGrasp
from roboassembly.task.full.task import FullTask
from roboassembly.task.plans.full_plan import FullState
from roboassembly.task.rules.connections import GRASPS, UP_AXES
from roboassembly.task.rules.groups import Group, TaskState, point_at_slot
from roboassembly.task.rules.pairs import Merge

_HOPELESS = -0.5
"""Score of an option that the first round leaves out: it would end in the ground, or leave the joint downward."""
_ARMS = 8
"""Actions tried that pass all tests before arms come in."""
Action = tuple[int, ...]
End = tuple[int, int]
"""Part and point."""
_OfOneHand = Callable[[Group, Group, Merge, Grip, int], bool]


def ends(
    furniture: Furniture, state: TaskState, told: TaskState, leaving: Parts, staying: Parts
) -> Iterator[tuple[End, End]]:
    """Parts and points of both groups that touch when the groups are joined: the leaving one's first.

    Args:
        furniture: that is assembled.
        state: in which both are groups.
        told: the same so that every slot is claimed once.
        leaving: slots that the one takes in `told`.
        staying: slots that the other takes there.
    """
    group_in = {slot: index for index, g in enumerate(told.groups) for slot in g.slots}
    for c in furniture.connections:
        a, b = (c.part_a, c.point_a), (c.part_b, c.point_b)
        if c.part_a in staying and c.part_b in leaving:
            a, b = b, a
        elif not (c.part_a in leaving and c.part_b in staying):
            continue
        one, two = (
            point_at_slot(furniture, state.groups[group_in[end[0]]], told.groups[group_in[end[0]]], end)
            for end in (a, b)
        )
        if one is not None and two is not None:
            yield one, two


def upright(
    disassembly: Disassembly, state: TaskState, told: TaskState, leaving: Parts, staying: Parts, straight: bool
) -> list[Action]:
    """`(u, v, k, l, w)`. Rising out of the joint is best; ending up in the ground is worst.

    Args:
        disassembly: of the furniture.
        state: in which both are groups.
        told: the same so that every slot is claimed once.
        leaving: slots that the one takes in `told`.
        staying: slots that the other takes there.
        straight: leave out what needs more than a straight way.
    """
    pair = next(ends(disassembly.furniture, state, told, leaving, staying), None)
    if pair is None:
        return []
    (one, k), (two, l) = pair  # noqa: E741
    end = {one: k, two: l}
    scored: list[tuple[float, Action]] = []
    for u, v, moving, waiting in ((one, two, leaving, staying), (two, one, staying, leaving)):
        directions = disassembly.exits(moving, waiting)
        low_moving, low_waiting = disassembly.graphs.lowest(moving), disassembly.graphs.lowest(waiting)
        for w, up in enumerate(UP_AXES):
            rise = max((float(d @ up) for d in directions), default=0.0)
            sinks = low_moving[w] < low_waiting[w] - 1e-3
            score = rise - 3.0 * sinks - 0.2 * (len(moving) > len(waiting))
            scored.append((round(score, 3), (u, v, end[u], end[v], w)))
    scored.sort(key=lambda item: -item[0])
    return [action for score, action in scored if score > _HOPELESS or not straight]


def grasping(task: FullTask, state: FullState, told: TaskState, leaving: Parts, staying: Parts) -> Iterator[Action]:
    """`(u, v, k, l, g_a, g_b)` that pass all tests before arms come in; R_b holds the heavier group first.

    Args:
        task: the rules.
        state: in which both are groups.
        told: the same so that every slot is claimed once.
        leaving: slots that the one takes in `told`.
        staying: slots that the other takes there.
    """
    furniture = task.furniture
    pairs = list(ends(furniture, state.groups, told, leaving, staying))
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


def fitting(
    task: FullTask, state: TaskState, pairs: list[tuple[End, End]], *, in_turn: bool = False
) -> Iterator[Action]:
    """Actions that pass the cheap tests, in an order that tries unlike ones early; what only a pair or only a grasp
    decides is looked at once for each.

    Args:
        task: the rules.
        state: of which both groups are part.
        pairs: points to be joined, those of R_a's group first.
        in_turn: look at each grasp when its turn comes, in another order: for who needs to know whether there are any.
    """
    groups = {part: state.groups[state.group_of[part]] for part in {end[0] for pair in pairs for end in pair}}

    def taken(part: int, grasp: int) -> Grip | None:
        return task.free_grip(groups[part], part, grasp)

    grasps = {part: [g for g in range(GRASPS) if in_turn or taken(part, g) is not None] for part in groups}
    tries = [(one, two, g_a, g_b) for one, two in pairs for g_a, g_b in product(grasps[one[0]], grasps[two[0]])]
    merges = {(one, two): task.merge(state, (one[0], two[0], one[1], two[1])) for one, two in pairs}
    known: dict[tuple[object, ...], bool] = {}

    def passes(test: _OfOneHand, u: int, v: int, merge: Merge, held: Grip, robot: int) -> bool:
        # Most pairs of two groups make the same merge.
        key = (test, robot, held.part, held.grasp, _told(merge.furniture_from_u), _told(merge.furniture_from_v))
        if key not in known:
            known[key] = test(groups[u], groups[v], merge, held, robot)
        return known[key]

    for index in np.random.default_rng(0).permutation(len(tries)):
        one, two, g_a, g_b = tries[index]
        (u, k), (v, m) = one, two
        merge, grip_a, grip_b = merges[one, two], taken(u, g_a), taken(v, g_b)
        if merge is None or grip_a is None or grip_b is None:
            continue
        # Whether either hand has room costs a tenth of whether one of them gets out.
        tests = product((task.grip_has_room, task.grip_fits), ((grip_a, 0), (grip_b, 1)))
        if not all(passes(test, u, v, merge, held, robot) for test, (held, robot) in tests):
            continue
        if isinstance(task.check_grips(groups[u], groups[v], merge, grip_a, grip_b), MateGrasp):
            yield u, v, k, m, g_a, g_b


def _told(pose: SE3) -> bytes:
    return (np.round(pose.homogeneous, 6) + 0.0).tobytes()
