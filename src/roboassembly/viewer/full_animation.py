"""Frames of a plan of the full setting: parts, links of both robots, and the posts that are up.

Each segment gets a share of its step's time that grows with its length, and with the pace of its stage: drives are
shown in time-lapse, mates are slow. All motion is eased.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float32

from roboassembly.geometry.poses import SE3
from roboassembly.rendering.colors import Role
from roboassembly.robots.body import tip_positions
from roboassembly.robots.visual import visual_links, visual_poses
from roboassembly.task.full.cell_state import CellState, Segment
from roboassembly.task.full.failure import STRAIGHT, Stage
from roboassembly.task.full.posts import Post, post_mesh
from roboassembly.task.plans.full_plan import FullPlan
from roboassembly.viewer.captions import ending_caption, step_caption
from roboassembly.viewer.motion_timing import ease
from roboassembly.viewer.timeline import Frame, Phase, SceneObject, part_objects

_METRES_PER_RADIAN = 0.35
"""Length [m] that a turn of 1 rad of the platform or of an arm joint counts as."""
_SHORTEST = 0.25
"""Smallest length [m] that a segment counts as, so that short segments stay visible."""
_MATE_PACE = 3.0
"""Time of a mate over that of another straight motion of equal length."""
_DRIVE_PACE = 0.75
"""Time of a drive over that of a straight motion of equal length."""


@dataclass(frozen=True)
class FullPlanAnimator:
    """Makes the frames of a full plan, step by step."""

    plan: FullPlan
    frames_per_second: float
    seconds_per_step: float
    """Duration of a step [s]."""

    @cached_property
    def posts(self) -> tuple[Post, ...]:
        """Posts that are up at any time of the plan."""
        return self.plan.posts

    @property
    def objects(self) -> tuple[SceneObject, ...]:
        """Objects that the frames show: parts, links, then posts in the order in which the plan puts them up."""
        robots = [
            SceneObject(f"robot_{name}/{i}_{link.name}", link.mesh)
            for name in "ab"
            for i, link in enumerate(visual_links())
        ]
        posts = [
            SceneObject(f"posts/{i}", post_mesh(float(post.top[2])), framed=False) for i, post in enumerate(self.posts)
        ]
        return (*part_objects(self.plan.furniture), *robots, *posts)

    def path_points(self, index: int) -> Float32[np.ndarray, "n 3"]:
        """Return the path of the fingertips of R_a in a step [m]."""
        segments = self.plan.steps[index].segments
        paths = [tip_positions(np.array(segment.path)) for segment in segments if segment.robot == 0]
        return np.concatenate(paths).astype(np.float32)

    def opening(self) -> Frame:
        """Return the frame before the first step."""
        furniture = self.plan.furniture
        text = f"{furniture.name}: {len(furniture.parts)} parts, two robots"
        return self._resting(self.plan.initial.cell_state, Phase.OVERTURE, text)

    def ending(self) -> Frame:
        """Return the frame after the last step."""
        plan = self.plan
        text = ending_caption(plan.furniture, len(plan.steps), plan.success, plan.upright)
        return self._resting(plan.final_cell_state, Phase.FINALE, text)

    def step(self, index: int) -> Iterator[Frame]:
        """Yield the frames of one step."""
        furniture, step = self.plan.furniture, self.plan.steps[index]
        u_group, v_group = (
            next(g.parts for g in step.segments[0].before.groups() if part in g.parts) for part in step.action[:2]
        )
        sizes = len(u_group), len(v_group)
        caption = step_caption(furniture, index, len(self.plan.steps), step.action, sizes)
        roles = [Role.IDLE] * len(furniture.parts)
        for group, role in ((u_group, Role.MOVING), (v_group, Role.WAITING)):
            for part in group:
                roles[part] = role
        yield from self._segments(step.segments, roles, index, caption)

    def upright(self) -> Iterator[Frame]:
        """Yield the frames of the motion that sets the finished piece on its feet; none without such a motion."""
        furniture, segments = self.plan.furniture, self.plan.final_segments
        roles = [Role.MOVING] * len(furniture.parts)
        yield from self._segments(segments, roles, None, f"{furniture.name}: set upright")

    def _resting(self, state: CellState, phase: Phase, caption: str) -> Frame:
        roles = self._roles([Role.IDLE] * len(self.plan.furniture.parts))
        return Frame(tuple(self._poses(state)), roles, None, phase, caption)

    def _segments(
        self, segments: Sequence[Segment], part_roles: list[Role], index: int | None, caption: str
    ) -> Iterator[Frame]:
        roles = self._roles(part_roles)
        for segment, count in zip(segments, self._counts(segments), strict=True):
            text = f"{caption} | {segment.name}"
            poses = self._poses(segment.before)
            for k in range(1, count + 1):
                self._move(poses, segment, _configuration_at(segment, ease(k / count)))
                key = k == count and segment.stage is Stage.MATE
                yield Frame(tuple(poses), roles, index, Phase.MOVING, text, key)

    def _counts(self, segments: Sequence[Segment]) -> list[int]:
        """Return the number of frames of each segment: at least one, and together the time of a step."""
        lengths = [max(_SHORTEST, float(_edge_lengths(segment).sum())) for segment in segments]
        weights = np.array([_pace(segment) * length**0.5 for segment, length in zip(segments, lengths, strict=True)])
        ends = np.cumsum(weights) / weights.sum() * self.seconds_per_step * self.frames_per_second
        return [max(1, round(end) - round(start)) for start, end in itertools.pairwise([0.0, *map(float, ends)])]

    def _roles(self, parts: list[Role]) -> tuple[Role, ...]:
        robots = [
            Role.ROBOT_DARK if link.dark else role for role in (Role.ROBOT_A, Role.ROBOT_B) for link in visual_links()
        ]
        return (*parts, *robots, *[Role.POST] * len(self.posts))

    def _poses(self, state: CellState) -> list[SE3 | None]:
        """Return the pose of each object; None for a post that is not up."""
        parts = {p: pose for g in state.groups() for p, pose in zip(g.parts, g.part_poses(), strict=True)}
        robots = [pose for r in state.robots for pose in visual_poses(r.at, r.opening)]
        up = {id(post) for post in state.posts}
        posts = [SE3(np.eye(3), post.top) if id(post) in up else None for post in self.posts]
        return [*(parts[p] for p in range(len(parts))), *robots, *posts]

    def _move(self, poses: list[SE3 | None], segment: Segment, configuration: Float[np.ndarray, "10"]) -> None:
        """Write the poses of the robot that moves, and of the group in its hand, into `poses`."""
        robot = segment.before.robots[segment.robot]
        first = len(self.plan.furniture.parts) + segment.robot * _link_count()
        poses[first : first + _link_count()] = visual_poses(configuration, robot.opening)
        if robot.payload is not None:
            group = robot.payload.placed(configuration)
            for part, pose in zip(group.parts, group.part_poses(), strict=True):
                poses[part] = pose


def _link_count() -> int:
    """Return the number of shapes of one robot."""
    return len(visual_links())


def _pace(segment: Segment) -> float:
    if segment.stage is Stage.MATE:
        return _MATE_PACE
    return 1.0 if segment.stage in STRAIGHT else _DRIVE_PACE


def _edge_lengths(segment: Segment) -> Float[np.ndarray, "n"]:
    """Return the length [m] of each edge of a segment's path, turns included."""
    return np.array([_distance(a, b) for a, b in itertools.pairwise(segment.path)])


def _distance(a: Float[np.ndarray, "10"], b: Float[np.ndarray, "10"]) -> float:
    turned = np.abs(b - a)[2:].max(initial=0.0)
    return float(np.linalg.norm((b - a)[:2]) + _METRES_PER_RADIAN * turned)


def _configuration_at(segment: Segment, share: float) -> Float[np.ndarray, "10"]:
    """Return the configuration of the robot after a share of a segment's length."""
    reached = np.concatenate([[0.0], np.cumsum(_edge_lengths(segment))])
    if reached[-1] == 0.0:
        return segment.path[-1]
    at = float(share * reached[-1])
    k = min(int(np.searchsorted(reached, at, side="right")) - 1, len(segment.path) - 2)
    inner = float(at - reached[k]) / max(reached[k + 1] - reached[k], 1e-12)
    return segment.path[k] + inner * (segment.path[k + 1] - segment.path[k])
