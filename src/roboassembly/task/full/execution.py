"""`dynamic` execution: the segments of a planned step carried out in physics, and what comes out held against the plan.

The motion that sets the finished piece on its feet is carried out in the same way; the piece then stands on the floor
by its own weight.

Each step begins where the plan has everything. The states that the robots really come through are checked exactly,
against all that is around; only the two groups may touch each other while they are mated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import WOOD_DENSITY, Mesh
from roboassembly.geometry.poses import rotation_angle
from roboassembly.simulation.execution import StepPhysics
from roboassembly.simulation.mobile_arms import Load, between_pads
from roboassembly.simulation.model import mass_properties
from roboassembly.task.full.cell_state import Payload, Segment
from roboassembly.task.full.failure import STRAIGHT, Stage
from roboassembly.task.full.grips import Grip
from roboassembly.task.plans.full_plan import FullPlan, FullStep
from roboassembly.task.rules.groups import Group, body

JOINT_POSITION, JOINT_ANGLE = 0.002, float(np.deg2rad(2.0))
"""Metres and radians within which two groups must come before they are joined."""
STANDING_POSITION, STANDING_ANGLE = 0.01, float(np.deg2rad(2.0))
"""Metres and radians that the finished piece may be off where it is to stand, once the robot has left."""
MOST_TRACKING = 0.005
"""Metres that finger tips may be off their path."""
_SLOWLY, _LOADED = 0.3, 0.7
"""Shares of the speed at which robots go elsewhere: on those segments, and with a group in the hand."""
_AUDITED = 10
"""Every so many-th time step is checked."""


class Ending(StrEnum):
    """How an execution ended."""

    DONE = "done"
    NOT_GRASPED = "not_grasped"
    """A pad did not touch the part."""
    OFF_THE_PATH = "off_the_path"
    """The finger tips strayed from the planned path."""
    COLLISION = "collision"
    """A state that a robot came through touches something."""
    NOT_MATED = "not_mated"
    """The groups were too far from where they join."""
    NOT_STANDING = "not_standing"
    """The finished piece did not stay where it was set on its feet."""


@dataclass(frozen=True)
class Executed:
    """What became of one step."""

    ending: Ending
    segment: str
    """In which it failed; empty if it did not."""
    seconds: float
    """Simulated."""
    tracking: float
    """Metres, the farthest that finger tips were off their path."""
    pad_force: float
    """Newtons, the largest on a pad."""
    joint_position: float
    """Metres that the joint was off when it was made."""
    joint_angle: float
    """Radians."""
    states: int
    """Checked exactly."""

    @property
    def success(self) -> bool:
        """Whether all segments were carried out."""
        return self.ending is Ending.DONE


@dataclass(frozen=True)
class Execution:
    """What became of a plan, in the units of reports."""

    success: bool
    ending: str
    steps: int
    """Carried out."""
    simulated_seconds: float
    tracking_error_mm: float
    """The farthest that finger tips were off their path."""
    pad_force_newton: float
    """The largest on a pad."""
    joint_error_mm: float
    """The farthest that two groups were off when they were joined."""
    joint_error_deg: float
    reason: str
    """Empty if it succeeded."""
    upright: bool | None = None
    """Whether the finished piece was set on its feet, which is no part of the success; None if that was not carried
    out."""
    upright_reason: str = ""
    """Why it was not; empty if it was."""


def in_all(plan: FullPlan, done: Sequence[Executed], last: Executed | None = None) -> Execution:
    """What the executed steps of a plan come to.

    Args:
        plan: that was carried out.
        done: its merges.
        last: the motion that sets the piece on its feet; None if it was not carried out.
    """
    failed = next((d for d in done if not d.success), None)
    return Execution(
        success=plan.success and failed is None,
        ending=(failed.ending if failed is not None else Ending.DONE).value,
        steps=sum(d.success for d in done),
        simulated_seconds=round(sum(d.seconds for d in done), 1),
        tracking_error_mm=round(1e3 * max((d.tracking for d in done), default=0.0), 2),
        pad_force_newton=round(max((d.pad_force for d in done), default=0.0), 1),
        joint_error_mm=round(1e3 * max((d.joint_position for d in done), default=0.0), 2),
        joint_error_deg=round(math.degrees(max((d.joint_angle for d in done), default=0.0)), 3),
        reason="" if failed is None else f"merge {len(done)}: {failed.ending.value} in '{failed.segment}'",
        upright=None if last is None else last.success,
        upright_reason="" if last is None or last.success else f"{last.ending.value} in '{last.segment}'",
    )


def execute_plan(plan: FullPlan) -> list[Executed]:
    """Carry out a plan, up to the first step that fails."""
    out: list[Executed] = []
    for step in plan.steps:
        out.append(execute(plan.furniture, plan.initial.cell.density, step))
        if not out[-1].success:
            break
    return out


def execute(furniture: Furniture, density: float, step: FullStep) -> Executed:
    """Carry out the segments of one merge.

    Args:
        furniture: what is assembled.
        density: kg/m³.
        step: planned.
    """
    return _Execution(furniture, density, step.segments).run()


def execute_upright(plan: FullPlan) -> Executed | None:
    """Carry out the motion that sets the finished piece on its feet; None if the plan has none."""
    return (
        _Execution(plan.furniture, plan.initial.cell.density, plan.final_segments).run()
        if plan.final_segments
        else None
    )


class _Execution:
    def __init__(self, furniture: Furniture, density: float, segments: Sequence[Segment]) -> None:
        self.furniture, self.segments = furniture, segments
        start = segments[0].before
        # u's group before v's, so that a merge's loads have the numbers of the robots that take them.
        lifts = sorted((s for s in segments if s.stage is Stage.LIFT), key=lambda segment: segment.robot)
        self.grips = [_grip(segment) for segment in lifts]
        self.load_of = {segment.robot: load for load, segment in enumerate(lifts)}
        """Robot to the number of the load that it takes."""
        openings = [robot.opening for robot in start.robots]
        for segment in segments:
            if segment.stage is Stage.DRIVE_TO_GROUP:
                openings[segment.robot] = segment.before.robots[segment.robot].opening
        loads = [self._load(grip.group, grip.grip, density) for grip in self.grips]
        if segments[-1].after.on_floor:
            loads = [replace(load, feet=_feet(furniture, g.group)) for load, g in zip(loads, self.grips, strict=True)]
        self.physics = StepPhysics([r.at for r in start.robots], openings, loads)
        self.states = 0
        self.joint = (0.0, 0.0)

    def _load(self, group: Group, grip: Grip, density: float) -> Load:
        mass, center, inertia = mass_properties(body(self.furniture, group, "load"))
        share = density / WOOD_DENSITY
        own = group.furniture_from_part[group.parts.index(grip.part)]
        clip = between_pads(self.furniture.parts[grip.part].mesh, own.actInv(grip.furniture_from_tips), grip.closed)
        return Load(group.world_from_furniture, share * mass, center, share * inertia, (clip.transformed(own),))

    def run(self) -> Executed:
        for segment in self.segments:
            ending = self._leg(segment)
            if ending is not Ending.DONE:
                return self._told(ending, segment.name)
        return self._told(Ending.DONE, "")

    def _told(self, ending: Ending, segment: str) -> Executed:
        log = self.physics.log
        tracking = max(log.tracking, default=0.0)
        return Executed(ending, segment, self.physics.seconds, tracking, log.pad_force, *self.joint, self.states)

    def _leg(self, segment: Segment) -> Ending:
        physics, first = self.physics, len(self.physics.log.tracking)
        speed = 1.0 if segment.before.robots[segment.robot].payload is None else _LOADED
        physics.follow(segment.robot, segment.path, _SLOWLY if segment.stage in STRAIGHT else speed)
        if max(physics.log.tracking[first:]) > MOST_TRACKING:
            return Ending.OFF_THE_PATH
        if self._touches(segment, np.array(physics.log.samples[first::_AUDITED])):
            return Ending.COLLISION
        if segment.stage is Stage.APPROACH:
            return Ending.DONE if physics.grasp(segment.robot, self.load_of[segment.robot]) else Ending.NOT_GRASPED
        if segment.stage is Stage.MATE:
            self.joint = self._joint_error(segment)
            if self.joint[0] > JOINT_POSITION or self.joint[1] > JOINT_ANGLE:
                return Ending.NOT_MATED
            physics.join()
            physics.release(0, self._next(segment).before.robots[0].opening)
        if segment.stage is Stage.SET_DOWN:
            after = self._next(segment).before
            # What is set on the floor stands there by itself; a post that has risen holds what is set on it.
            held = () if after.on_floor else tuple(range(len(self.grips)))
            physics.release(segment.robot, after.robots[segment.robot].opening, held)
        if segment.stage is Stage.LEAVE and segment.before.on_floor and not self._stands(segment.before.on_floor[0]):
            return Ending.NOT_STANDING
        return Ending.DONE

    def _next(self, segment: Segment) -> Segment:
        return self.segments[self.segments.index(segment) + 1]

    def _touches(self, segment: Segment, q: Float[np.ndarray, "n 10"]) -> bool:
        """Whether any state that a robot came through touches anything but what it is meant to."""
        state = segment.before
        if segment.stage is Stage.MATE:
            state = state.with_robot(1, replace(state.robots[1], payload=None))
        if segment.stage in (Stage.LIFT, Stage.SET_DOWN):
            # The post on which it sits, or is to sit.
            state = replace(state, free_posts=())
        lands = segment.stage is Stage.SET_DOWN and bool(self._next(segment).before.on_floor)
        self.states += len(q)
        return not state.world(self.furniture, segment.robot, lands).free(q).all()

    def _stands(self, planned: Group) -> bool:
        """Whether the finished piece is where it was set down."""
        got, wanted, center = self.physics.pose(0), planned.world_from_furniture, self.physics.loads[0].center
        off = float(np.linalg.norm(got.act(center) - wanted.act(center)))
        return off <= STANDING_POSITION and rotation_angle(got.rotation.T @ wanted.rotation) <= STANDING_ANGLE

    def _joint_error(self, mate: Segment) -> tuple[float, float]:
        """How far u's group is from where it joins v's, at u's centre of mass: metres and radians."""
        u, v = (grip.placed(robot.at) for grip, robot in zip(self.grips, mate.after.robots, strict=True))
        wanted = v.world_from_furniture.actInv(u.world_from_furniture)
        got = self.physics.pose(1).actInv(self.physics.pose(0))
        center = self.physics.loads[0].center
        return (
            float(np.linalg.norm(got.act(center) - wanted.act(center))),
            rotation_angle(got.rotation.T @ wanted.rotation),
        )


def _feet(furniture: Furniture, group: Group) -> tuple[Mesh, ...]:
    """A group's parts, in its frame."""
    parts = zip(group.parts, group.furniture_from_part, strict=True)
    return tuple(furniture.parts[p].mesh.transformed(pose) for p, pose in parts)


def _grip(segment: Segment) -> Payload:
    """What the hand holds on a segment."""
    grip = segment.before.robots[segment.robot].payload
    assert grip is not None
    return grip
