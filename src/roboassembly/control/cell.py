"""Workcell under control: groups of parts in physics, hands that grip them, posts that hold them, joints that close.

A joint closes as in dynamic execution: two groups become one when they are within 2 mm and 2° of a right joint, here
also nearly at rest against each other. At least one of them is in a hand. Nothing else is fixed to anything but by a
grip or by posts: a group that a hand lets go of near the height of the posts gets posts beneath it, else it falls.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from roboassembly.control.randomization import Variation
from roboassembly.furniture.model import Furniture, Part
from roboassembly.geometry.meshes import WOOD_DENSITY, Mesh
from roboassembly.geometry.poses import SE3, align_axis, pose_to_seven, rotation_angle
from roboassembly.geometry.scene import Shape
from roboassembly.robots.gripper import hand_pose
from roboassembly.robots.platform import LENGTH, WIDTH
from roboassembly.simulation.control_model import CellBody, CellContents
from roboassembly.simulation.control_physics import CONTROL_RATE, CellPhysics
from roboassembly.simulation.convex_pieces import convex_pieces
from roboassembly.simulation.model import mass_properties
from roboassembly.task.full.cell_state import CellState, Payload, PlacedGroup, Robot
from roboassembly.task.full.execution import JOINT_ANGLE, JOINT_POSITION
from roboassembly.task.full.grips import TOUCH, Grip
from roboassembly.task.full.posts import LOWEST, POST_RADIUS, Post, on_post, on_two_posts
from roboassembly.task.plans.full_plan import FullState
from roboassembly.task.rules.connections import UP_AXES, Rules
from roboassembly.task.rules.groups import Group, TaskState, body, center_of_mass, hull_points
from roboassembly.task.rules.pairs import Merge

RELEASE_MARGIN = 0.003
"""Distance by which a commanded opening must exceed the measured one for a hand to let go [m]."""
POST_HEIGHT = 0.05
"""Distance from the height of the posts within which a group that is let go of gets posts [m]."""
_CALM = 0.2
"""Speed below which a group that is let go of gets posts [m/s]."""
_AT_REST_POSITION, _AT_REST_ANGLE = 5e-4, float(np.deg2rad(0.3))
"""Motion of two groups against each other within one control step when they are joined [m, rad]."""
_MATING_POSITION, _MATING_ANGLE = 0.05, float(np.deg2rad(5.0))
"""Distance and angle from a right joint within which two groups may touch each other [m, rad]."""
_COSINE_ASKEW = float(np.cos(np.deg2rad(3.0)))
"""Cosine of the angle below which a group counts as level."""
_LOOSE_STEPS = CONTROL_RATE
"""Control steps after which a group that nothing holds counts as dropped, wherever it lies."""
_NEAR = 0.05
"""Distance between the spheres around two groups below which their joints are looked at [m]."""


@dataclass(frozen=True, eq=False)
class Joining:
    """A joint that closed."""

    first: tuple[int, ...]
    """Parts of one group."""
    second: tuple[int, ...]
    """Parts of the other group."""
    position: float
    """Error of the joint when it closed, at the first group's centre of mass [m]."""
    angle: float
    """Error of the joint's angle when it closed [rad]."""


@dataclass(frozen=True, eq=False)
class CellEvents:
    """Events of one control step."""

    joined: tuple[Joining, ...] = ()
    dropped: tuple[int, ...] = ()
    """Parts of a group that nothing holds any more; empty if there is none."""


@dataclass(frozen=True, eq=False)
class JointCandidates:
    """Right joints of two groups."""

    merges: tuple[Merge, ...]
    goals: tuple[SE3, ...]
    """Pose `second_from_first` of each."""


