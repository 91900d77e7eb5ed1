"""Audit of object-centric plans by other means than those that made them: python-fcl, SciPy, and the record alone.

Everything comes from the `Plan`: meshes, and the poses in its steps. SciPy's Slerp interpolates edges, FCL tests exact
triangles for collision, and vertices give the lowest points. The audit uses no code of the planner, so that a mistake
there cannot hide itself.
"""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation, Slerp

from roboassembly.audit.arrangement import SAME_ANGLE, SAME_POSITION, angle_of, misplaced, stands
from roboassembly.errors import MissingExtraError
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3
from roboassembly.task.plans.plan import Plan, PlanStep, UprightMotion, UprightResult

_ORTHONORMAL = 1e-6
"""Largest entry of R Rᵀ - 1 that a rotation may have."""
_CONTACTS = 200
"""Number of pairs of triangles whose depth FCL reports."""
_LISTED = 20
"""Violations kept in the report; all are counted."""


class ViolationKind(StrEnum):
    """Kinds of violations in an object-centric plan."""

    PATH_PENETRATION = "path_penetration"
    """A moving part is in a still one."""
    PATH_GROUND = "path_ground"
    """A moving part is in the ground."""
    STILL_PENETRATION = "still_penetration"
    """Two still parts are in each other."""
    STILL_GROUND = "still_ground"
    REST_PENETRATION = "rest_penetration"
    """Two parts are in each other before the first step or after one."""
    REST_GROUND = "rest_ground"
    DISCONTINUITY = "discontinuity"
    """A part is not where it was left."""
    NOT_A_ROTATION = "not_a_rotation"
    """A pose has a matrix that is not orthonormal, which would stretch or shear the part."""
    NOT_RIGID = "not_rigid"
    """Parts of one group moved against each other."""
    MISSING_PART = "missing_part"
    """A step does not account for every part once, or has no path."""
    NOT_ASSEMBLED = "not_assembled"
    """The arrangement after the last step is not the furniture."""
    NOT_UPRIGHT = "not_upright"
    """The plan says that the piece ends on its feet, and it does not."""


@dataclass(frozen=True)
class Violation:
    """One violation in an object-centric plan."""

    kind: ViolationKind
    step: int
    """Index of the step; -1 before the first step; the number of steps for the motion that sets the piece upright."""
    state: int
    """Index of the state along the step's path; -1: not on a path."""
    parts: tuple[int, ...]
    depth: float
    """Metres: how deep (of penetrations the median over the pairs of triangles that cut each other, of the ground the
    lowest vertex), or how far off (of rotations an entry of their matrix, no metres); NaN where that means nothing."""


@dataclass(frozen=True)
class AuditReport:
    """Result of the audit of an object-centric plan."""

    steps: int
    states: int
    """Number of states of moving groups along their paths."""
    counts: dict[ViolationKind, int]
    """Number of violations of each kind; a penetration counts once a state."""
    first: tuple[Violation, ...]
    """First violations, at most `_LISTED`."""

    @property
    def passed(self) -> bool:
        """Whether nothing is wrong."""
        return not self.counts

    def summary(self) -> str:
        """Return the result in one line."""
        if self.passed:
            return f"{self.steps} steps and {self.states} states audited: nothing wrong"
        found = ", ".join(f"{count} {kind.value}" for kind, count in self.counts.items())
        v = self.first[0]
        return (
            f"{self.steps} steps and {self.states} states audited: {found}; first in step {v.step}, state {v.state}, "
            f"parts {list(v.parts)}, {1e3 * v.depth:.2f} mm"
        )


def audit_plan(
    plan: Plan, resolution: float = 0.002, angular_resolution: float = float(np.deg2rad(1.0))
) -> AuditReport:
    """Replay the plan and look for anything that could not happen.

    Tested along paths, at the given resolution: moving parts against still parts and the ground (z = 0). In each
    step: still parts against each other. Before the first step and after each: all parts against each other and the
    ground. Parts start where they were left, and groups stay rigid (v's group may be set down elsewhere, as a whole).
    After the last step: the arrangement is the furniture, up to swapped equivalent parts and symmetries of their shape.
    The motion that sets the piece upright is tested in the same way, and so is that the piece stands on its feet at the
    end (`stands`). Settling is not tested: it is physics of the merged group alone.

    Args:
        plan: recorded plan.
        resolution: distance that the fastest point of the moving group travels between two states at most [m].
        angular_resolution: angle that it turns between two states at most [rad].

    Raises:
        MissingExtraError: python-fcl is not installed.
    """
    return _Audit(plan, resolution, angular_resolution).report()


