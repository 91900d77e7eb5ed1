"""State of the workcell: groups on posts, two robots and their payloads; and motion segments between two states."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.geometry.scene import Body, Shape
from roboassembly.planning.robot_path import Configuration, Path
from roboassembly.planning.robot_shapes import WorldCache
from roboassembly.planning.robot_world import RobotWorld, Tally
from roboassembly.robots.body import DOF, placed, world_from_tips
from roboassembly.task.full.failure import Stage, stage_text
from roboassembly.task.full.grips import Grip, hand_shapes
from roboassembly.task.full.posts import Post
from roboassembly.task.rules.groups import Group, body


@dataclass(frozen=True, eq=False)
class PlacedGroup:
    """A group on its post."""

    group: Group
    post: Post


@dataclass(frozen=True, eq=False)
class Payload:
    """A group in a hand."""

    group: Group
    """Group whose `world_from_furniture` has no meaning: it moves with the hand."""
    grip: Grip

    def shapes(self, furniture: Furniture) -> tuple[Shape, ...]:
        """Return the group's parts in the frame of the finger tips."""
        tips = self.grip.furniture_from_tips
        return tuple(
            Shape(furniture.parts[p].mesh, tips.actInv(pose))
            for p, pose in zip(self.group.parts, self.group.furniture_from_part, strict=True)
        )

    def placed(self, configuration: Configuration) -> Group:
        """Return the group where it is when the robot has a configuration."""
        return self.group.moved_to(world_from_tips(configuration) * self.grip.furniture_from_tips.inverse())


@dataclass(frozen=True, eq=False)
class Robot:
    """State of one robot."""

    at: Configuration
    opening: float
    """Distance between the pads [m]."""
    payload: Payload | None = None

    def body(self, furniture: Furniture) -> Body:
        """Return the robot and its payload as one body that stands still."""
        tips = world_from_tips(self.at)
        links = [Shape(link.mesh, pose, convex=True) for link, pose in placed(self.at, self.opening)]
        load = [Shape(s.mesh, tips * s.body_from_mesh) for s in self.payload_shapes(furniture)]
        return Body("robot", (*links, *load), SE3.Identity())

    def payload_shapes(self, furniture: Furniture) -> tuple[Shape, ...]:
        """Return the parts in the hand, in the frame of the finger tips."""
        return () if self.payload is None else self.payload.shapes(furniture)


@dataclass(frozen=True, eq=False)
class CellState:
    """Poses of all groups, posts and robots at one time. Immutable: a segment leads to a new one."""

    placed: tuple[PlacedGroup, ...]
    robots: tuple[Robot, Robot]
    """R_a, R_b."""
    free_posts: tuple[Post, ...] = ()
    """Raised posts without a group."""
    on_floor: tuple[Group, ...] = ()
    """Groups that stand on the floor."""

    def around(self, furniture: Furniture, robot: int) -> list[Body]:
        """Return the obstacles of one robot."""
        obstacles = [body(furniture, p.group, f"group{i}") for i, p in enumerate(self.placed)]
        obstacles += [p.post.body(f"post{i}") for i, p in enumerate(self.placed)]
        obstacles += [post.body(f"free post{i}") for i, post in enumerate(self.free_posts)]
        obstacles += [body(furniture, group, f"on floor{i}") for i, group in enumerate(self.on_floor)]
        return [*obstacles, self.robots[1 - robot].body(furniture)]

    def world(
        self,
        furniture: Furniture,
        robot: int,
        lands: bool = False,
        tally: Tally | None = None,
        cache: WorldCache | None = None,
    ) -> RobotWorld:
        """Return the collision model of one robot and its payload among all else.

        Args:
            furniture: furniture of the groups.
            robot: 0 or 1.
            lands: whether the payload may touch the ground.
            tally: counts the tested configurations; a new one if None.
            cache: shapes of other worlds; none if None.
        """
        own = self.robots[robot]
        return RobotWorld(
            self.around(furniture, robot), own.opening, own.payload_shapes(furniture), lands, tally, cache
        )

    def moved(self, robot: int, at: Configuration) -> CellState:
        """Return the state with one robot elsewhere."""
        return self.with_robot(robot, replace(self.robots[robot], at=at))

    def with_robot(self, robot: int, new: Robot) -> CellState:
        """Return the state with another state of one robot."""
        a, b = self.robots
        return replace(self, robots=(new, b) if robot == 0 else (a, new))

    @property
    def supports(self) -> tuple[Post, ...]:
        """Posts of all places, those of placed groups first; two that rise together are one."""
        return (*(p.post for p in self.placed), *self.free_posts)

    @property
    def posts(self) -> tuple[Post, ...]:
        """All raised posts, each by itself."""
        return tuple(post for support in self.supports for post in support.each)

    def groups(self) -> list[Group]:
        """Return all groups where they are, those in hands last."""
        carried = [r.payload.placed(r.at) for r in self.robots if r.payload is not None]
        return [*(p.group for p in self.placed), *self.on_floor, *carried]


def world_cache(furniture: Furniture) -> WorldCache:
    """Return a cache for the worlds of one piece of furniture: around a robot are parts, posts and the other robot."""
    parts = [Shape(part.mesh, SE3.Identity()) for part in furniture.parts]
    posts = [shape for _ in parts for shape in Post(np.zeros(3)).body("").shapes]
    return WorldCache([*parts, *hand_shapes(0.0)], [*parts, *posts, *Robot(np.zeros(DOF), 0.0).body(furniture).shapes])


@dataclass(frozen=True, eq=False)
class Segment:
    """A motion of one robot while all else stands still."""

    stage: Stage
    robot: int
    """0 is R_a, 1 is R_b."""
    path: Path
    """Way-points; between two of them all ten numbers change linearly."""
    before: CellState
    """State at the beginning."""

    @property
    def name(self) -> str:
        """Robot and stage in words."""
        return stage_text(self.stage, self.robot)

    @property
    def after(self) -> CellState:
        """State at the end."""
        return self.before.moved(self.robot, self.path[-1])
