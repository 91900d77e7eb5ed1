"""State of the workcell: groups on posts, two robots and their payloads; and motion segments between two states."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.geometry.scene import Body, Shape
from roboassembly.planning.robot_path import Path
from roboassembly.planning.robot_world import RobotWorld
from roboassembly.robots.body import placed, world_from_tips
from roboassembly.task.full.cell import Post
from roboassembly.task.full.grips import Grip
from roboassembly.task.rules.groups import Group, body

Configuration = Float[np.ndarray, "10"]
"""`(x, y, angle)` of the platform, then the arm's seven; metres and radians."""


@dataclass(frozen=True, eq=False)
class PlacedGroup:
    """A group on its post."""

    group: Group
    post: Post


@dataclass(frozen=True, eq=False)
class Payload:
    """A group in a hand."""

    group: Group
    """Its `world_from_furniture` is of no account: it goes where the hand goes."""
    grip: Grip

    def shapes(self, furniture: Furniture) -> tuple[Shape, ...]:
        """Its parts, in the frame of the finger tips."""
        tips = self.grip.furniture_from_tips
        return tuple(
            Shape(furniture.parts[p].mesh, tips.actInv(pose))
            for p, pose in zip(self.group.parts, self.group.furniture_from_part, strict=True)
        )

    def placed(self, configuration: Configuration) -> Group:
        """The group where the hand has it."""
        return self.group.moved_to(world_from_tips(configuration) * self.grip.furniture_from_tips.inverse())


@dataclass(frozen=True, eq=False)
class Robot:
    """One of the two."""

    at: Configuration
    opening: float
    """Metres between the pads."""
    payload: Payload | None = None

    def body(self, furniture: Furniture) -> Body:
        """As something still."""
        tips = world_from_tips(self.at)
        links = [Shape(link.mesh, pose, convex=True) for link, pose in placed(self.at, self.opening)]
        load = [Shape(s.mesh, tips * s.body_from_mesh) for s in self.payload_shapes(furniture)]
        return Body("robot", (*links, *load), SE3.Identity())

    def payload_shapes(self, furniture: Furniture) -> tuple[Shape, ...]:
        """What is in its hand, in the frame of the finger tips."""
        return () if self.payload is None else self.payload.shapes(furniture)


@dataclass(frozen=True, eq=False)
class CellState:
    """All that is where it is. Immutable: a segment makes a new one."""

    placed: tuple[PlacedGroup, ...]
    robots: tuple[Robot, Robot]
    """R_a, R_b."""
    free_posts: tuple[Post, ...] = ()
    """Without anything on them."""
    on_floor: tuple[Group, ...] = ()
    """Groups that stand on the floor by themselves."""

    def around(self, furniture: Furniture, robot: int) -> list[Body]:
        """What is in one robot's way."""
        out = [body(furniture, s.group, f"group{i}") for i, s in enumerate(self.placed)]
        out += [s.post.body(f"post{i}") for i, s in enumerate(self.placed)]
        out += [stand.body(f"free post{i}") for i, stand in enumerate(self.free_posts)]
        out += [body(furniture, group, f"on floor{i}") for i, group in enumerate(self.on_floor)]
        return [*out, self.robots[1 - robot].body(furniture)]

    def world(self, furniture: Furniture, robot: int, lands: bool = False) -> RobotWorld:
        """The planning model of one robot, with what it holds, among all else.

        Args:
            furniture: what the groups are of.
            robot: 0 or 1.
            lands: whether what it holds may touch the ground.
        """
        own = self.robots[robot]
        return RobotWorld(self.around(furniture, robot), own.opening, own.payload_shapes(furniture), lands)

    def moved(self, robot: int, at: Configuration) -> CellState:
        """With one robot elsewhere."""
        return self.with_robot(robot, replace(self.robots[robot], at=at))

    def with_robot(self, robot: int, new: Robot) -> CellState:
        """With one robot's hand or place changed."""
        a, b = self.robots
        return replace(self, robots=(new, b) if robot == 0 else (a, new))

    @property
    def posts(self) -> tuple[Post, ...]:
        """Posts that are up."""
        return (*(s.post for s in self.placed), *self.free_posts)

    def groups(self) -> list[Group]:
        """All groups where they are, those in hands last."""
        held = [r.payload.placed(r.at) for r in self.robots if r.payload is not None]
        return [*(s.group for s in self.placed), *self.on_floor, *held]


@dataclass(frozen=True, eq=False)
class Segment:
    """One robot moves, all else stands still."""

    name: str
    """Such as `drive to u`, `mate`, `set down`."""
    robot: int
    """0 is R_a, 1 is R_b."""
    path: Path
    """Between two way-points joints and platform move evenly."""
    before: CellState
    """At its beginning."""

    @property
    def after(self) -> CellState:
        """At its end."""
        return self.before.moved(self.robot, self.path[-1])
