"""`plan.json`: a plan as a file. It holds no timings, so that the same seed writes the same bytes.

    format, version   "roboassembly.plan", 3
    furniture         name, parts (their names, in order), source
    setting           "object-centric" or "full"
    seed, success
    initial           pose of every part before the first step
    steps             one object a merge, see `StepEntry` (object-centric) and `FullStepEntry` (full)
    upright           whether the assembled piece ends on its feet, why not, and the motion that sets it there, see
                      `UprightEntry`; absent if it is not assembled, or if nobody asked for it
    stability         groups that stand on their own in each state, see `StableEntry`; absent if nobody asked for it
    insertions        fasteners that go in, see `InsertionEntry`, and those that do not, under `not_inserted`
    robots, posts     full only: both robots' configurations at first; where cups of posts ever end

Version 1 had no `upright`; versions 1 and 2 had `legs` with a `name` instead of `segments` with a
`stage`. All three are read.

Poses are `(x, y, z, qw, qx, qy, qz)`, metres, world frame, z up, ground at z = 0. Between two way-points of `path` the
translation is linear and the rotation spherical-linear, both from 0 to 1 together.

A robot's configuration is `(x, y, angle, q1 ... q7)`: its platform, then the Panda's joints; metres and radians.
Between two of a segment all ten numbers go linearly. R_a is robot 0, R_b is robot 1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from roboassembly.errors import InputError
from roboassembly.geometry.poses import SE3, pose_to_seven
from roboassembly.task.plans.plan import Plan, PlanStep, UprightMotion, UprightResult
from roboassembly.task.plans.plan_schema import (
    FullMotionEntry,
    FullStepEntry,
    FurnitureEntry,
    InsertionEntry,
    LeftOutEntry,
    MotionEntry,
    PlacedEntry,
    PlanDocument,
    SegmentEntry,
    StableEntry,
    StepEntry,
    UprightEntry,
)
from roboassembly.task.plans.stability import PlanStability
from roboassembly.task.rules.groups import TaskState
from roboassembly.task.setting import SettingName

if TYPE_CHECKING:
    # A record without robots is written without their libraries.
    from roboassembly.task.full.cell_state import CellState, Segment
    from roboassembly.task.plans.full_plan import FullPlan, FullStep

FORMAT = "roboassembly.plan"
VERSION = 3
READ_VERSIONS = (1, 2, 3)
"""Versions that `decode` reads."""
_LARGEST = 2**31


class _Header(msgspec.Struct):
    format: str = ""


def is_plan(path: Path) -> bool:
    """Whether a file says that it is a plan of this program. Nothing else of it is read."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=_Header).format == FORMAT
    except (OSError, msgspec.DecodeError, UnicodeDecodeError):
        return False


_ACTION_LENGTHS: dict[SettingName, int] = {"object-centric": 5, "full": 6}


class _Done(msgspec.Struct):
    action: list[int]


class _ScriptFile(msgspec.Struct):
    """Part of a file that is read."""

    format: str
    version: int
    furniture: FurnitureEntry
    setting: SettingName
    seed: int
    steps: list[_Done]


def encode(plan: Plan | FullPlan) -> bytes:
    """Return the contents of `plan.json`."""
    return msgspec.json.format(msgspec.json.encode(_DOCUMENTS[plan.setting](plan)), indent=1) + b"\n"


def _object_centric_document(plan: Plan) -> PlanDocument:
    document = _document(plan, plan.initial)
    document.steps = [_step(s) for s in plan.steps]
    if plan.upright is not None:
        document.upright = _upright(plan.upright, _motion(plan.upright.motion) if plan.upright.motion else None)
    if plan.stability is not None:
        document.stability = _stability(plan.stability)
    names = [fastener.name for fastener in plan.furniture.fasteners]
    document.insertions = [
        InsertionEntry(
            names[i.fastener],
            i.after,
            i.part,
            pose_to_seven(i.part_from_fastener),
            [pose_to_seven(p) for p in i.path],
            i.lift,
            i.planning_steps,
        )
        for i in plan.insertions
    ]
    document.not_inserted = [LeftOutEntry(names[index], reason) for index, reason in plan.not_inserted]
    return document


def _full_document(plan: FullPlan) -> PlanDocument:
    posts = {id(post): i for i, post in enumerate(plan.posts)}
    document = _document(plan, plan.initial.groups.part_poses)
    document.steps = [_full_step(s, posts) for s in plan.steps]
    document.robots = [r.at.tolist() for r in plan.initial.cell_state.robots]
    document.posts = [post.top.tolist() for post in plan.posts]
    document.density = plan.initial.cell.density
    if plan.upright is not None:
        segments = [_segment(segment, posts) for segment in plan.final_segments]
        motion = FullMotionEntry(segments, _where(plan.final_cell_state)) if segments else None
        document.upright = _upright(plan.upright, motion)
    return document


def _document(plan: Plan | FullPlan, initial: Sequence[SE3]) -> PlanDocument:
    """Return the part of the file that both settings share, without steps."""
    furniture = plan.furniture
    return PlanDocument(
        FORMAT,
        VERSION,
        FurnitureEntry(furniture.name, [p.name for p in furniture.parts], furniture.provenance.source),
        plan.setting,
        plan.seed,
        plan.success,
        [pose_to_seven(p) for p in initial],
        [],
    )


