"""`dynamic` execution: the segments of a planned step carried out in physics, and the result compared with the plan.

The motion that sets the finished piece on its feet is carried out in the same way; the piece then stands on the floor
by its own weight.

Each step begins where the plan has everything. The states that the robots really pass through are tested exactly,
against everything around; only the two groups may touch each other while they are mated.
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
from roboassembly.geometry.poses import pose_difference
from roboassembly.simulation.execution import StepPhysics
from roboassembly.simulation.mobile_arms import Load, between_pads
from roboassembly.simulation.model import mass_properties
from roboassembly.task.full.cell_state import Payload, Segment
from roboassembly.task.full.failure import Stage
from roboassembly.task.full.grips import Grip
from roboassembly.task.full.timing import GRASP_SECONDS, RELEASE_SECONDS, rest_after, timed_motion
from roboassembly.task.plans.full_plan import FullPlan, FullStep
from roboassembly.task.rules.groups import Group, body

JOINT_POSITION, JOINT_ANGLE = 0.002, float(np.deg2rad(2.0))
"""Largest error of two groups at their joint when they are mated [m, rad]."""
STANDING_POSITION, STANDING_ANGLE = 0.01, float(np.deg2rad(2.0))
"""Largest error of the finished piece on the floor once the robot has left [m, rad]."""
MOST_TRACKING = 0.005
"""Largest distance of the finger tips from their path [m]."""
_TEST_INTERVAL = 10
"""Time steps between two states that are tested for collision."""


class ExecutionVerdict(StrEnum):
    """Verdict on an execution."""

    DONE = "done"
    NOT_GRASPED = "not_grasped"
    """A pad did not touch the part."""
    OFF_THE_PATH = "off_the_path"
    """The finger tips strayed from the planned path."""
    COLLISION = "collision"
    """A robot passed through a state that touches something."""
    NOT_MATED = "not_mated"
    """The groups were too far from where they mate."""
    NOT_STANDING = "not_standing"
    """The finished piece did not stay where it was set on its feet."""


@dataclass(frozen=True)
class StepExecution:
    """Result of carrying out one step."""

    ending: ExecutionVerdict
    segment: str
    """Name of the segment that failed; empty if none did."""
    seconds: float
    """Simulated time [s]."""
    tracking: float
    """Largest distance of the finger tips from their path [m]."""
    pad_force: float
    """Largest force on a pad [N]."""
    joint_position: float
    """Error of the joint's position when it was made [m]."""
    joint_angle: float
    """Error of the joint's angle when it was made [rad]."""
    states: int
    """Number of states tested exactly."""

    @property
    def success(self) -> bool:
        """Whether all segments were carried out."""
        return self.ending is ExecutionVerdict.DONE


@dataclass(frozen=True)
class PlanExecution:
    """Result of carrying out a plan, in the units of reports."""

    success: bool
    ending: str
    steps: int
    """Number of steps carried out."""
    simulated_seconds: float
    tracking_error_mm: float
    """Largest distance of the finger tips from their path."""
    pad_force_newton: float
    """Largest force on a pad."""
    joint_error_mm: float
    """Largest error of two groups when they were mated."""
    joint_error_deg: float
    reason: str
    """Why it failed; empty if it succeeded."""
    upright: bool | None = None
    """Whether the finished piece was set on its feet, which does not count for `success`; None if that was not carried
    out."""
    upright_reason: str = ""
    """Why the piece was not set on its feet; empty if it was."""


