"""Fasteners of an assembled piece: when each goes in, and the straight way on which it does.

Fasteners are put in after a step: into a group that lies on the ground, and that is raised above the ground if the way
in comes from below. A fastener goes in as soon as all parts that it joins are in one group and a way in is free. What
is hidden once the parts are joined, such as a dowel between two boards, goes into one of them before; the paths of all
later steps must then be free with it, or are planned again. All ways are checked with exact meshes, the fastener's as
the body of revolution that it covers in every turn.

Like the motion that sets the piece upright, insertions are planned when a plan is to be shown. Environments, rewards
and the planning steps of merges know nothing of them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.fasteners import has_head, profile_of, revolved
from roboassembly.furniture.model import Fastener, Furniture
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, transform_points, turn_about_vertical
from roboassembly.geometry.scene import Body, Scene, Shape
from roboassembly.planning.mating import MatingProblem, plan_mating
from roboassembly.planning.problem import Budget
from roboassembly.planning.world import CollisionWorld
from roboassembly.task.plans.plan import Insertion, Plan, PlanStep
from roboassembly.task.rules.pairs import PairRule

PITCH = 0.002
"""Way of a screw for one turn [m]."""
MOST_TURNS = 6
"""Largest number of turns of a screw as it goes in."""
OUTSIDE = 0.05
"""Distance between a fastener and the group where its way in begins [m]."""
_RAISED = 0.01
"""Distance between the ground and the lowest point of a fastener on its way in [m]."""
_BUDGET = 2_000
"""States with which a step is planned again that a fastener blocks."""
_NOT_IN_PLACE = "the parts that it joins are not where the furniture has them"


@dataclass(frozen=True, eq=False)
class _RestState:
    """State between two steps: which parts are joined, and where all are."""

    after: int
    """Index of the step before it; -1 before the first one, the number of steps once the piece stands upright."""
    groups: tuple[frozenset[int], ...]
    poses: tuple[SE3, ...]


@dataclass(eq=False)
class _Placed:
    """Fastener that is in."""

    index: int
    after: int
    host: frozenset[int]
    """Parts that it is fixed to."""
    part_from_fastener: dict[int, SE3]
    """Its pose in each of these parts."""


@dataclass(eq=False)
class _Planner:
    plan: Plan
    frame: SE3
    """`world_from_furniture` at the end."""
    part_in: dict[int, int]
    """Part in each slot."""
    steps: list[PlanStep]
    """Steps of the plan, some with new paths: those that a fastener blocked before."""
    after: Collection[int] | None
    """Steps after which fasteners may go in; all if None."""
    placed: list[_Placed] = field(default_factory=list[_Placed])
    states: int = 0
    solids: dict[Mesh, Mesh] = field(default_factory=dict[Mesh, Mesh])
    """Body of revolution around each mesh, which stands for it in every turn."""

    @property
    def furniture(self) -> Furniture:
        return self.plan.furniture

    def solid(self, fastener: Fastener) -> Mesh:
        """Return the body of revolution around a fastener."""
        if fastener.mesh not in self.solids:
            self.solids[fastener.mesh] = revolved(profile_of(fastener.mesh))
        return self.solids[fastener.mesh]

    def rest_states(self) -> list[_RestState]:
        """Return all states in which fasteners may go in."""
        groups = tuple(frozenset((p,)) for p in range(len(self.furniture.parts)))
        out = [_RestState(-1, groups, self.plan.initial)]
        for index, step in enumerate(self.plan.steps):
            merged = frozenset((*step.moving, *step.waiting))
            groups = (*(g for g in groups if not g & merged), merged)
            out.append(_RestState(index, groups, step.after))
        if self.plan.upright is not None and self.plan.upright.motion is not None:
            out.append(_RestState(len(self.plan.steps), groups, self.plan.upright.motion.after))
        return out

    def insert(self, index: int, rest_states: Sequence[_RestState]) -> Insertion | str:
        """Return when and how a fastener goes in, or the reason why it does not."""
        fastener = self.furniture.fasteners[index]
        joins = frozenset(self.part_in[slot] for slot in fastener.joins)
        reason = ""
        for rest, host in _places([m for m in rest_states if self.after is None or m.after in self.after], joins):
            place = self._in_parts(fastener, host)
            candidate = _Placed(index, rest.after, host, place)
            found = self._way_in(fastener, rest, host, place)
            if found is None:
                reason = reason or "no straight way in is free along its axis"
                continue
            paths = self._later_paths(candidate, rest_states)
            if paths is None:
                reason = reason or "a later step would hit it"
                continue
            self.steps = [
                replace(s, path=path) if path != s.path else s for s, path in zip(self.steps, paths, strict=True)
            ]
            self.placed.append(candidate)
            path, lift = found
            anchor = min(host)
            return Insertion(index, rest.after, anchor, place[anchor], path, lift, self.states)
        return reason

    def _in_parts(self, fastener: Fastener, host: frozenset[int]) -> dict[int, SE3]:
        """Return the pose of a fastener in each part of a group, as in the finished piece."""
        world = self.frame * fastener.place
        return {part: self.plan.final_poses[part].actInv(world) for part in sorted(host)}

    def _shapes(self, parts: frozenset[int], poses: Sequence[SE3], until: int) -> tuple[Shape, ...]:
        """Return parts and the fasteners in them up to a step, in the world."""
        shapes = [Shape(self.furniture.parts[p].mesh, poses[p]) for p in sorted(parts)]
        for other in self.placed:
            if other.host <= parts and other.after <= until:
                part, pose = next(iter(other.part_from_fastener.items()))
                shapes.append(Shape(self.solid(self.furniture.fasteners[other.index]), poses[part] * pose))
        return tuple(shapes)

    def _way_in(
        self, fastener: Fastener, rest: _RestState, host: frozenset[int], place: dict[int, SE3]
    ) -> tuple[tuple[SE3, ...], float] | None:
        """Return the way in from outside to the place, and how far the group is raised; None if it is not free."""
        group = next(g for g in rest.groups if host <= g)
        anchor = min(host)
        goal = rest.poses[anchor] * place[anchor]
        senses = (1.0,) if has_head(profile_of(fastener.mesh)) else (1.0, -1.0)
        for sense in senses:
            way = _way(fastener, goal, sense, self._length(fastener, group, rest, goal, -sense * goal.rotation[:, 2]))
            lowest = min(float((fastener.mesh.hull_vertices @ p.rotation[2]).min() + p.translation[2]) for p in way)
            lift = SE3(np.eye(3), np.array([0.0, 0.0, max(0.0, _RAISED - lowest)]))
            raised = [lift * pose for pose in rest.poses]
            still = [Body("group", self._shapes(group, raised, rest.after), SE3.Identity())]
            still += [
                Body(f"other{k}", self._shapes(other, rest.poses, rest.after), SE3.Identity())
                for k, other in enumerate(rest.groups)
                if other != group
            ]
            path = tuple(lift * pose for pose in way)
            mover = Body("fastener", (Shape(self.solid(fastener), SE3.Identity()),), path[0], moves=True)
            # The solid covers every turn, so that only the line has to be tested.
            if self._is_free(mover, still, (path[0], SE3(path[0].rotation, path[-1].translation))):
                return path, float(lift.translation[2])
        return None

    def _length(
        self, fastener: Fastener, group: frozenset[int], rest: _RestState, goal: SE3, out: Float[np.ndarray, "3"]
    ) -> float:
        """Return how far a fastener must move out until it is clear of a group, and `OUTSIDE` farther [m]."""
        corners = np.concatenate(
            [transform_points(rest.poses[p], self.furniture.parts[p].mesh.hull_vertices) for p in sorted(group)]
        )
        own = float(np.ptp(fastener.mesh.vertices[:, 2]))
        return max(0.0, float(((corners - goal.translation) @ out).max())) + own + OUTSIDE

    def _is_free(self, mover: Body, still: Sequence[Body], path: Sequence[SE3]) -> bool:
        world = CollisionWorld(Scene((mover, *still)))
        free = world.is_free(path[-1]) and all(world.edge_is_free(a, b) for a, b in pairwise(path))
        self.states += world.states
        return free

    def _later_paths(self, candidate: _Placed, rest_states: Sequence[_RestState]) -> list[tuple[SE3, ...]] | None:
        """Return the paths of all steps with a fastener in; None if it would be hit, or would sink into the ground.

        A path that it blocks is planned again with it.
        """
        fastener = self.furniture.fasteners[candidate.index]
        part, place = next(iter(candidate.part_from_fastener.items()))
        mesh = self.solid(fastener)

        def above(pose: SE3) -> bool:
            at = pose * place
            return float((mesh.hull_vertices @ at.rotation[2]).min() + at.translation[2]) > 0.0

        if not all(above(m.poses[part]) for m in rest_states if m.after > candidate.after):
            return None
        out = [step.path for step in self.steps]
        for index, step in enumerate(self.steps):
            if index <= candidate.after:
                continue
            is_mover = part in step.moving
            own = Shape(mesh, (step.moving if is_mover else step.still)[part] * place)
            moving, waiting, others = self._bodies(index)
            # Parts and fasteners already in place are free of each other; only the new fastener has to be tested.
            mover, obstacle = ((own,), (*waiting, *others)) if is_mover else (moving, (own,))
            bodies = [Body("mover", mover, step.path[0], moves=True), Body("obstacle", obstacle, SE3.Identity())]
            if (is_mover or above(step.still[part])) and self._is_free(bodies[0], bodies[1:], step.path):
                continue
            whole = (*moving, own) if is_mover else moving
            path = self._planned(index, whole, waiting if is_mover else (*waiting, own), others, candidate)
            if path is None:
                return None
            out[index] = path
        return out

    def _bodies(self, index: int) -> tuple[tuple[Shape, ...], tuple[Shape, ...], tuple[Shape, ...]]:
        """Return shapes of a step with fasteners: moving ones in their group, waiting and other ones in the world."""
        step, count = self.steps[index], len(self.furniture.parts)
        still = [step.still.get(p, SE3.Identity()) for p in range(count)]
        own = [step.moving.get(p, SE3.Identity()) for p in range(count)]
        waiting = frozenset(step.waiting)
        return (
            self._shapes(frozenset(step.moving), own, index - 1),
            self._shapes(waiting, still, index - 1),
            self._shapes(frozenset(step.still) - waiting, still, index - 1),
        )

    def _planned(
        self, index: int, moving: tuple[Shape, ...], waiting: tuple[Shape, ...], others: tuple[Shape, ...],
        candidate: _Placed,
    ) -> tuple[SE3, ...] | None:  # fmt: skip
        """Return a new path for a step with a fastener in, along the fastener out of its joint; None without one."""
        step = self.steps[index]
        start, goal = step.path[0], step.path[-1]
        part, place = next(iter(candidate.part_from_fastener.items()))
        at = (goal * step.moving[part] if part in step.moving else step.still[part]) * place
        axis = at.rotation[:, 2]
        away = axis if float((step.path[-2:][0].translation - goal.translation) @ axis) >= 0.0 else -axis
        mover = Body("moving", moving, start, moves=True)
        scene = Scene((mover, Body("waiting", waiting, SE3.Identity()), Body("others", others, SE3.Identity())))
        world = CollisionWorld(scene, box_axes=at.rotation)
        problem = MatingProblem(start, goal, "waiting", (away, -away))
        found = plan_mating(world, problem, Budget(states=_BUDGET), self.plan.seed)
        self.states += world.states
        return found.path if found.solved else None


def with_insertions(plan: Plan, after: Collection[int] | None = None) -> Plan:
    """Return the plan with the insertions of its fasteners, and with the reason for each that has no way in.

    A plan that did not succeed, or of furniture without fasteners, comes back as it is. The same plan gives the same
    insertions.

    Args:
        plan: of a whole assembly.
        after: steps after which fasteners may go in, see `Insertion.after`; all if None.
    """
    furniture = plan.furniture
    if not furniture.fasteners or not plan.success:
        return plan
    frame = next(PairRule(furniture).furniture_frames(plan.final_poses), None)
    if frame is None:
        left = tuple((index, _NOT_IN_PLACE) for index in range(len(furniture.fasteners)))
        return replace(plan, not_inserted=left)
    planner = _Planner(plan, frame, _parts_in_slots(furniture, plan.final_poses, frame), list(plan.steps), after)
    rest_states = planner.rest_states()
    done: list[Insertion] = []
    failed: list[tuple[int, str]] = []
    for index in range(len(furniture.fasteners)):
        planner.states = 0
        found = planner.insert(index, rest_states)
        if isinstance(found, Insertion):
            done.append(found)
        else:
            failed.append((index, found))
    done.sort(key=lambda insertion: insertion.after)
    return replace(plan, steps=tuple(planner.steps), insertions=tuple(done), not_inserted=tuple(failed))


def _parts_in_slots(furniture: Furniture, poses: Sequence[SE3], frame: SE3) -> dict[int, int]:
    """Return the part in each slot of the finished piece."""
    out: dict[int, int] = {}
    for shape in furniture.classes:
        for part in shape.members:
            at = frame.actInv(poses[part]).translation
            distances = [float(np.linalg.norm(furniture.assembled[slot].translation - at)) for slot in shape.members]
            out[shape.members[int(np.argmin(distances))]] = part
    return out


def _places(rest_states: Sequence[_RestState], joins: frozenset[int]) -> Iterator[tuple[_RestState, frozenset[int]]]:
    """Yield states in which a fastener may go in, with the parts that hold it: joined ones first, early ones first."""
    whole = [m for m in rest_states if any(joins <= g for g in m.groups)]
    yield from ((rest, joins) for rest in whole)
    before = [m for m in rest_states if m not in whole]
    for rest in reversed(before):
        for group in sorted(rest.groups, key=sorted):
            if group & joins:
                yield rest, group & joins


def _way(fastener: Fastener, goal: SE3, sense: float, length: float) -> tuple[SE3, ...]:
    """Return the poses on the way in, from outside to the place: screws turn over their own length, cams at the end.

    Args:
        fastener: what goes in.
        goal: its place in the world.
        sense: 1 if it goes in along its z axis, -1 against it.
        length: distance from its place at which it begins [m].
    """

    def at(out: float, turns: float) -> SE3:
        spin = turn_about_vertical(-2.0 * np.pi * turns * sense)
        return SE3(goal.rotation @ spin, goal.translation - sense * out * goal.rotation[:, 2])

    if fastener.kind == "dowel":
        return at(length, 0.0), goal
    if fastener.kind == "cam":
        return at(length, 0.5), at(0.0, 0.5), at(0.0, 0.25), goal
    own = float(np.ptp(fastener.mesh.vertices[:, 2]))
    turns = float(np.clip(np.ceil(own / PITCH), 1, MOST_TURNS))
    deep = min(own, length)
    quarters = round(4 * turns)
    driven = [at(deep * (1.0 - k / quarters), turns * (1.0 - k / quarters)) for k in range(quarters)]
    return (*((at(length, turns),) if length > deep else ()), *driven, goal)
