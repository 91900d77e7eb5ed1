"""`plan.json`: a plan as a file. It holds no timings, so that the same seed writes the same bytes.

    format, version   "roboassembly.plan", 1
    furniture         name, parts (their names, in order), source
    setting, seed, success
    initial           pose of every part before the first step
    steps             one object a merge, see `_Step`

Poses are `(x, y, z, qw, qx, qy, qz)`, metres, world frame, z up, ground at z = 0. Between two way-points of `path` the
translation is linear and the rotation spherical-linear, both from 0 to 1 together.
"""

from __future__ import annotations

from pathlib import Path

import msgspec

from roboassembly.poses import SE3, pose_to_seven
from roboassembly.task.plan import Plan, PlanStep

FORMAT = "roboassembly.plan"
VERSION = 1


class _Placed(msgspec.Struct):
    part: int
    pose: list[float]


class _Step(msgspec.Struct):
    action: list[int]
    """`[u, v, k, l, w]`."""
    path: list[list[float]]
    """Poses of the moving group's frame (origin at its centre of mass), from where it lies to where it mates."""
    moving: list[_Placed]
    """Parts of the moving group: a part's world pose is the path's pose times this one."""
    waiting: list[int]
    """Parts of the group that waits for it."""
    still: list[_Placed]
    """World poses, while the group moves, of all parts that do not."""
    settling: list[list[float]]
    """Motions of the world that carry the merged group from the mating pose to rest, first to last."""
    after: list[list[float]]
    """World pose of every part when the step is over."""
    planning_steps: int
    planner: str


class _Furniture(msgspec.Struct):
    name: str
    parts: list[str]
    source: str


class _File(msgspec.Struct):
    format: str
    version: int
    furniture: _Furniture
    setting: str
    seed: int
    success: bool
    initial: list[list[float]]
    steps: list[_Step]


def encode(plan: Plan) -> bytes:
    """The contents of `plan.json`."""
    furniture = plan.furniture
    document = _File(
        FORMAT,
        VERSION,
        _Furniture(furniture.name, [p.name for p in furniture.parts], furniture.provenance.source),
        "object-centric",
        plan.seed,
        plan.success,
        [pose_to_seven(p) for p in plan.initial],
        [_step(s) for s in plan.steps],
    )
    return msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n"


def write(plan: Plan, path: Path) -> None:
    """Write `plan.json` to `path`."""
    path.write_bytes(encode(plan))


def _step(step: PlanStep) -> _Step:
    return _Step(
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


def _placed(poses: dict[int, SE3]) -> list[_Placed]:
    return [_Placed(part, pose_to_seven(pose)) for part, pose in sorted(poses.items())]
