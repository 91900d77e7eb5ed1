"""Where all is in the workcell at one moment: groups on posts, two robots, what they hold; and the legs in between."""

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
from roboassembly.task.full.cell import Stand
from roboassembly.task.full.grips import Hold
from roboassembly.task.rules.groups import Group, body

Configuration = Float[np.ndarray, "10"]
"""`(x, y, angle)` of the platform, then the arm's seven; metres and radians."""


@dataclass(frozen=True, eq=False)
class Standing:
    """A group on its post."""

    group: Group
    stand: Stand


@dataclass(frozen=True, eq=False)
class Grip:
    """A group in a hand."""

    group: Group
    """Its `world_from_furniture` is of no account: it goes where the hand goes."""
    hold: Hold

    def shapes(self, furniture: Furniture) -> tuple[Shape, ...]:
        """Its parts, in the frame of the finger tips."""
        tips = self.hold.furniture_from_tips
        return tuple(
            Shape(furniture.parts[p].mesh, tips.actInv(pose))
            for p, pose in zip(self.group.parts, self.group.furniture_from_part, strict=True)
        )

    def placed(self, configuration: Configuration) -> Group:
        """The group where the hand has it."""
        return self.group.moved_to(world_from_tips(configuration) * self.hold.furniture_from_tips.inverse())


@dataclass(frozen=True, eq=False)
class Robot:
    """One of the two."""

    at: Configuration
    opening: float
    """Metres between the pads."""
    grip: Grip | None = None

    def body(self, furniture: Furniture) -> Body:
        """As something still."""
        tips = world_from_tips(self.at)
        links = [Shape(link.mesh, pose, convex=True) for link, pose in placed(self.at, self.opening)]
        load = [Shape(s.mesh, tips * s.body_from_mesh) for s in self.held(furniture)]
        return Body("robot", (*links, *load), SE3.Identity())

    def held(self, furniture: Furniture) -> tuple[Shape, ...]:
        """What is in its hand, in the frame of the finger tips."""
        return () if self.grip is None else self.grip.shapes(furniture)


@dataclass(frozen=True, eq=False)
class Moment:
    """All that is where it is. Immutable: a leg makes a new one."""

    standing: tuple[Standing, ...]
    robots: tuple[Robot, Robot]
    """R_a, R_b."""
    posts: tuple[Stand, ...] = ()
    """Without anything on them."""
    on_floor: tuple[Group, ...] = ()
    """Groups that stand on the floor by themselves."""

    def around(self, furniture: Furniture, robot: int) -> list[Body]:
        """What is in one robot's way."""
        out = [body(furniture, s.group, f"group{i}") for i, s in enumerate(self.standing)]
        out += [s.stand.body(f"post{i}") for i, s in enumerate(self.standing)]
        out += [stand.body(f"free post{i}") for i, stand in enumerate(self.posts)]
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
        return RobotWorld(self.around(furniture, robot), own.opening, own.held(furniture), lands)

    def moved(self, robot: int, at: Configuration) -> Moment:
        """With one robot elsewhere."""
        return self.with_robot(robot, replace(self.robots[robot], at=at))

    def with_robot(self, robot: int, new: Robot) -> Moment:
        """With one robot's hand or place changed."""
        a, b = self.robots
        return replace(self, robots=(new, b) if robot == 0 else (a, new))

    @property
    def stands(self) -> tuple[Stand, ...]:
        """Posts that are up."""
        return (*(s.stand for s in self.standing), *self.posts)

    def groups(self) -> list[Group]:
        """All groups where they are, those in hands last."""
        held = [r.grip.placed(r.at) for r in self.robots if r.grip is not None]
        return [*(s.group for s in self.standing), *self.on_floor, *held]


@dataclass(frozen=True, eq=False)
class Leg:
    """One robot moves, all else stands still."""

    name: str
    """Such as `drive to u`, `mate`, `set down`."""
    robot: int
    """0 is R_a, 1 is R_b."""
    path: Path
    """Between two way-points joints and platform move evenly."""
    moment: Moment
    """At its beginning."""

    @property
    def after(self) -> Moment:
        """At its end."""
        return self.moment.moved(self.robot, self.path[-1])
