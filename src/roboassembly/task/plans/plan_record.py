"""Recorded plan read back from `plan.json`: poses and paths as they stand there, checked for form but not replanned."""

from __future__ import annotations

import msgspec

from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, pose_from_seven
from roboassembly.task.plans import plan_file
from roboassembly.task.plans.plan import Insertion, Plan, PlanStep, UprightMotion, UprightResult
from roboassembly.task.plans.plan_schema import InsertionEntry, LeftOutEntry, MotionEntry, PlacedEntry, StepEntry


class _Upright(msgspec.Struct):
    success: bool
    reason: str
    motion: MotionEntry | None
    planning_steps: int


class _Record(msgspec.Struct):
    success: bool
    initial: list[list[float]]
    steps: list[StepEntry]
    upright: _Upright | None = None
    insertions: list[InsertionEntry] = []
    not_inserted: list[LeftOutEntry] = []


def read_plan(content: bytes, where: str, furniture: Furniture) -> Plan:
    """Return the recorded plan of an object-centric assembly, without the stability of its states.

    Args:
        content: of `plan.json`.
        where: name of the file, for errors.
        furniture: the piece that it assembles.

    Raises:
        InputError: it is no plan, it moves robots, its parts are not those of the furniture, or a pose is broken.
    """
    script = plan_file.decode_without_robots(content, where)
    names = tuple(part.name for part in furniture.parts)
    if script.parts != names:
        raise InputError(
            f"'{where}' is a plan for '{script.furniture}', whose parts differ from the furniture beside it"
        )
    try:
        record = msgspec.json.decode(content, type=_Record)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"'{where}' is no plan: {error}; `roboassembly assemble` writes one") from None
    try:
        steps = tuple(_step(step, len(names), f"step {index}") for index, step in enumerate(record.steps))
        initial = _poses(record.initial, len(names), "initial")
        upright = None if record.upright is None else _upright(record.upright, len(names))
        fasteners = {fastener.name: index for index, fastener in enumerate(furniture.fasteners)}
        insertions = tuple(_insertion(entry, fasteners, len(names), len(steps)) for entry in record.insertions)
        not_inserted = {_fastener(e.fastener, fasteners): e.reason for e in record.not_inserted}
    except InputError as error:
        raise InputError(f"'{where}': {error}") from None
    return Plan(
        furniture, initial, steps, record.success, script.seed, upright, None, insertions, tuple(not_inserted.items())
    )


def _step(step: StepEntry, parts: int, where: str) -> PlanStep:
    moving, still = _placed(step.moving, parts, f"{where}, moving"), _placed(step.still, parts, f"{where}, still")
    if set(moving) & set(still) or len(moving) + len(still) != parts or not moving:
        raise InputError(f"{where}: `moving` and `still` name {sorted(moving)} and {sorted(still)}; "
                         f"expected each part of 0..{parts - 1} once, and one that moves")  # fmt: skip
    if not step.waiting or not set(step.waiting) <= set(still):
        raise InputError(f"{where}: `waiting` names {step.waiting}; expected parts of `still`")
    if not step.path or not step.settling:
        raise InputError(f"{where}: `path` or `settling` is empty")
    return PlanStep(
        tuple(step.action),
        moving,
        tuple(step.waiting),
        still,
        _poses(step.path, None, f"{where}, path"),
        _poses(step.settling, None, f"{where}, settling"),
        _poses(step.after, parts, f"{where}, after"),
        step.planning_steps,
        step.planner,
        0.0,
    )


def _upright(entry: _Upright, parts: int) -> UprightResult[UprightMotion]:
    motion = None
    if entry.motion is not None:
        moving = _placed(entry.motion.moving, parts, "upright, moving")
        if len(moving) != parts:
            raise InputError(f"upright: `moving` names {sorted(moving)}; expected each part of 0..{parts - 1}")
        motion = UprightMotion(
            moving,
            _poses(entry.motion.path, None, "upright, path"),
            _poses(entry.motion.settling, None, "upright, settling"),
            _poses(entry.motion.after, parts, "upright, after"),
            entry.motion.planner,
        )
    return UprightResult(entry.success, entry.reason, motion, entry.planning_steps, 0.0)


def _insertion(entry: InsertionEntry, fasteners: dict[str, int], parts: int, steps: int) -> Insertion:
    where = f"insertion of '{entry.fastener}'"
    if not -1 <= entry.after <= steps or not 0 <= entry.part < parts or not entry.path:
        raise InputError(f"{where}: after step {entry.after}, part {entry.part}, {len(entry.path)} poses; expected a "
                         f"step from -1 to {steps}, a part from 0 to {parts - 1} and a pose or more")  # fmt: skip
    (pose,) = _poses([entry.pose], None, where)
    path = _poses(entry.path, None, where)
    index = _fastener(entry.fastener, fasteners)
    return Insertion(index, entry.after, entry.part, pose, path, entry.lift, entry.planning_steps)


def _fastener(name: str, fasteners: dict[str, int]) -> int:
    if name not in fasteners:
        raise InputError(f"fastener '{name}' is not in the furniture")
    return fasteners[name]


def _placed(entries: list[PlacedEntry], parts: int, where: str) -> dict[int, SE3]:
    for entry in entries:
        if not 0 <= entry.part < parts:
            raise InputError(f"{where}: part {entry.part}; expected 0 to {parts - 1}")
    return {entry.part: _poses([entry.pose], None, where)[0] for entry in entries}


def _poses(rows: list[list[float]], count: int | None, where: str) -> tuple[SE3, ...]:
    if count is not None and len(rows) != count:
        raise InputError(f"{where}: {len(rows)} poses; expected {count}, one a part")
    try:
        return tuple(pose_from_seven(row) for row in rows)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