_DOCUMENTS: dict[SettingName, Callable[[Any], PlanDocument]] = {
    "object-centric": _object_centric_document,
    "full": _full_document,
}


def write(plan: Plan | FullPlan, path: Path) -> None:
    """Write `plan.json` to `path`."""
    path.write_bytes(encode(plan))


@dataclass(frozen=True)
class Script:
    """Part of a plan that is needed to carry it out again."""

    furniture: str
    """Name of the furniture."""
    parts: tuple[str, ...]
    """Names of the parts."""
    setting: SettingName
    seed: int
    actions: tuple[tuple[int, ...], ...]


def decode(content: bytes, where: str) -> Script:
    """Read the contents of `plan.json`.

    Poses and paths of the file are not used: the plan is planned and checked again.

    Args:
        content: of the file.
        where: the file's name, for errors.

    Raises:
        InputError: it is no plan, of another version, or an action has the wrong length.
    """
    try:
        header = msgspec.json.decode(content, type=_ScriptFile)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"'{where}' is no plan: {error}; `roboassembly assemble` writes one") from None
    if header.format != FORMAT or header.version not in READ_VERSIONS:
        known = ", ".join(map(str, READ_VERSIONS))
        raise InputError(
            f"'{where}' has format {header.format!r}, version {header.version}; this program reads {FORMAT!r}, "
            f"versions {known}: `roboassembly assemble` of this version writes the plan anew"
        )
    length = _ACTION_LENGTHS[header.setting]
    for index, step in enumerate(header.steps):
        if len(step.action) != length or not all(-_LARGEST < i < _LARGEST for i in step.action):
            raise InputError(f"'{where}': step {index}: action {step.action}; expected {length} small integers")
    if not 0 <= header.seed < _LARGEST:
        raise InputError(f"'{where}': seed {header.seed}; expected 0 to {_LARGEST - 1}")
    actions = tuple(tuple(step.action) for step in header.steps)
    return Script(header.furniture.name, tuple(header.furniture.parts), header.setting, header.seed, actions)


def decode_with_robots(content: bytes, where: str) -> Script:
    """Read the content of a plan of two robots.

    Args:
        content: as in `decode`.
        where: as in `decode`.

    Raises:
        InputError: as `decode`, or the plan moves no robots.
    """
    script = decode(content, where)
    if script.setting != "full":
        raise InputError(
            f"'{where}' is a plan of setting '{script.setting}', which moves no robots; "
            "expected one that `roboassembly assemble --setting full` writes"
        )
    return script


def decode_without_robots(content: bytes, where: str) -> Script:
    """Read the content of a plan in which parts move by themselves.

    Args:
        content: as in `decode`.
        where: as in `decode`.

    Raises:
        InputError: as `decode`, or the plan moves robots.
    """
    script = decode(content, where)
    if script.setting != "object-centric":
        raise InputError(
            f"'{where}' is a plan of setting '{script.setting}': posts hold every group in it, so that none stands on "
            "its own; expected a plan without robots"
        )
    return script


def _step(step: PlanStep) -> StepEntry:
    return StepEntry(
        list(step.action),
        [pose_to_seven(p) for p in step.path],
        _placed(step.moving),
        list(step.waiting),
        _placed(step.still),
        [pose_to_seven(p) for p in step.settling],
        [pose_to_seven(p) for p in step.after],
        step.planning_steps,
        step.planner,
    )


def _full_step(step: FullStep, posts: dict[int, int]) -> FullStepEntry:
    segments = [_segment(segment, posts) for segment in step.segments]
    return FullStepEntry(list(step.action), segments, _where(step.segments[-1].after), step.planning_steps)


def _upright(result: UprightResult[Any], motion: MotionEntry | FullMotionEntry | None) -> UprightEntry:
    return UprightEntry(result.success, result.reason, motion, result.planning_steps)


def _motion(motion: UprightMotion) -> MotionEntry:
    return MotionEntry(
        [pose_to_seven(p) for p in motion.path],
        _placed(motion.moving),
        [pose_to_seven(p) for p in motion.settling],
        [pose_to_seven(p) for p in motion.after],
        motion.planner,
    )


def _stability(stability: PlanStability) -> list[StableEntry]:
    return [
        StableEntry(g.step, g.role.value, list(g.parts), g.stable, round(g.tilt, 4), round(g.shift, 4))
        for g in stability.groups
    ]


def _where(state: CellState) -> list[list[float]]:
    """Return the pose of every part."""
    return [pose_to_seven(p) for p in TaskState(tuple(state.groups())).part_poses]


def _segment(segment: Segment, posts: dict[int, int]) -> SegmentEntry:
    robot = segment.before.robots[segment.robot]
    payload: dict[int, SE3] = {}
    if robot.payload is not None:
        group, tips = robot.payload.group, robot.payload.grip.furniture_from_tips
        payload = {p: tips.actInv(pose) for p, pose in zip(group.parts, group.furniture_from_part, strict=True)}
    up = sorted(posts[id(stand)] for stand in segment.before.posts)
    return SegmentEntry(
        segment.stage.value, segment.robot, robot.opening, [q.tolist() for q in segment.path], _placed(payload), up
    )


def _placed(poses: dict[int, SE3]) -> list[PlacedEntry]:
    return [PlacedEntry(part, pose_to_seven(pose)) for part, pose in sorted(poses.items())]
