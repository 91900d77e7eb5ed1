"""Steps of a manual: what is there, what comes and on which way, and how often the same is done."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, from_quaternion, interpolate, rotation_angle, transform_points
from roboassembly.manual.arrangement import UPRIGHT, ArrangedPlan, CheckedMerge, building_order
from roboassembly.manual.exits import Handling
from roboassembly.manual.merge_tree import Halves, Parts
from roboassembly.task.object_centric.insertion import with_insertions
from roboassembly.task.plans.plan import Insertion, Plan
from roboassembly.task.rules.groups import center_of_mass, group_in_place

MOST_EQUAL, MOST_MIXED = 8, 4
"""Largest numbers of parts that come in one step: of equal ones, and of different ones."""
_SAME_WAY = 0.98
"""Cosine between the ways of different parts that come in one step."""
_STRAIGHT = 0.999
"""Cosine with a straight way out above which the whole way counts as straight."""
_SMALL_TURN = 0.02
"""Turn on the first edge of a way below which the part is drawn without turn [rad]."""
_LEAST_GAP, _MOST_GAP, _GAP = 0.03, 0.22, 0.13
"""Distance between a part and its place, least, most and as a share of the size of the picture [m, m, 1]."""


@dataclass(frozen=True, eq=False)
class Mover:
    """Part or sub-assembly that comes in a step."""

    parts: Parts
    joined_to: Parts
    """Parts of the base that it touches."""
    way: tuple[SE3, ...]
    """Motions out of its place to where it is drawn, furniture frame; the first is the identity."""

    @property
    def away(self) -> SE3:
        """Motion out of its place to where it is drawn."""
        return self.way[-1]

    def arrow(self, center: Float[np.ndarray, "3"]) -> Float[np.ndarray, "n 3"]:
        """Return the points through which a point of it comes, from where it is drawn to its place [m]."""
        return np.array([motion.act(center) for motion in reversed(self.way)])


@dataclass(frozen=True, eq=False)
class FastenerWay:
    """Fastener that goes in in a step."""

    index: int
    """Index into the furniture's fasteners."""
    away: SE3
    """Motion out of its place to where it is drawn, furniture frame."""

    def arrow(self, furniture: Furniture) -> Float[np.ndarray, "2 3"]:
        """Return the points between which it goes in: its middle where it is drawn, and in its place [m]."""
        place = furniture.fasteners[self.index].place.translation
        return np.array([self.away.act(place), place])


@dataclass(frozen=True, eq=False)
class ManualStep:
    """One picture of a manual."""

    number: int
    base: Parts
    """Parts that are there."""
    movers: tuple[Mover, ...]
    up: int
    """Index of the axis that points up, of `UP_AXES`."""
    turned_from: int | None
    """Axis that pointed up before, if the base has to be turned for this step."""
    merges: tuple[Parts, ...]
    """Sub-assemblies that this step makes, those that are made in the same way included."""
    count: int
    """Number of times that the step is done."""
    fasteners: tuple[FastenerWay, ...] = ()
    """Fasteners that go into the base; a step has either these or movers."""

    @property
    def result(self) -> Parts:
        """Sub-assembly that is there afterward."""
        return self.base.union(*(mover.parts for mover in self.movers))


@dataclass(frozen=True, eq=False)
class Manual:
    """Steps of a manual and what they are made from."""

    furniture: Furniture
    arrangement: ArrangedPlan
    steps: tuple[ManualStep, ...]
    final_turn: int | None
    """Axis that points up after the last step, if the finished piece has to be turned to stand upright."""
    not_inserted: tuple[tuple[int, str], ...] = ()
    """Index of each fastener that has no way in in this order, and the reason."""

    @property
    def made_in(self) -> dict[Parts, int]:
        """Number of the step that makes each sub-assembly, equal ones included."""
        return {node: step.number for step in self.steps for node in step.merges}


def steps_of(arrangement: ArrangedPlan) -> Manual:
    """Return the steps of a checked order."""
    furniture, trees = arrangement.plan.furniture, arrangement.trees
    runs: list[list[CheckedMerge]] = []
    for node in building_order(trees):
        if node in trees.original:
            continue
        merge = arrangement.by_node[node]
        if runs and _continues(furniture, arrangement, runs[-1], merge):
            runs[-1].append(merge)
        else:
            runs.append([merge])
    steps: list[ManualStep] = []
    for number, run in enumerate(runs, start=1):
        first = run[0].choice
        base = first.halves.waiting
        gap = _gap(arrangement.handling, run[-1].choice.halves.merged)
        movers = tuple(_mover(arrangement.handling, merge, base, gap) for merge in run)
        before = arrangement.by_node[base].choice.up if len(base) > 1 else first.up
        nodes = [merge.choice.halves.merged for merge in run]
        merges = tuple(equal for node in nodes for equal in trees.equals(node))
        steps.append(
            ManualStep(
                number,
                base,
                movers,
                first.up,
                before if before != first.up else None,
                merges,
                len(merges) // len(nodes),
            )
        )
    last = steps[-1].up
    manual = Manual(furniture, arrangement, tuple(steps), None if last == UPRIGHT else last)
    return with_fastener_steps(manual) if furniture.fasteners else manual


