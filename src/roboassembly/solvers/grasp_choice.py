"""Chooses the grasp regions of real furniture so that two hands can join its parts in some order.

Annotation chooses the two regions of each part with nothing but the part and the finished furniture in view. If
hands then find no order of merges, this module looks for one with many regions on each part, and each part gets those
that the merges of this order use.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from roboassembly.furniture.annotate import add_candidate_grasps, parts_held_alike, with_grasps
from roboassembly.furniture.jaws import APPROACHES
from roboassembly.furniture.model import GRASP_REGIONS, Furniture, GraspRegion
from roboassembly.solvers.disassembly import Disassembly, Parts, Split
from roboassembly.solvers.hand_joints import HandJoints
from roboassembly.solvers.options import fitting
from roboassembly.task.full.task import FullTask
from roboassembly.task.rules.groups import TaskState, group_in_place

_CANDIDATES = (6, 16)
"""Numbers of regions on each part among which is chosen; the second if the first does not do."""
_ACTIONS = 50
"""Number of ways to hold both groups that are compared at each merge."""
_ORDERS = 6
"""Number of orders for which regions are chosen before there is no choice."""
_MOST_ORDERS = 40
"""Number of orders with straight ways out, and of others, that are tested before none counts as found."""
_Regions = dict[int, tuple[GraspRegion, ...]]
"""Regions by the first of each list of equal parts."""


@dataclass(frozen=True, eq=False)
class GraspChoice:
    """Furniture with its grasps, and what two hands can do with them."""

    furniture: Furniture
    order_exists: bool
    """Whether two hands can join the parts in some order; False if a part has no grasp at all."""


def choose_grasps(furniture: Furniture) -> GraspChoice:
    """Return the furniture with grasps by which two hands can join its parts in some order, if there are any.

    Grasps that do stay as they are. Arms, posts and paths are left to the planner.

    Args:
        furniture: annotated, with grasps.
    """
    if not all(part.grasps for part in furniture.parts):
        return GraspChoice(furniture, False)
    if hands_order(furniture) is not None:
        return GraspChoice(furniture, True)
    for candidates in _CANDIDATES:
        chosen = _chosen_among(furniture, candidates)
        if chosen is not None:
            return GraspChoice(chosen, True)
    return GraspChoice(furniture, False)


def _chosen_among(furniture: Furniture, candidates: int) -> Furniture | None:
    wide = add_candidate_grasps(furniture, candidates)
    rejected: set[frozenset[Parts]] = set()
    for _ in range(_ORDERS):
        order = hands_order(wide, rejected)
        if order is None:
            return None
        regions, stuck = _regions_for(wide, order)
        if stuck is None:
            completed = _completed(furniture, regions)
            chosen = with_grasps(furniture, {part: completed[first] for part, first in _leaders(furniture).items()})
            if hands_order(chosen) is not None:
                return chosen
        rejected.add(frozenset(stuck or order[-1]))
    return None


def hands_order(furniture: Furniture, rejected: Collection[frozenset[Parts]] = ()) -> list[Split] | None:
    """Return an order in which two hands can join the parts, if arms reach everywhere; None if none is found.

    After `_MOST_ORDERS` orders that hands cannot carry out, the search ends: each takes a second where parts are many.

    Args:
        furniture: with grasps, any number on each part.
        rejected: splits that must not be used.
    """
    grippers = HandJoints(FullTask(furniture))
    disassembly = Disassembly(furniture, lambda: False, joinable=grippers.may_join)
    parts = frozenset(frozenset([part]) for part in range(len(furniture.parts)))
    for straight in (True, False):
        for _ in range(_MOST_ORDERS):
            # A split that turns out to be impossible is in no later order.
            order = disassembly.order(parts, set(rejected), straight, exhaustive=not straight)
            if order is None:
                break
            if all(grippers.can_join(*split) for split in order):
                return order
    return None


def _regions_for(wide: Furniture, order: Sequence[Split]) -> tuple[_Regions, Split | None]:
    """Choose at most `GRASP_REGIONS` regions of each part for the merges of an order, the last merge first.

    Returns the regions and the split for which no more could be chosen; None if all have theirs.
    """
    leader = _leaders(wide)
    chosen: _Regions = dict.fromkeys(leader.values(), ())
    for split in reversed(order):
        only_chosen = with_grasps(wide, {part: chosen[first] for part, first in leader.items()})
        if next(_actions(only_chosen, split), None) is not None:
            continue
        full = {part: chosen[first] for part, first in leader.items() if len(chosen[first]) == GRASP_REGIONS}
        more = _with_another(chosen, with_grasps(wide, full), leader, split)
        if more is None:
            return chosen, split
        chosen = more
    return chosen, None


def _with_another(chosen: _Regions, choices: Furniture, leader: dict[int, int], split: Split) -> _Regions | None:
    """Return the chosen regions with those by which two hands join a split: as few new ones as possible, and of these
    the ones with most ways to hold both groups. None if there are too many for a part in any case."""
    counts: Counter[tuple[tuple[int, int], ...]] = Counter()
    known = {id(r): r for part in choices.parts for r in part.grasps}
    for u, v, _, _, g_a, g_b in islice(_actions(choices, split), _ACTIONS):
        gripped = ((u, g_a), (v, g_b))
        counts[tuple((leader[p], id(choices.parts[p].grasps[g // APPROACHES])) for p, g in gripped)] += 1
    best: tuple[int, int] | None = None
    out: _Regions | None = None
    for pair, count in counts.items():
        tried = dict(chosen)
        for part, region in pair:
            if not any(region == id(r) for r in tried[part]):
                tried[part] = (*tried[part], known[region])
        new = sum(map(len, tried.values()))
        if max(map(len, tried.values())) <= GRASP_REGIONS and (best is None or (new, -count) < best):
            best, out = (new, -count), tried
    return out


def _leaders(furniture: Furniture) -> dict[int, int]:
    """Return the first of the equal parts for each part."""
    return {part: equal[0] for equal in parts_held_alike(furniture) for part in equal}


def _actions(furniture: Furniture, split: Split) -> Iterator[tuple[int, ...]]:
    """Yield actions by which two hands join two sub-assemblies, either of them in the hand of R_a."""
    state = TaskState(tuple(group_in_place(furniture, slots) for slots in split))
    joints = list(furniture.joints_between(*split))
    return fitting(FullTask(furniture), state, [*joints, *((b, a) for a, b in joints)], lazy=True)


def _completed(furniture: Furniture, regions: _Regions) -> _Regions:
    """Return the regions with those that the parts had, as far as there is room; the nearer to the middle first."""
    out: _Regions = {}
    for part, chosen in regions.items():
        kept = [r for r in furniture.parts[part].grasps if not any(r is c for c in chosen)]
        all_of_part = (*chosen, *kept)[:GRASP_REGIONS]
        out[part] = tuple(sorted(all_of_part, key=lambda region: float(np.linalg.norm(region.position))))
    return out