class _Audit:
    def __init__(self, plan: Plan, resolution: float, angular_resolution: float) -> None:
        self._fcl = fcl_module()
        self._plan = plan
        self._resolution, self._angular_resolution = resolution, angular_resolution
        self._count = len(plan.furniture.parts)
        # Fasteners are numbered after the parts.
        self._meshes = [piece.mesh for piece in (*plan.furniture.parts, *plan.furniture.fasteners)]
        self._models = {mesh: fcl_model(self._fcl, mesh) for mesh in self._meshes}
        self._states = 0
        self._counts: Counter[ViolationKind] = Counter()
        self._first: list[Violation] = []

    def report(self) -> AuditReport:
        before = self._plan.initial
        self._rotations(-1, before)
        self._insertions(-1, before)
        self._rest(-1, before)
        for index, step in enumerate(self._plan.steps):
            self._rotations(index, [*step.path, *step.moving.values(), *step.still.values(), *step.after])
            if self._whole(index, step):
                self._transition(index, step, before)
                self._still(index, step)
                moving, still = (self._fastened(poses, index - 1) for poses in (step.moving, step.still))
                self._path(index, step.path, moving, still)
                self._insertions(index, step.after)
            self._rest(index, step.after)
            before = step.after
        if self._plan.success and (astray := misplaced(self._plan.furniture, before)):
            self._found(ViolationKind.NOT_ASSEMBLED, len(self._plan.steps) - 1, -1, astray, float("nan"))
        if self._plan.upright is not None:
            self._upright(len(self._plan.steps), self._plan.upright, before)
        return AuditReport(len(self._plan.steps), self._states, dict(self._counts), tuple(self._first))

    def _upright(self, index: int, result: UprightResult[UprightMotion], before: Sequence[SE3]) -> None:
        after, motion = before, result.motion
        if motion is not None:
            after = motion.after
            self._rotations(index, [*motion.path, *motion.moving.values(), *after])
            complete = sorted(motion.moving) == list(range(len(before))) and len(after) == len(before)
            if not complete or not motion.path:
                self._found(ViolationKind.MISSING_PART, index, -1, (), float("nan"))
                return
            for part, pose in motion.moving.items():
                self._same(ViolationKind.DISCONTINUITY, index, part, motion.path[0] * pose, before[part])
            self._rigid(index, {p: motion.path[-1] * pose for p, pose in motion.moving.items()}, after)
            self._path(index, motion.path, self._fastened(motion.moving, index - 1), {})
            self._insertions(index, after)
            self._rest(index, after)
        if result.success and not stands(self._plan.furniture, after):
            self._found(ViolationKind.NOT_UPRIGHT, index, -1, (), float("nan"))

    def _fastened(self, poses: Mapping[int, SE3], until: int) -> dict[int, SE3]:
        """Return poses of parts together with those of the fasteners that went into them after steps up to `until`."""
        inside = (i for i in self._plan.insertions if i.after <= until and i.part in poses)
        return {**poses, **{self._count + i.fastener: poses[i.part] * i.part_from_fastener for i in inside}}

    def _insertions(self, index: int, poses: Sequence[SE3]) -> None:
        """Test the ways in of the fasteners that go in after a step, one after the other, with their groups raised."""
        inside = self._fastened(dict(enumerate(poses)), index - 1)
        for insertion in (i for i in self._plan.insertions if i.after == index):
            number = self._count + insertion.fastener
            self._rotations(index, [*insertion.path, insertion.part_from_fastener])
            lift = SE3(np.eye(3), np.array([0.0, 0.0, insertion.lift]))
            end = poses[insertion.part] * insertion.part_from_fastener
            self._same(ViolationKind.DISCONTINUITY, index, number, insertion.path[-1], lift * end)
            group = self._joined(insertion.part, index)
            still = {p: lift * pose if self._host(p) in group else pose for p, pose in inside.items()}
            self._path(index, insertion.path, {number: SE3.Identity()}, still)
            inside[number] = end
        listed = sorted([*(i.fastener for i in self._plan.insertions), *(k for k, _ in self._plan.not_inserted)])
        if index == -1 and listed and listed != list(range(len(self._meshes) - self._count)):
            self._found(ViolationKind.MISSING_PART, index, -1, (), float("nan"))

    def _host(self, number: int) -> int:
        """Return the part that a fastener is in; of a part the part itself."""
        index = number - self._count
        return number if index < 0 else next(i.part for i in self._plan.insertions if i.fastener == index)

    def _joined(self, part: int, index: int) -> set[int]:
        """Return the parts that are in one group with a part after a step."""
        group = {part}
        for step in self._plan.steps[: index + 1]:
            merged = {*step.moving, *step.waiting}
            group |= merged if merged & group else set()
        return group

    def _found(self, kind: ViolationKind, step: int, state: int, parts: Sequence[int], depth: float) -> None:
        self._counts[kind] += 1
        if len(self._first) < _LISTED:
            self._first.append(Violation(kind, step, state, tuple(parts), depth))

    def _placed(self, part: int, pose: SE3) -> Any:
        return self._fcl.CollisionObject(
            self._models[self._meshes[part]], self._fcl.Transform(pose.rotation, pose.translation)
        )

    def _depth(self, a: Any, b: Any) -> float | None:
        """Return the depth to which surfaces cut into each other [m]; None if they do not."""
        request = self._fcl.CollisionRequest(num_max_contacts=_CONTACTS, enable_contact=True)
        result = self._fcl.CollisionResult()
        if not self._fcl.collide(a, b, request, result):
            return None
        return float(np.median([abs(c.penetration_depth) for c in result.contacts]))

    def _whole(self, index: int, step: PlanStep) -> bool:
        count = self._count
        named = sorted([*step.moving, *step.still])
        complete = named == list(range(count)) and len(step.after) == count and len(step.path) > 0
        if not complete or not set(step.waiting) <= set(step.still):
            self._found(ViolationKind.MISSING_PART, index, -1, (), float("nan"))
            return False
        return True

    def _rotations(self, index: int, poses: Sequence[SE3]) -> None:
        matrices = np.array([pose.rotation for pose in poses]).reshape(-1, 3, 3)
        off = np.abs(matrices @ matrices.transpose(0, 2, 1) - np.eye(3)).max(initial=0.0)
        if off > _ORTHONORMAL or (np.linalg.det(matrices) < 0).any():
            self._found(ViolationKind.NOT_A_ROTATION, index, -1, (), float(off))

    def _transition(self, index: int, step: PlanStep, before: Sequence[SE3]) -> None:
        start = {p: step.path[0] * pose for p, pose in step.moving.items()}
        goal = {p: step.path[-1] * pose for p, pose in step.moving.items()}
        others = [p for p in step.still if p not in step.waiting]
        for part, pose in [*start.items(), *((p, step.still[p]) for p in others)]:
            self._same(ViolationKind.DISCONTINUITY, index, part, pose, before[part])
        for part in others:
            self._same(ViolationKind.DISCONTINUITY, index, part, step.after[part], step.still[part])
        waiting = {p: step.still[p] for p in step.waiting}
        self._rigid(index, waiting, before)
        self._rigid(index, {**waiting, **goal}, step.after)

    def _same(self, kind: ViolationKind, index: int, part: int, pose: SE3, expected: SE3) -> None:
        off = float(np.linalg.norm(pose.translation - expected.translation))
        if off > SAME_POSITION or angle_of(pose.rotation.T @ expected.rotation) > SAME_ANGLE:
            self._found(kind, index, -1, (part,), off)

    def _rigid(self, index: int, group: Mapping[int, SE3], after: Sequence[SE3]) -> None:
        """Whether one motion takes all parts of the group from their poses to those in `after`."""
        if not group:
            return
        anchor = next(iter(group))
        motion = after[anchor] * group[anchor].inverse()
        for part, pose in group.items():
            self._same(ViolationKind.NOT_RIGID, index, part, motion * pose, after[part])

    def _still(self, index: int, step: PlanStep) -> None:
        self._pairs(ViolationKind.STILL_PENETRATION, ViolationKind.STILL_GROUND, index, step.still)

    def _rest(self, index: int, poses: Sequence[SE3]) -> None:
        placed = self._fastened(dict(enumerate(poses)), index)
        self._pairs(ViolationKind.REST_PENETRATION, ViolationKind.REST_GROUND, index, placed)

    def _pairs(self, penetration: ViolationKind, ground: ViolationKind, index: int, poses: Mapping[int, SE3]) -> None:
        placed = {p: self._placed(p, pose) for p, pose in poses.items()}
        corners = {p: self._meshes[p].vertices @ pose.rotation.T + pose.translation for p, pose in poses.items()}
        for part, points in corners.items():
            if points[:, 2].min() < 0:
                self._found(ground, index, -1, (part,), float(-points[:, 2].min()))
        for a, b in combinations(poses, 2):
            if (corners[a].min(axis=0) > corners[b].max(axis=0)).any():
                continue
            if (corners[b].min(axis=0) > corners[a].max(axis=0)).any():
                continue
            depth = self._depth(placed[a], placed[b])
            if depth is None and (self._inside(a, b, corners) or self._inside(b, a, corners)):
                depth = float("nan")
            if depth is not None:
                self._found(penetration, index, -1, (a, b), depth)

    def _inside(self, a: int, b: int, corners: Mapping[int, Float[np.ndarray, "v 3"]]) -> bool:
        """Whether part a lies wholly in the solid of part b, so that no surfaces cut each other."""
        low, high = corners[b].min(axis=0), corners[b].max(axis=0)
        if not self._meshes[b].is_solid or (corners[a] < low).any() or (corners[a] > high).any():
            return False
        return _winding_number(corners[a][0], corners[b], self._meshes[b].faces) > 0.5

    def _path(
        self, index: int, path: Sequence[SE3], moving_parts: Mapping[int, SE3], still_parts: Mapping[int, SE3]
    ) -> None:
        manager = self._fcl.DynamicAABBTreeCollisionManager()
        still = {p: self._placed(p, pose) for p, pose in still_parts.items()}
        manager.registerObjects(list(still.values()))
        manager.setup()
        moving = {p: self._placed(p, pose) for p, pose in moving_parts.items()}
        radius = max(
            float(np.linalg.norm(self._meshes[p].vertices @ pose.rotation.T + pose.translation, axis=1).max())
            for p, pose in moving_parts.items()
        )
        for state, (turn, place) in enumerate(self._interpolated(path, radius)):
            self._states += 1
            for part, pose in moving_parts.items():
                rotation, translation = turn @ pose.rotation, turn @ pose.translation + place
                lowest = float((self._meshes[part].vertices @ rotation[2]).min() + translation[2])
                if lowest < 0:
                    self._found(ViolationKind.PATH_GROUND, index, state, (part,), -lowest)
                moving[part].setTransform(self._fcl.Transform(rotation, translation))
                data = self._fcl.CollisionData()
                manager.collide(moving[part], data, self._fcl.defaultCollisionCallback)
                if data.result.is_collision:
                    for other, placed in still.items():
                        depth = self._depth(moving[part], placed)
                        if depth is not None:
                            self._found(ViolationKind.PATH_PENETRATION, index, state, (part, other), depth)

    def _interpolated(
        self, path: Sequence[SE3], radius: float
    ) -> Iterator[tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]]:
        """Yield rotation and translation of every state of the path, way-points included."""
        yield path[0].rotation, path[0].translation
        for a, b in pairwise(path):
            ends = Rotation.from_matrix(np.array([a.rotation, b.rotation]))
            angle = float((ends[0].inv() * ends[1]).magnitude())
            travel = float(np.linalg.norm(b.translation - a.translation))
            fewest = max((travel + angle * radius) / self._resolution, angle / self._angular_resolution)
            fractions = np.linspace(0.0, 1.0, max(1, int(np.ceil(fewest))) + 1)[1:]
            turns = Slerp([0.0, 1.0], ends)(fractions).as_matrix()
            for fraction, turn in zip(fractions, turns, strict=True):
                yield turn, (1.0 - fraction) * a.translation + fraction * b.translation


def fcl_module() -> Any:
    """Return the module python-fcl.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        return importlib.import_module("fcl")
    except ImportError:
        raise MissingExtraError("python-fcl", "bench") from None


def fcl_model(fcl: Any, mesh: Mesh) -> Any:
    """Return a mesh as FCL's triangles."""
    model = fcl.BVHModel()
    model.beginModel(len(mesh.vertices), len(mesh.faces))
    model.addSubModel(mesh.vertices, mesh.faces)
    model.endModel()
    return model


def _winding_number(
    point: Float[np.ndarray, "3"], vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> float:
    """Return a surface's winding number about a point: 1 inside a solid, 0 outside (van Oosterom and Strackee 1983)."""
    a, b, c = (vertices[faces[:, i]] - point for i in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    dots = (np.einsum("ij,ij->i", x, y) for x, y in ((a, b), (b, c), (c, a)))
    ab, bc, ca = dots
    solid_angles = 2.0 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    return float(solid_angles.sum() / (4.0 * np.pi))