def with_fastener_steps(manual: Manual) -> Manual:
    """Return the manual with the steps in which fasteners go in, all steps numbered anew.

    Fasteners go in between two steps. Those that go into equal single parts are drawn once.
    """
    arrangement, steps = manual.arrangement, manual.steps
    number_of = {node: k for k, step in enumerate(steps) for node in step.merges}
    step_of = [number_of[merge.choice.halves.merged] for merge in arrangement.merges]
    ends = {k: max(i for i, number in enumerate(step_of) if number == k) for k in range(len(steps))}
    plan = with_insertions(arrangement.plan, {-1, *ends.values()})
    out: list[ManualStep] = _fastener_steps(arrangement, plan, -1, steps[0].up)
    for k, step in enumerate(steps):
        out += [step, *_fastener_steps(arrangement, plan, ends[k], step.up)]
    numbered = tuple(replace(step, number=number) for number, step in enumerate(out, start=1))
    return replace(manual, steps=numbered, not_inserted=plan.not_inserted)


def _fastener_steps(arrangement: ArrangedPlan, plan: Plan, after: int, up: int) -> list[ManualStep]:
    """Return the steps of the fasteners that go in after a merge: one for each group that some go into."""
    furniture = plan.furniture
    groups = {p: frozenset((p,)) for p in range(len(furniture.parts))}
    for merge in arrangement.merges[: after + 1]:
        merged = merge.choice.halves.merged
        groups |= dict.fromkeys(merged, merged)
    into: dict[Parts, list[FastenerWay]] = {}
    for insertion in plan.insertions:
        if insertion.after == after:
            base = groups[insertion.part]
            into.setdefault(base, []).append(_fastener_way(arrangement.handling, insertion, base))
    out: list[ManualStep] = []
    for base, ways_in in into.items():
        alike = next((k for k, step in enumerate(out) if _same_work(furniture, step, base, ways_in)), None)
        if alike is None:
            out.append(ManualStep(0, base, (), up, None, (), 1, tuple(ways_in)))
        else:
            out[alike] = replace(out[alike], count=out[alike].count + 1)
    return out


def _same_work(furniture: Furniture, step: ManualStep, base: Parts, ways_in: Sequence[FastenerWay]) -> bool:
    """Whether the same fasteners go into an equal single part."""
    if len(base) != 1 or len(step.base) != 1 or furniture.class_of[min(base)] != furniture.class_of[min(step.base)]:
        return False
    mine, its = (sorted(id(furniture.fasteners[w.index].mesh) for w in some) for some in (ways_in, step.fasteners))
    return mine == its


def _fastener_way(handling: Handling, insertion: Insertion, base: Parts) -> FastenerWay:
    """Return how a fastener is drawn: on its way in, so far out that a gap is between it and the part."""
    fastener = handling.furniture.fasteners[insertion.fastener]
    along = insertion.path[0].rotation.T @ (insertion.path[0].translation - insertion.path[-1].translation)
    out = fastener.place.rotation @ along / max(1e-9, float(np.linalg.norm(along)))
    reach = float(np.ptp(fastener.mesh.vertices[:, 2])) + 0.35 * _gap(handling, base)
    return FastenerWay(insertion.fastener, SE3(np.eye(3), reach * out))


def _continues(furniture: Furniture, arrangement: ArrangedPlan, run: list[CheckedMerge], merge: CheckedMerge) -> bool:
    """Whether a merge belongs into the picture of the ones before it."""
    before, now = run[-1].choice, merge.choice
    trees, handling = arrangement.trees, arrangement.handling
    if now.halves.waiting != before.halves.merged or now.up != before.up:
        return False
    if len(trees.equals(before.halves.merged)) != len(trees.equals(now.halves.merged)):
        return False
    base = run[0].choice.halves.waiting
    if not handling.touch(now.halves.moving, base):
        return False
    alike = all(_same_shape(furniture, arrangement, other.choice.halves.moving, now.halves.moving) for other in run)
    gap = _gap(handling, now.halves.merged)
    latest, mine = (_mover(handling, m, base, gap) for m in (run[-1], merge))
    if alike:
        if len(run) >= MOST_EQUAL:
            return False
    else:
        small = all(len(m.choice.halves.moving) == 1 for m in (*run, merge))
        along = [m.away.translation / max(1e-9, float(np.linalg.norm(m.away.translation))) for m in (latest, mine)]
        if not small or len(run) >= MOST_MIXED or float(along[0] @ along[1]) < _SAME_WAY:
            return False
        # No mover may be in the way of another one of the same picture.
        for other, way in zip((*run, merge), (*along[:1] * len(run), along[1]), strict=True):
            rest = now.halves.merged - other.choice.halves.moving
            out = handling.directions(Halves(other.choice.halves.moving, rest))
            if not len(out) or float((out @ way).max()) < _SAME_WAY:
                return False
    return not any(_boxes_meet(handling, _mover(handling, m, base, gap), mine) for m in run)


