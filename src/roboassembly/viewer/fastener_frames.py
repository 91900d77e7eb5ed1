"""Fasteners in the frames of a plan: hidden until they go in, and then moving with the part that they sit in."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby, pairwise

import numpy as np
from jaxtyping import Float

from roboassembly.geometry.poses import SE3, shifted
from roboassembly.rendering.colors import Role
from roboassembly.task.plans.plan import Insertion, Plan
from roboassembly.viewer.motion_timing import ease, path_length, pose_between
from roboassembly.viewer.timeline import Frame, SceneObject

_TURN_REACH = 0.02
"""Distance from the axis by which turns count as travel, so that a screw takes time to turn [m]."""


def fastener_objects(plan: Plan) -> tuple[SceneObject, ...]:
    """Return one object for each fastener that goes in, in the order of the insertions."""
    fasteners = plan.furniture.fasteners
    return tuple(
        SceneObject(f"fasteners/{k}_{fasteners[i.fastener].name.replace('/', '_')}", fasteners[i.fastener].mesh, False)
        for k, i in enumerate(plan.insertions)
    )


def with_fasteners(plan: Plan, frame: Frame, until: int) -> Frame:
    """Return a frame of the parts with the fasteners that went in after steps up to `until`; others are hidden."""
    if not plan.insertions:
        return frame
    poses: list[SE3 | None] = []
    roles: list[Role] = []
    for insertion in plan.insertions:
        pose = frame.poses[insertion.part]
        assert pose is not None
        poses.append(pose * insertion.part_from_fastener if insertion.after <= until else None)
        roles.append(frame.roles[insertion.part])
    return replace(frame, poses=(*frame.poses, *poses), roles=(*frame.roles, *roles))


def insertion_frames(plan: Plan, after: int, rest: Frame, count: int) -> Iterator[Frame]:
    """Yield the frames of the fasteners that go in after a step, one kind of equal ones after the other.

    Args:
        plan: the plan.
        after: index of the step; see `Insertion.after`.
        rest: frame of the parts where they lie.
        count: number of frames for one kind.
    """
    fasteners = plan.furniture.fasteners
    now = [(k, i) for k, i in enumerate(plan.insertions) if i.after == after]
    order = {mesh: k for k, mesh in enumerate(dict.fromkeys(fasteners[i.fastener].mesh for _, i in now))}
    now.sort(key=lambda item: order[fasteners[item[1].fastener].mesh])
    inside: set[int] = {k for k, i in enumerate(plan.insertions) if i.after < after}
    parts = len(plan.furniture.parts)
    for mesh, group in groupby(now, key=lambda item: fasteners[item[1].fastener].mesh):
        going = dict(group)
        kind = next(fasteners[i.fastener].kind for i in going.values() if fasteners[i.fastener].mesh is mesh)
        names = [fasteners[i.fastener].name for i in going.values()]
        caption = f"{_when(plan, after)}: {names[0]} goes in" if len(names) == 1 else (
            f"{_when(plan, after)}: {len(names)} {kind}s go in"
        )  # fmt: skip
        base = replace(with_fasteners(plan, rest, after), caption=caption)
        for k in range(1, count + 1):
            poses, roles = list(base.poses), list(base.roles)
            for index, insertion in enumerate(plan.insertions):
                if index in going:
                    poses[parts + index] = _along(insertion, ease(k / count))
                    roles[parts + index] = Role.MOVING
                    # The part that it goes into stands out, and the camera looks at it.
                    roles[insertion.part] = Role.WAITING
                elif insertion.after == after and index not in inside:
                    poses[parts + index] = None
            # A raised group is shown where it lies: the lift is small, and the way is the same.
            yield replace(base, poses=tuple(poses), roles=tuple(roles))
        inside |= set(going)


def _along(insertion: Insertion, fraction: float) -> SE3:
    """Return the pose of a fastener at a fraction of its way, with its group where it lies."""
    path: Sequence[SE3] = insertion.path
    lengths = np.array([path_length([a, b], _TURN_REACH) for a, b in pairwise(path)])
    reached: Float[np.ndarray, "n"] = np.concatenate([[0.0], np.cumsum(lengths)])
    at = fraction * float(reached[-1])
    edge = min(int(np.searchsorted(reached, at, side="right")) - 1, len(lengths) - 1)
    length = float(lengths[edge])
    part = (at - float(reached[edge])) / length if length > 0.0 else 1.0
    pose = pose_between(path[edge], path[edge + 1], min(max(part, 0.0), 1.0))
    return shifted(pose, np.array([0.0, 0.0, -insertion.lift]))


def _when(plan: Plan, after: int) -> str:
    if after < 0:
        return "before step 1"
    return f"after step {after + 1}" if after < len(plan.steps) else "at the end"