class ControlCell:
    """Robots, groups and posts of one episode.

    Args:
        furniture: the piece.
        rules: its rules.
        start: state at the beginning; both hands are empty.
        variation: draws of the episode.
    """

    def __init__(self, furniture: Furniture, rules: Rules, start: FullState, variation: Variation) -> None:
        self.furniture, self.rules, self.cell = furniture, rules, start.cell
        self._density = start.cell.density / WOOD_DENSITY * variation.density
        self.groups: dict[int, Group] = {}
        """Groups by key, the lowest part of which they were made; their poses are those at which they were made."""
        self._posts: dict[int, Post] = {}
        for placed in start.cell_state.placed:
            key = placed.group.parts[0]
            self.groups[key], self._posts[key] = placed.group, placed.post
        contents = CellContents(
            {key: self._body(group) for key, group in self.groups.items()},
            {key: group.world_from_furniture for key, group in self.groups.items()},
            posts={key: tuple(p.top for p in post.each) for key, post in self._posts.items()},
        )
        robots = start.cell_state.robots
        self.physics = CellPhysics([r.at for r in robots], [r.opening for r in robots], contents, variation.physics)
        self._candidates: dict[tuple[tuple[int, ...], ...], JointCandidates] = {}
        self._last: dict[tuple[int, int], SE3] = {}
        self._sevens: dict[int, tuple[Group, Float[np.ndarray, "g 7"]]] = {}
        self._loose: dict[int, int] = {}
        self._radii: dict[int, tuple[Group, float]] = {}

    def _body(self, group: Group) -> CellBody:
        mass, center, inertia = mass_properties(body(self.furniture, group, "group"))
        pieces = tuple(
            Shape(piece, pose)
            for part, pose in zip(group.parts, group.furniture_from_part, strict=True)
            for piece in pieces_of_part(self.furniture.parts[part])
        )
        return CellBody(self._density * mass, center, self._density * inertia, pieces)

    @property
    def complete(self) -> bool:
        """Whether all parts are in one group."""
        return len(self.groups) == 1

    @property
    def posts(self) -> tuple[Post, ...]:
        """All raised posts, each by itself."""
        return tuple(post for placed in self._posts.values() for post in placed.each)

    def key_of(self, part: int) -> int:
        """Return the key of the group of a part."""
        return next(key for key, group in self.groups.items() if part in group.parts)

    def group(self, key: int) -> Group:
        """Return a group where it is."""
        return self.groups[key].moved_to(self.physics.pose(key))

    def part_poses(self) -> list[SE3]:
        """Return `world_from_part` of every part."""
        poses: dict[int, SE3] = {}
        for key, group in self.groups.items():
            pose = self.physics.pose(key)
            poses.update(zip(group.parts, (pose * p for p in group.furniture_from_part), strict=True))
        return [poses[part] for part in range(len(poses))]

    def part_sevens(self) -> Float[np.ndarray, "p 7"]:
        """Return `x, y, z, qw, qx, qy, qz` of every part in the world [m]; `qw >= 0`."""
        rows = np.empty((len(self.furniture.parts), 7))
        for key, group in self.groups.items():
            known = self._sevens.get(key)
            if known is None or known[0] is not group or key in self.physics.contents.moving:
                pose = self.physics.pose(key)
                known = group, np.array([pose_to_seven(pose * p) for p in group.furniture_from_part])
                self._sevens[key] = known
            rows[list(group.parts)] = known[1]
        return rows

    def state(self) -> FullState:
        """Return the present state, in which the planner can go on if both hands are empty."""
        groups = [self.group(key) for key in self.groups]
        placed = [
            PlacedGroup(g, self._posts[key]) for key, g in zip(self.groups, groups, strict=True) if key in self._posts
        ]
        a, b = (self._robot(robot) for robot in (0, 1))
        return FullState(TaskState(tuple(groups)), CellState(tuple(placed), (a, b)), self.cell)

    def _robot(self, robot: int) -> Robot:
        physics, key = self.physics, self.physics.grasped(robot)
        at, opening = physics.configuration(robot), physics.opening(robot)
        if key is None:
            return Robot(at, opening)
        tips = physics.pose(key).actInv(physics.tips(robot))
        group = self.groups[key]
        grip = Grip(group.parts[0], 0, tips, tips.rotation[:, 2], opening, opening)
        return Robot(at, opening, Payload(group, grip))

    def advance(self, targets: Float[np.ndarray, "2 10"], openings: Float[np.ndarray, "2"]) -> CellEvents:
        """Carry out the commands of one control step.

        Args:
            targets: configuration that each robot is to have at its end.
            openings: distance between the pads of each hand [m]; 0 to close with force.
        """
        physics = self.physics
        for robot in (0, 1):
            if physics.grasped(robot) is not None and openings[robot] > physics.opening(robot) + RELEASE_MARGIN:
                self._release(robot)
        physics.advance(targets, openings.tolist())
        if not physics.stable:
            return CellEvents()
        for robot in (0, 1):
            pressed = physics.pressed_body(robot)
            if pressed is not None:
                physics.grip(robot, pressed)
                self._posts.pop(pressed, None)
        joined = tuple(self._close_joints())
        return CellEvents(joined, self._dropped())

    def _dropped(self) -> tuple[int, ...]:
        """Return the parts of a group that nothing holds and that lies on the floor, or elsewhere after a second."""
        loose = [key for key in self.physics.contents.moving if not self.physics.holders(key)]
        self._loose = {key: self._loose.get(key, 0) + 1 for key in loose}
        for key, steps in self._loose.items():
            if steps >= _LOOSE_STEPS or self.physics.on_floor(key):
                return self.groups[key].parts
        return ()

    def _release(self, robot: int) -> None:
        key = self.physics.grasped(robot)
        assert key is not None
        self.physics.release(robot)
        if self.physics.holders(key) or self.physics.speed(key) > _CALM:
            return
        post = self._post_beneath(self.group(key))
        if post is not None:
            self._posts[key] = post
            self._sevens.pop(key, None)
            self.physics.stand(key, [p.top for p in post.each])

    def _post_beneath(self, group: Group) -> Post | None:
        """Return the posts that can rise beneath a group where it is; None if none can."""
        points = hull_points(self.furniture, group)
        lowest = float(
            (points @ group.world_from_furniture.rotation[2] + group.world_from_furniture.translation[2]).min()
        )
        if abs(lowest - LOWEST) > POST_HEIGHT:
            return None
        level = _levelled(group)
        center = center_of_mass(self.furniture, group)
        for holder in (on_post, on_two_posts):
            found = holder(self.furniture, level, np.zeros(2))
            if found is not None:
                there, post = found
                post = post.moved(group.world_from_furniture.act(center) - there.world_from_furniture.act(center))
                return post if all(self._is_free(p.top[:2]) for p in post.each) else None
        return None

    def _is_free(self, place: Float[np.ndarray, "2"]) -> bool:
        """Whether neither a platform nor another post stands where a post would rise."""
        for robot in (0, 1):
            x, y, yaw = self.physics.configuration(robot)[:3]
            off = place - [x, y]
            along = np.array([np.cos(yaw) * off[0] + np.sin(yaw) * off[1], np.cos(yaw) * off[1] - np.sin(yaw) * off[0]])
            if (np.abs(along) < 0.5 * np.array([LENGTH, WIDTH]) + POST_RADIUS).all():
                return False
        return all(np.linalg.norm(place - post.top[:2]) > 2.0 * POST_RADIUS for post in self.posts)

    def _close_joints(self) -> Iterator[Joining]:
        """Join groups that are where they mate, and yield what was joined."""
        last, self._last = self._last, {}
        for first, second in self._near_pairs():
            if first not in self.groups or second not in self.groups:
                continue
            relative = self.physics.pose(second).actInv(self.physics.pose(first))
            self._last[first, second] = relative
            before, center = last.get((first, second)), self.physics.contents.bodies[first].center
            if before is None or _pose_error(before, relative, center, _AT_REST_POSITION, _AT_REST_ANGLE) is None:
                continue
            candidates = self.joints(first, second)
            errors = [_pose_error(goal, relative, center, JOINT_POSITION, JOINT_ANGLE) for goal in candidates.goals]
            fitting = [
                (error, merge) for error, merge in zip(errors, candidates.merges, strict=True) if error is not None
            ]
            if fitting:
                (position, angle), merge = min(fitting, key=lambda found: found[0][0])
                yield Joining(self.groups[first].parts, self.groups[second].parts, position, angle)
                self._join(first, second, merge)

    def _near_pairs(self) -> list[tuple[int, int]]:
        """Return pairs of a held group and a group that is held too or on posts, near each other."""
        physics = self.physics
        grasped = [key for robot in (0, 1) if (key := physics.grasped(robot)) is not None]
        pairs = [(grasped[0], grasped[1])] if len(set(grasped)) == 2 else []
        pairs += [(key, other) for key in dict.fromkeys(grasped) for other in physics.contents.on_posts]
        return [(first, second) for first, second in pairs if self._gap(first, second) < _NEAR]

    def _gap(self, first: int, second: int) -> float:
        """Return the distance between the spheres around two groups [m]."""
        between = self.physics.center(first) - self.physics.center(second)
        return float(np.sqrt(between @ between)) - self._radius(first) - self._radius(second)

    def _radius(self, key: int) -> float:
        if key not in self._radii or self._radii[key][0] is not self.groups[key]:
            points = hull_points(self.furniture, self.groups[key]) - self.physics.contents.bodies[key].center
            self._radii[key] = self.groups[key], float(np.linalg.norm(points, axis=1).max())
        return self._radii[key][1]

    def joints(self, first: int, second: int) -> JointCandidates:
        """Return the right joints of two groups, by their keys."""
        u, v = self.groups[first], self.groups[second]
        others = [g for g in self.groups.values() if g is not u and g is not v and len(g.parts) > 1]
        key = u.parts, v.parts, *(g.parts for g in others)
        if key not in self._candidates:
            free = self.rules.free_points(TaskState(tuple(self.groups.values())))
            merges: dict[bytes, tuple[Merge, SE3]] = {}
            for i in u.parts:
                for j in v.parts:
                    for k in np.flatnonzero(free[i]).tolist():
                        for m in np.flatnonzero(free[j]).tolist():
                            merge = self.rules.pairs.judge(u, v, i, k, j, m, others)
                            if merge is not None:
                                goal = merge.furniture_from_v.actInv(merge.furniture_from_u)
                                merges.setdefault(goal.homogeneous.round(3).tobytes(), (merge, goal))
            found = list(merges.values())
            self._candidates[key] = JointCandidates(tuple(m for m, _ in found), tuple(g for _, g in found))
        return self._candidates[key]

    def is_near_joint(self, first: int, second: int) -> bool:
        """Whether two groups, by their keys, are so near a right joint that they may touch each other."""
        relative = self.physics.pose(second).actInv(self.physics.pose(first))
        center = self.physics.contents.bodies[first].center
        goals = self.joints(first, second).goals
        return any(_pose_error(g, relative, center, _MATING_POSITION, _MATING_ANGLE) is not None for g in goals)

    def _join(self, first: int, second: int, merge: Merge) -> None:
        """Make one group of two, which has the key of the second one."""
        pose = self.physics.pose(second) * merge.furniture_from_v.inverse()
        whole = merge.merged.moved_to(pose)
        self.physics.join(first, second, self._body(whole), whole.world_from_furniture)
        self.groups.pop(first)
        self.groups[second] = whole
        self._posts.pop(first, None)
        self._posts.pop(second, None)