def summarize_execution(
    plan: FullPlan, done: Sequence[StepExecution], last: StepExecution | None = None
) -> PlanExecution:
    """Return the result of a plan from the results of its steps.

    Args:
        plan: plan that was carried out.
        done: results of its merges.
        last: result of the motion that sets the piece on its feet; None if it was not carried out.
    """
    failed = next((d for d in done if not d.success), None)
    return PlanExecution(
        success=plan.success and failed is None,
        ending=(failed.ending if failed is not None else ExecutionVerdict.DONE).value,
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


def execute_plan(plan: FullPlan) -> list[StepExecution]:
    """Carry out a plan up to the first step that fails."""
    results: list[StepExecution] = []
    for step in plan.steps:
        results.append(execute(plan.furniture, plan.initial.cell.density, step))
        if not results[-1].success:
            break
    return results


def execute(furniture: Furniture, density: float, step: FullStep) -> StepExecution:
    """Carry out the segments of one merge.

    Args:
        furniture: furniture that is assembled.
        density: density of the parts [kg/m³].
        step: planned step.
    """
    return _StepExecutor(furniture, density, step.segments).run()


def execute_upright(plan: FullPlan) -> StepExecution | None:
    """Carry out the motion that sets the finished piece on its feet; return None if the plan has none."""
    if not plan.final_segments:
        return None
    return _StepExecutor(plan.furniture, plan.initial.cell.density, plan.final_segments).run()


class _StepExecutor:
    def __init__(self, furniture: Furniture, density: float, segments: Sequence[Segment]) -> None:
        self.furniture, self.density, self.segments = furniture, density, segments
        start = segments[0].before
        # u's group before v's, so that a merge's loads have the numbers of the robots that take them.
        lifts = sorted((s for s in segments if s.stage is Stage.LIFT), key=lambda segment: segment.robot)
        self.payloads = [_payload(segment) for segment in lifts]
        self.load_of = {segment.robot: load for load, segment in enumerate(lifts)}
        """Number of the load that each robot picks."""
        openings = [robot.opening for robot in start.robots]
        for segment in segments:
            if segment.stage is Stage.DRIVE_TO_GROUP:
                openings[segment.robot] = segment.before.robots[segment.robot].opening
        loads = [self._load(payload.group, payload.grip) for payload in self.payloads]
        if segments[-1].after.on_floor:
            loads = [
                replace(load, feet=_feet(furniture, g.group)) for load, g in zip(loads, self.payloads, strict=True)
            ]
        self.physics = StepPhysics([r.at for r in start.robots], openings, loads)
        self.states = 0
        self.joint = (0.0, 0.0)

    def _load(self, group: Group, grip: Grip) -> Load:
        mass, center, inertia = mass_properties(body(self.furniture, group, "load"))
        share = self.density / WOOD_DENSITY
        own = group.furniture_from_part[group.parts.index(grip.part)]
        clip = between_pads(self.furniture.parts[grip.part].mesh, own.actInv(grip.furniture_from_tips), grip.closed)
        return Load(group.world_from_furniture, share * mass, center, share * inertia, (clip.transformed(own),))

    def run(self) -> StepExecution:
        for segment in self.segments:
            ending = self._follow_segment(segment)
            if ending is not ExecutionVerdict.DONE:
                return self._result(ending, segment.name)
        return self._result(ExecutionVerdict.DONE, "")

    def _result(self, ending: ExecutionVerdict, segment: str) -> StepExecution:
        log = self.physics.log
        tracking = max(log.tracking, default=0.0)
        return StepExecution(ending, segment, self.physics.seconds, tracking, log.pad_force, *self.joint, self.states)

    def _follow_segment(self, segment: Segment) -> ExecutionVerdict:
        physics, first = self.physics, len(self.physics.log.tracking)
        payload = segment.before.robots[segment.robot].payload_shapes(self.furniture)
        motion = timed_motion(segment.stage, segment.path, payload, self.density)
        physics.follow(segment.robot, motion, rest_after(segment.stage))
        if max(physics.log.tracking[first:]) > MOST_TRACKING:
            return ExecutionVerdict.OFF_THE_PATH
        if self._touches(segment, np.array(physics.log.samples[first::_TEST_INTERVAL])):
            return ExecutionVerdict.COLLISION
        if segment.stage is Stage.APPROACH:
            grasped = physics.grasp(segment.robot, self.load_of[segment.robot], GRASP_SECONDS)
            return ExecutionVerdict.DONE if grasped else ExecutionVerdict.NOT_GRASPED
        if segment.stage is Stage.MATE:
            self.joint = self._joint_error(segment)
            if self.joint[0] > JOINT_POSITION or self.joint[1] > JOINT_ANGLE:
                return ExecutionVerdict.NOT_MATED
            physics.join()
            physics.release(0, self._next(segment).before.robots[0].opening, RELEASE_SECONDS)
        if segment.stage is Stage.SET_DOWN:
            after = self._next(segment).before
            # A group on the floor stands by itself; a raised post holds what is set on it.
            on_posts = () if after.on_floor else tuple(range(len(self.payloads)))
            physics.release(segment.robot, after.robots[segment.robot].opening, RELEASE_SECONDS, on_posts)
        if segment.stage is Stage.LEAVE and segment.before.on_floor and not self._stands(segment.before.on_floor[0]):
            return ExecutionVerdict.NOT_STANDING
        return ExecutionVerdict.DONE

    def _next(self, segment: Segment) -> Segment:
        return self.segments[self.segments.index(segment) + 1]

    def _touches(self, segment: Segment, q: Float[np.ndarray, "n 10"]) -> bool:
        """Whether any state that a robot passed through touches anything that it must not touch."""
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
        pose, goal, center = self.physics.pose(0), planned.world_from_furniture, self.physics.loads[0].center
        off, turned = pose_difference(pose, goal, center)
        return off <= STANDING_POSITION and turned <= STANDING_ANGLE

    def _joint_error(self, mate: Segment) -> tuple[float, float]:
        """Return the error of u's group at the joint, at its centre of mass [m, rad]."""
        u, v = (payload.placed(robot.at) for payload, robot in zip(self.payloads, mate.after.robots, strict=True))
        planned = v.world_from_furniture.actInv(u.world_from_furniture)
        reached = self.physics.pose(1).actInv(self.physics.pose(0))
        return pose_difference(reached, planned, self.physics.loads[0].center)


def _feet(furniture: Furniture, group: Group) -> tuple[Mesh, ...]:
    """Return the meshes of a group's parts in the group's frame."""
    parts = zip(group.parts, group.furniture_from_part, strict=True)
    return tuple(furniture.parts[p].mesh.transformed(pose) for p, pose in parts)


def _payload(segment: Segment) -> Payload:
    """Return the payload of the robot that moves in a segment."""
    payload = segment.before.robots[segment.robot].payload
    assert payload is not None
    return payload
