"""Audit of full plans by other means than those that made them: python-fcl, and Pinocchio's model of the URDF.

Everything comes from the record of the segments. Pinocchio places the arms from the URDF, which planning does not use,
and every state is tested, where planning certifies whole stretches.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from roboassembly.audit.arrangement import misplaced, stands
from roboassembly.audit.object_centric import fcl_model, fcl_module
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3
from roboassembly.planning.robot_path import Configuration
from roboassembly.robots.body import links
from roboassembly.robots.gripper import TIPS, hand_bodies, panda_folder
from roboassembly.robots.kinematics import JOINTS
from roboassembly.robots.platform import PLATFORM_FROM_MOUNT
from roboassembly.task.full.cell_state import CellState, Robot, Segment
from roboassembly.task.plans.full_plan import FullPlan

RESOLUTION = 0.02
"""Distance that a point of the robot travels between two states, about [m]."""
_REACH = np.array([1.0, 1.0, 1.6, 1.2, 1.2, 0.9, 0.9, 0.6, 0.5, 0.4])
"""Distance that a point moves for a unit of each of the ten numbers of a configuration, about [m]."""
_SAME = 1e-6
"""Difference of two records of one pose or configuration at most."""
_LISTED = 20
_HAND = ("palm", "left finger", "right finger")
_PADS = _HAND[1:]
_ENDS = ("link7", *_HAND)
"""Links that do not move against the payload."""


class RobotViolationKind(StrEnum):
    """Kinds of violations in a full plan."""

    PENETRATION = "penetration"
    """The robot or its payload is in something else."""
    OWN_PENETRATION = "own_penetration"
    """Two links are in each other, or the payload is in a link."""
    GROUND = "ground"
    JOINT_LIMIT = "joint_limit"
    JUMP = "jump"
    """Something is not where the segment before left it."""
    NOT_ASSEMBLED = "not_assembled"
    """The parts at the end are not the furniture."""
    NOT_UPRIGHT = "not_upright"
    """The plan says that the piece ends on its feet on the floor, and it does not."""


@dataclass(frozen=True)
class RobotViolation:
    """One violation in a full plan."""

    kind: RobotViolationKind
    step: int
    segment: str
    what: str


@dataclass(frozen=True)
class RobotAuditReport:
    """Result of the audit of a full plan."""

    segments: int
    states: int
    counts: dict[RobotViolationKind, int]
    """Number of violations of each kind; a penetration counts once a state."""
    first: tuple[RobotViolation, ...]

    @property
    def passed(self) -> bool:
        """Whether nothing is wrong."""
        return not self.counts

    def summary(self) -> str:
        """Return the result in one line."""
        audited = f"{self.segments} segments and {self.states} states audited"
        if self.passed:
            return f"{audited}: nothing wrong"
        found = ", ".join(f"{count} {kind.value}" for kind, count in self.counts.items())
        v = self.first[0]
        return f"{audited}: {found}; first in step {v.step}, {v.segment}: {v.what}"


def audit_full_plan(plan: FullPlan, resolution: float = RESOLUTION) -> RobotAuditReport:
    """Replay the plan and look for anything that could not happen.

    Tested at the beginning and whenever something was set down: each group and post against all others. In every
    segment: the moving robot and its payload against all groups, posts, the other robot and its payload, the ground and
    itself; joint limits; and that everything is where the segment before left it. At the end: that the parts are the
    furniture, and that it stands on its feet on the floor if the plan says so. The segments that set it there count as
    one more step. Pads may touch the part that they hold, and a group may touch its post.

    Args:
        plan: recorded plan.
        resolution: distance that a point travels between two states, about [m].

    Raises:
        MissingExtraError: python-fcl is not installed.
    """
    return _RobotAudit(plan, resolution).report()


class _RobotAudit:
    def __init__(self, plan: FullPlan, resolution: float) -> None:
        self._fcl = fcl_module()
        self._plan, self._resolution = plan, resolution
        self._models: dict[Mesh, Any] = {}
        self._states = self._segments = 0
        self._counts: Counter[RobotViolationKind] = Counter()
        self._first: list[RobotViolation] = []

    def report(self) -> RobotAuditReport:
        plan, furniture, before = self._plan, self._plan.furniture, self._plan.initial.cell_state
        self._keep_apart(0, "", before)
        for index, segments in enumerate([*(step.segments for step in plan.steps), plan.final_segments]):
            for segment in segments:
                self._segments += 1
                self._continues(index, segment, before)
                if _still_things(segment.before) != _still_things(before):
                    self._keep_apart(index, segment.name, segment.before)
                self._walk(index, segment)
                before = segment.after
        poses = _part_poses(furniture, before)
        if plan.success and (astray := misplaced(furniture, poses)):
            self._found(RobotViolationKind.NOT_ASSEMBLED, len(plan.steps) - 1, "", f"parts {list(astray)}")
        if plan.upright is not None and plan.upright.success:
            by_itself = not before.placed and all(robot.payload is None for robot in before.robots)
            if not by_itself or not stands(furniture, poses):
                self._found(RobotViolationKind.NOT_UPRIGHT, len(plan.steps), "", "the piece at the end")
        return RobotAuditReport(self._segments, self._states, dict(self._counts), tuple(self._first))

    def _found(self, kind: RobotViolationKind, step: int, segment: str, what: str) -> None:
        self._counts[kind] += 1
        if len(self._first) < _LISTED:
            self._first.append(RobotViolation(kind, step, segment, what))

    def _continues(self, step: int, segment: Segment, before: CellState) -> None:
        for name, old, new in zip("ab", before.robots, segment.before.robots, strict=True):
            if np.abs(old.at - new.at).max() > _SAME:
                self._found(RobotViolationKind.JUMP, step, segment.name, f"R_{name}")
        if np.abs(segment.path[0] - segment.before.robots[segment.robot].at).max() > _SAME:
            self._found(RobotViolationKind.JUMP, step, segment.name, "the path's beginning")
        was, now = (_part_poses(self._plan.furniture, m) for m in (before, segment.before))
        for part, (old, new) in enumerate(zip(was, now, strict=True)):
            if np.abs(old.homogeneous - new.homogeneous).max() > _SAME:
                self._found(RobotViolationKind.JUMP, step, segment.name, f"part {part}")

    def _keep_apart(self, step: int, segment: str, state: CellState) -> None:
        """Find groups and posts that are in each other, except a group and its own post."""
        furniture = self._plan.furniture
        things: list[tuple[int, str, Any]] = []
        groups = [*enumerate(s.group for s in state.placed), *((-1 - i, g) for i, g in enumerate(state.on_floor))]
        for owner, group in groups:
            for p, pose in zip(group.parts, group.part_poses(), strict=True):
                things.append((owner, f"part {p}", self._placed(furniture.parts[p].mesh, pose)))
        for owner, post in enumerate(state.supports):
            body = post.body(f"post {owner}")
            things += [(owner, body.name, self._placed(s.mesh, body.pose * s.body_from_mesh)) for s in body.shapes]
        for (owner, name, thing), (other, what, still) in combinations(things, 2):
            if owner != other and self._touch(thing, still):
                self._found(RobotViolationKind.PENETRATION, step, segment, f"{name} in {what}, both standing")

    def _walk(self, step: int, segment: Segment) -> None:
        own, other = segment.before.robots[segment.robot], segment.before.robots[1 - segment.robot]
        still = self._surroundings(segment.before, other)
        manager = self._fcl.DynamicAABBTreeCollisionManager()
        manager.registerObjects([thing for _, thing in still])
        manager.setup()
        robot = _robot_meshes()
        load = {f"held {i}": shape for i, shape in enumerate(_load(self._plan.furniture, own))}
        shapes = robot | {name: mesh for name, (mesh, _) in load.items()}
        moving = {name: self._placed(mesh, SE3.Identity()) for name, mesh in shapes.items()}
        constant = {*_ENDS, *load}
        pairs = [*_own_pairs(), *((link, name) for link in robot if link not in _PADS for name in load)]
        low, high = _limits()
        for state, q in enumerate(_dense(segment.path, self._resolution)):
            self._states += 1
            if (q[3:] < low).any() or (q[3:] > high).any():
                self._found(RobotViolationKind.JOINT_LIMIT, step, segment.name, f"state {state}")
            where = _robot_poses(q, own.opening)
            where |= {name: where[TIPS] * pose for name, (_, pose) in load.items()}
            for name, thing in moving.items():
                at = where[name]
                thing.setTransform(self._fcl.Transform(at.rotation, at.translation))
                if (shapes[name].hull_vertices @ at.rotation[2]).min() + at.translation[2] <= 0.0:
                    self._found(RobotViolationKind.GROUND, step, segment.name, f"{name}, state {state}")
                if self._meets(manager, thing):
                    others = [n for n, s in still if self._touch(thing, s)]
                    what = f"{name} in {', '.join(others)}, state {state}"
                    self._found(RobotViolationKind.PENETRATION, step, segment.name, what)
            for a, b in pairs:
                if (state == 0 or not {a, b} <= constant) and self._touch(moving[a], moving[b]):
                    self._found(RobotViolationKind.OWN_PENETRATION, step, segment.name, f"{a} in {b}, state {state}")

    def _surroundings(self, state: CellState, other: Robot) -> list[tuple[str, Any]]:
        """Return everything that stands still, with names."""
        furniture = self._plan.furniture
        out = [
            (f"part {p}", self._placed(furniture.parts[p].mesh, pose))
            for group in (*(s.group for s in state.placed), *state.on_floor)
            for p, pose in zip(group.parts, group.part_poses(), strict=True)
        ]
        for i, post in enumerate(state.supports):
            body = post.body(f"post {i}")
            out += [(body.name, self._placed(s.mesh, body.pose * s.body_from_mesh)) for s in body.shapes]
        where = _robot_poses(other.at, other.opening)
        out += [(f"the other's {name}", self._placed(mesh, where[name])) for name, mesh in _robot_meshes().items()]
        load = _load(furniture, other)
        return out + [("what the other holds", self._placed(mesh, where[TIPS] * pose)) for mesh, pose in load]

    def _placed(self, mesh: Mesh, pose: SE3) -> Any:
        if mesh not in self._models:
            self._models[mesh] = fcl_model(self._fcl, mesh)
        return self._fcl.CollisionObject(self._models[mesh], self._fcl.Transform(pose.rotation, pose.translation))

    def _meets(self, manager: Any, thing: Any) -> bool:
        data = self._fcl.CollisionData()
        manager.collide(thing, data, self._fcl.defaultCollisionCallback)
        return bool(data.result.is_collision)

    def _touch(self, a: Any, b: Any) -> bool:
        return bool(self._fcl.collide(a, b, self._fcl.CollisionRequest(), self._fcl.CollisionResult()))


def _still_things(state: CellState) -> tuple[Any, ...]:
    """Return everything that stands except the robots."""
    return state.placed, state.free_posts, state.on_floor


def _load(furniture: Furniture, robot: Robot) -> list[tuple[Mesh, SE3]]:
    """Return the meshes in a hand, with `tips_from_part`."""
    return [(s.mesh, s.body_from_mesh) for s in robot.payload_shapes(furniture)]


def _part_poses(furniture: Furniture, state: CellState) -> list[SE3]:
    """Return the pose of every part."""
    where = {p: pose for g in state.groups() for p, pose in zip(g.parts, g.part_poses(), strict=True)}
    return [where[p] for p in range(len(furniture.parts))]


def _dense(path: Sequence[Configuration], resolution: float) -> Iterator[Configuration]:
    """Yield every state, way-points included."""
    yield path[0]
    for a, b in pairwise(path):
        count = max(1, int(np.ceil(np.abs(b - a) @ _REACH / resolution)))
        for k in range(1, count + 1):
            yield a + (b - a) * (k / count)


@cache
def _urdf() -> pin.Model:
    return pin.buildModelFromUrdf(str(panda_folder() / "urdf/panda.urdf"))


@cache
def _limits() -> tuple[Float[np.ndarray, "7"], Float[np.ndarray, "7"]]:
    model = _urdf()
    return np.array(model.lowerPositionLimit[:JOINTS]) - _SAME, np.array(model.upperPositionLimit[:JOINTS]) + _SAME


@cache
def _robot_meshes() -> dict[str, Mesh]:
    """Return the meshes of platform, links of the arm, palm and fingers."""
    return {link.name: link.mesh for link in links()} | dict(
        zip(_HAND, (mesh for mesh, _ in hand_bodies(0.0)), strict=True)
    )


def _robot_poses(q: Configuration, opening: float) -> dict[str, SE3]:
    """Return the world poses of all links and of the finger tips."""
    model = _urdf()
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array([*q[3:], 0.5 * opening, 0.5 * opening]))
    platform = SE3(pin.rpy.rpyToMatrix(0.0, 0.0, float(q[2])), np.array([q[0], q[1], 0.0]))
    mount = platform * PLATFORM_FROM_MOUNT
    tips = mount * data.oMf[model.getFrameId(TIPS)]
    out = {link.name: mount * data.oMi[link.carrier] if link.carrier else platform for link in links()}
    out |= {name: tips * pose for name, (_, pose) in zip(_HAND, hand_bodies(opening), strict=True)}
    return {**out, TIPS: tips}


@cache
def _own_pairs() -> tuple[tuple[str, str], ...]:
    """Return pairs of links that may not touch: two joints or more between them, no contact with the arm straight."""
    fcl, meshes, where = fcl_module(), _robot_meshes(), _robot_poses(np.zeros(10), 0.0)
    carrier = {link.name: link.carrier for link in links()} | dict.fromkeys(_HAND, JOINTS)

    def separate(a: str, b: str) -> bool:
        first, other = (
            fcl.CollisionObject(fcl_model(fcl, meshes[n]), fcl.Transform(where[n].rotation, where[n].translation))
            for n in (a, b)
        )
        return not fcl.collide(first, other, fcl.CollisionRequest(), fcl.CollisionResult())

    return tuple((a, b) for a, b in combinations(meshes, 2) if carrier[b] - carrier[a] > 1 and separate(a, b))