def _levelled(group: Group) -> Group:
    """Return a group turned so that the axis of its frame that points up but for a little does so exactly.

    Which post is best may depend on whether an approach is just below or just above an angle; a hand sets a group down
    a little askew.
    """
    turn = group.world_from_furniture.rotation
    up = UP_AXES[int(np.argmax(UP_AXES @ turn[2]))]
    if turn[2] @ up < _COSINE_ASKEW:
        return group
    return group.moved_to(SE3(align_axis(turn @ up, UP_AXES[0]) @ turn, group.world_from_furniture.translation))


@lru_cache(maxsize=2048)
def pieces_of_part(part: Part) -> tuple[Mesh, ...]:
    """Return the convex pieces of a part that hands and links touch."""
    frames = [hand_pose(g.position, g.closing, g.approaches[0]) for g in part.grasps]
    widths = [g.width + 2.0 * TOUCH for g in part.grasps]
    return convex_pieces(part.mesh, list(zip(frames, widths, strict=True)))


def _pose_error(
    planned: SE3, reached: SE3, center: Float[np.ndarray, "3"], position: float, angle: float
) -> tuple[float, float] | None:
    """Return distance and angle between two poses of a body, at its centre of mass; None if they exceed limits."""
    off = float(np.linalg.norm(reached.act(center) - planned.act(center)))
    if off > position:
        return None
    turn = rotation_angle(reached.rotation.T @ planned.rotation)
    return (off, turn) if turn <= angle else None
