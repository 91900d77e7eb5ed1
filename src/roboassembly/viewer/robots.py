"""From an assembly by two robots to pictures in time: parts, both robots' links, and the posts that are up.

Each leg gets a share of its step's time by how far it goes; all motion is eased, so that nothing jerks.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from roboassembly.geometry.poses import SE3
from roboassembly.rendering.colors import Role
from roboassembly.robots.body import hand_links, links, placed
from roboassembly.task.full.cell import Stand, post_mesh
from roboassembly.task.full.cell_state import Leg, Moment
from roboassembly.task.plans.full_plan import FullPlan
from roboassembly.viewer.timeline import (
    FINALE_SECONDS,
    OVERTURE_SECONDS,
    Frame,
    Phase,
    Thing,
    Timeline,
    check_rates,
    ending_caption,
    expected_steps,
    onto,
    parts_of,
)

_METRES_A_RADIAN = 0.35
"""How far a turn of the platform or of a joint counts beside a drive."""
_SHORTEST = 0.25
"""Metres that every leg counts at least: short ones matter as much."""


def make_full_timeline(plan: FullPlan, *, frames_per_second: float, seconds_per_step: float) -> Timeline:
    """Lay a plan out in time. A plan that failed is laid out as far as it got.

    Raises:
        InputError: a rate or duration that is not a positive finite number.
    """
    check_rates(frames_per_second, seconds_per_step)
    director = FullDirector(plan, frames_per_second, seconds_per_step)
    return Timeline(plan.furniture.name, director.things, tuple(director.frames()), frames_per_second)


@dataclass(frozen=True)
class FullDirector:
    """Makes frames of a plan, all or those of one step."""

    plan: FullPlan
    fps: float
    seconds: float
    """About how long a step lasts."""

    @cached_property
    def stands(self) -> tuple[Stand, ...]:
        """All posts that are ever up."""
        return self.plan.stands

    @property
    def things(self) -> tuple[Thing, ...]:
        """What the frames show; posts last, those of a longer plan after those of a shorter one."""
        own = [*links(), *(link for link, _ in hand_links(0.0))]
        robots = [Thing(f"robot_{name}/{i}_{link.name}", link.mesh) for name in "ab" for i, link in enumerate(own)]
        posts = [Thing(f"posts/{i}", post_mesh(float(s.top[2])), framed=False) for i, s in enumerate(self.stands)]
        return (*parts_of(self.plan.furniture), *robots, *posts)

    def opening(self) -> Frame:
        """Before the first step."""
        furniture = self.plan.furniture
        text = f"{furniture.name}: {len(furniture.parts)} parts, two robots"
        return self._still(self.plan.initial.moment, Phase.OVERTURE, text)

    def frames(self) -> Iterator[Frame]:
        """All of them."""
        plan, steps = self.plan, len(self.plan.steps)
        yield from itertools.repeat(self.opening(), self._count(OVERTURE_SECONDS))
        for index in range(steps):
            yield from self.step(index)
        yield from self.upright()
        caption = ending_caption(plan.furniture, steps, plan.success, plan.upright)
        ending = self._still(plan.final_moment, Phase.FINALE, caption)
        yield from itertools.repeat(ending, self._count(FINALE_SECONDS))

    def _still(self, moment: Moment, phase: Phase, caption: str) -> Frame:
        roles = self._roles([Role.IDLE] * len(self.plan.furniture.parts))
        return Frame(tuple(self._poses(moment)), roles, None, phase, caption)

    def _count(self, seconds: float) -> int:
        return max(1, round(seconds * self.fps))

    def step(self, index: int) -> Iterator[Frame]:
        """Those of one step."""
        furniture, step = self.plan.furniture, self.plan.steps[index]
        own = [next(g.parts for g in step.legs[0].moment.groups() if part in g.parts) for part in step.action[:2]]
        what = onto(furniture, step.action, *map(len, own))
        of = expected_steps(furniture, len(self.plan.steps))
        parts = [Role.IDLE] * len(furniture.parts)
        for group, role in zip(own, (Role.MOVING, Role.WAITING), strict=True):
            for p in group:
                parts[p] = role
        yield from self._played(step.legs, parts, index, f"step {index + 1} of {of}: {what}")

    def upright(self) -> Iterator[Frame]:
        """Those of the motion that sets the finished piece on its feet; none if there is none."""
        furniture, legs = self.plan.furniture, self.plan.final_legs
        yield from self._played(legs, [Role.MOVING] * len(furniture.parts), None, f"{furniture.name}: set upright")

    def _played(self, legs: Sequence[Leg], parts: list[Role], index: int | None, text: str) -> Iterator[Frame]:
        """Frames of legs, each with its share of the time."""
        weights = np.array([max(_SHORTEST, _length(leg)) ** 0.5 for leg in legs])
        roles = self._roles(parts)
        for leg, seconds in zip(legs, self.seconds * weights / weights.sum(), strict=True):
            caption = f"{text} | R_{'ab'[leg.robot]}: {leg.name}"
            count = self._count(seconds)
            poses = self._poses(leg.moment)
            for k in range(1, count + 1):
                share = k / count
                self._move(poses, leg, _along(leg, share * share * (3.0 - 2.0 * share)))
                key = k == count and leg.name == "mate"
                yield Frame(tuple(poses), roles, index, Phase.MOVING, caption, key)

    def _roles(self, parts: list[Role]) -> tuple[Role, ...]:
        links = _links()
        return (*parts, *[Role.ROBOT_A] * links, *[Role.ROBOT_B] * links, *[Role.POST] * len(self.stands))

    def _poses(self, moment: Moment) -> list[SE3 | None]:
        """Of all things."""
        where = {p: pose for g in moment.groups() for p, pose in zip(g.parts, g.part_poses(), strict=True)}
        robots = [pose for r in moment.robots for _, pose in placed(r.at, r.opening)]
        up = {id(stand) for stand in moment.stands}
        posts = [SE3(np.eye(3), s.top) if id(s) in up else None for s in self.stands]
        return [*(where[p] for p in range(len(where))), *robots, *posts]

    def _move(self, poses: list[SE3 | None], leg: Leg, at: np.ndarray) -> None:
        """Only what moves in a leg gets new poses, in place."""
        robot = leg.moment.robots[leg.robot]
        first = len(self.plan.furniture.parts) + leg.robot * _links()
        poses[first : first + _links()] = [pose for _, pose in placed(at, robot.opening)]
        if robot.grip is not None:
            group = robot.grip.placed(at)
            for part, pose in zip(group.parts, group.part_poses(), strict=True):
                poses[part] = pose


def _links() -> int:
    """Of each robot."""
    return len(links()) + len(hand_links(0.0))


def _length(leg: Leg) -> float:
    return sum(_apart(a, b) for a, b in itertools.pairwise(leg.path))


def _apart(a: np.ndarray, b: np.ndarray) -> float:
    turned = np.abs(b - a)[2:].max(initial=0.0)
    return float(np.linalg.norm((b - a)[:2]) + _METRES_A_RADIAN * turned)


def _along(leg: Leg, share: float) -> np.ndarray:
    """The configuration a share of the way along a leg."""
    reached = np.concatenate([[0.0], np.cumsum([_apart(a, b) for a, b in itertools.pairwise(leg.path)])])
    if reached[-1] == 0.0:
        return leg.path[-1]
    at = share * reached[-1]
    k = min(int(np.searchsorted(reached, at, side="right")) - 1, len(leg.path) - 2)
    inner = (at - reached[k]) / max(reached[k + 1] - reached[k], 1e-12)
    return leg.path[k] + inner * (leg.path[k + 1] - leg.path[k])