def _same_shape(furniture: Furniture, arrangement: ArrangedPlan, a: Parts, b: Parts) -> bool:
    if len(a) == len(b) == 1:
        return furniture.class_of[min(a)] == furniture.class_of[min(b)]
    return a in arrangement.trees.equals(b)


def _boxes_meet(handling: Handling, a: Mover, b: Mover) -> bool:
    """Whether the boxes around two movers, where they are drawn, share a volume."""
    low, high = zip(
        *((p.min(axis=0), p.max(axis=0)) for p in (transform_points(m.away, handling.points(m.parts)) for m in (a, b))),
        strict=True,
    )
    return bool((np.maximum(*low) < np.minimum(*high)).all())


def _gap(handling: Handling, parts: Parts) -> float:
    size = float(np.linalg.norm(np.ptp(handling.points(parts), axis=0)))
    return float(np.clip(_GAP * size, _LEAST_GAP, _MOST_GAP))


def _mover(handling: Handling, merge: CheckedMerge, base: Parts, gap: float) -> Mover:
    halves = merge.choice.halves
    furniture = handling.furniture
    joined = frozenset(q for p in halves.moving for q in furniture.neighbours[p]) & base
    way = merge.way
    first = way[1] if len(way) > 1 else SE3.Identity()
    length = float(np.linalg.norm(first.translation))
    if length > 1e-9 and rotation_angle(first.rotation) < _SMALL_TURN:
        direction = first.translation / length
        reach = joint_depth(furniture, halves, direction) + gap
        straight = handling.directions(halves)
        if length >= reach or (len(straight) and float((straight @ direction).max()) > _STRAIGHT):
            return Mover(halves.moving, joined, (SE3.Identity(), SE3(np.eye(3), reach * direction)))
        return Mover(halves.moving, joined, _along(handling, halves.moving, way, reach))
    return Mover(halves.moving, joined, _along(handling, halves.moving, way, 2.0 * gap))


def _along(handling: Handling, parts: Parts, way: tuple[SE3, ...], reach: float) -> tuple[SE3, ...]:
    """Return the beginning of a way, as long as the centre of mass moves by `reach` [m]."""
    center = center_of_mass(handling.furniture, group_in_place(handling.furniture, parts))
    out, gone = [way[0]], 0.0
    for before, after in pairwise(way):
        length = float(np.linalg.norm(after.act(center) - before.act(center)))
        if gone + length >= reach:
            # Paths are interpolated at the centre of mass.
            shift = SE3(np.eye(3), center)
            column = interpolate(before * shift, after * shift, np.array([(reach - gone) / length]))[:, 0]
            pose = from_quaternion(column[:3], column[[6, 3, 4, 5]])
            return (*out, pose * shift.inverse())
        out.append(after)
        gone += length
    return tuple(out)


def joint_depth(furniture: Furniture, halves: Halves, direction: Float[np.ndarray, "3"]) -> float:
    """Return how far the moving half must go along a direction until its joints are apart, about [m].

    A corner of one part inside the box around the other, beyond the joint's point, tells how deep the joint is there.
    """
    deepest = 0.0
    for c in furniture.connections:
        p, q, point = c.part_a, c.part_b, c.point_a
        if p in halves.waiting and q in halves.moving:
            p, q, point = c.part_b, c.part_a, c.point_b
        elif not (p in halves.moving and q in halves.waiting):
            continue
        at = furniture.assembled[p].act(furniture.parts[p].points[point].position)
        depth = 0.0
        for part, other, sense in ((p, q, -1.0), (q, p, 1.0)):
            mine, box = (
                transform_points(furniture.assembled[k], furniture.parts[k].mesh.vertices) for k in (part, other)
            )
            inside = ((mine > box.min(axis=0) - 0.001) & (mine < box.max(axis=0) + 0.001)).all(axis=1)
            if inside.any():
                depth += max(0.0, float((sense * (mine[inside] - at) @ direction).max()))
        deepest = max(deepest, depth)
    return deepest
