"""Plans the legs of a full step: fetch, meet, let go, drive away, set down.

Each is planned on exact geometry: the robot with what it holds, all else as obstacles. Way-points of the hand that
have to be straight (approach, lift, mate, back off) are lines in space; in between RRT-Connect finds the way.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture
from roboassembly.planning.problem import Budget
from roboassembly.planning.robot_path import Floor, Path, connect, line, path_is_free, turned_on
from roboassembly.planning.robot_world import RobotWorld
from roboassembly.poses import SE3, align_axis, turn_about_vertical
from roboassembly.robots.body import world_from_tips
from roboassembly.robots.kinematics import Poses
from roboassembly.robots.reach import nearness, reach
from roboassembly.task.cell import Cell, Stand, free_place, on_post, open_grasps, reach_from
from roboassembly.task.groups import Group, hull_points
from roboassembly.task.joining import Hold, Way
from roboassembly.task.layout import group_footprint
from roboassembly.task.moments import Configuration, Grip, Leg, Moment, Robot, Standing
from roboassembly.task.rules import UP_AXES

TUCKED = np.array([0.0, -1.2, 0.0, -2.6, 0.0, 2.0, 0.785])
"""The arm folded over the platform, to drive."""
_GUESSES = 64
"""Arm configurations looked for at a pose of the hand."""
_TRIES = 12
"""Of them handed to the planner, the nearest first."""
_LIFT = 0.06
"""Metres that a group rises straight from its post before anything else, and sinks onto it."""
_BACK = 0.10
"""Metres that an open hand comes and goes straight."""
_SPINS = 16
"""Turns about the way into a joint in which two groups may meet."""
_HEIGHTS = (0.45, 0.6, 0.75, 0.9)
"""Metres above the floor of the lowest point of two groups that meet."""
_MEETINGS = 6
"""Poses to meet in that are looked at, those that both arms reach best first."""
_PLACES_OF_B, _PLACES_OF_A = 3, 4
"""Ways to stand at a meeting that are tried."""
_PARKINGS = 12
"""Places to drive to afterwards that are tried."""
_OUTWARD = (1.0, 1.15, 1.3)
"""Where a merged group may stand: as far from the middle as a post of before, or farther by so much."""


class Obstacle(StrEnum):
    """Why a leg cannot be."""

    NO_ARM_SOLUTION = "no_arm_solution"
    """No way to stand that has the hand where it must be without a collision."""
    NO_PATH = "no_path"
    NO_STAND = "no_stand"
    """No post can hold the merged group, or there is no room for it."""


class LegError(Exception):
    """A leg cannot be planned."""

    def __init__(self, why: Obstacle, leg: str) -> None:
        super().__init__(f"{leg}: {why}")
        self.why, self.leg = why, leg


@dataclass(frozen=True, eq=False)
class Meeting:
    """How two robots stand when they join two groups."""

    world_from_furniture: SE3
    """Of the merged group."""
    a: Configuration
    b: Configuration
    out: Path
    """R_a's, out of the joint."""


@dataclass(eq=False)
class _Taking:
    """A robot takes a standing group."""

    before: Moment
    """Its hand open."""
    loaded: Moment
    """The group in its hand, the post still there."""
    world: RobotWorld
    """As it comes."""
    tries: Iterator[tuple[Path, Path]]
    """Straight back from the group, and straight up with it."""
    failed: str
    """The leg that the last try failed in."""


class LegPlanner:
    """Plans the legs of one step, one after the other, and keeps them.

    Args:
        furniture: what is assembled.
        cell: where.
        moment: at the beginning.
        budget: of each path.
        rng: draws.
    """

    def __init__(
        self, furniture: Furniture, cell: Cell, moment: Moment, budget: Budget, rng: np.random.Generator
    ) -> None:
        self.furniture, self.cell, self.moment, self.budget, self.rng = furniture, cell, moment, budget, rng
        self.legs: list[Leg] = []
        self._worlds: list[RobotWorld] = []

    @property
    def states(self) -> int:
        """Configurations tested for collision so far."""
        return sum(w.states for w in self._worlds)

    @property
    def reached(self) -> tuple[Moment, tuple[Leg, ...]]:
        """How far it is, to come `back_to`."""
        return self.moment, tuple(self.legs)

    def back_to(self, reached: tuple[Moment, tuple[Leg, ...]]) -> None:
        """Take back the legs planned since then."""
        self.moment, self.legs = reached[0], list(reached[1])

    def world(self, moment: Moment, robot: int) -> RobotWorld:
        """One robot among all else."""
        made = moment.world(self.furniture, robot)
        self._worlds.append(made)
        return made

    def _go(self, world: RobotWorld, start: Configuration, goal: Configuration) -> Path | None:
        seed = int(self.rng.integers(2**31 - 1))
        return connect(world, start, goal, Floor(self.cell.floor), self.budget, seed)

    def _add(self, name: str, robot: int, path: Path) -> None:
        path = turned_on(path, self.moment.robots[robot].at)
        leg = Leg(name, robot, path, self.moment)
        self.legs.append(leg)
        self.moment = leg.after

    def fetch(self, robot: int, index: int, hold: Hold, name: str) -> None:
        """Drive to a standing group, take it and lift it from its post, which sinks into the floor.

        Args:
            robot: 0 or 1.
            index: among `moment.standing`.
            hold: of the group.
            name: of the group, for the legs.

        Raises:
            LegError: it cannot be.
        """
        taking = self._taking(robot, index, hold, name)
        before, loaded = taking.before, taking.loaded
        for back, up in taking.tries:
            way = self._go(taking.world, before.robots[robot].at, back[-1])
            if way is None:
                taking.failed = f"drive to {name}"
                continue
            self.moment = before
            self._add(f"drive to {name}", robot, way)
            self._add(f"approach {name}", robot, tuple(reversed(back)))
            self.moment = loaded.moved(robot, self.moment.robots[robot].at)
            self._add(f"lift {name}", robot, up)
            self.moment = replace(self.moment, posts=before.posts)
            return
        raise LegError(Obstacle.NO_PATH, taking.failed)

    def can_take(self, robot: int, index: int, hold: Hold) -> bool:
        """Whether a standing group can be taken and lifted, wherever the robot comes from; as `fetch`."""
        try:
            return next(self._taking(robot, index, hold, "").tries, None) is not None
        except LegError:
            return False

    def _taking(self, robot: int, index: int, hold: Hold, name: str) -> _Taking:
        """Ways to take a standing group and lift it, `fetch` without the drive.

        Raises:
            LegError: there is no way to stand (from the first of the tries).
        """
        before = self.moment.with_robot(robot, replace(self.moment.robots[robot], opening=hold.open, grip=None))
        group, stand = self.moment.standing[index].group, self.moment.standing[index].stand
        rest = tuple(s for i, s in enumerate(before.standing) if i != index)
        taken = Robot(before.robots[robot].at, hold.closed, Grip(group, hold))
        loaded = replace(before, standing=rest, posts=(*before.posts, stand)).with_robot(robot, taken)
        tips = group.world_from_furniture * hold.furniture_from_tips
        world, lifting = self.world(before, robot), self.world(loaded, robot)

        def tries() -> Iterator[tuple[Path, Path]]:
            for at in self._ways_to_stand(world, tips, before.robots[robot].at, f"grasp {name}"):
                back = line(at, -_BACK * tips.rotation[:, 2])
                if back is None or not path_is_free(world, back):
                    taking.failed = f"approach {name}"
                    continue
                up = line(at, np.array([0.0, 0.0, _LIFT]))
                if up is None or not path_is_free(lifting, up):
                    taking.failed = f"lift {name}"
                    continue
                yield back, up

        taking = _Taking(before, loaded, world, tries(), f"grasp {name}")
        return taking

    def _ways_to_stand(self, world: RobotWorld, tips: SE3, near: Configuration, leg: str) -> Iterator[Configuration]:
        """Free configurations with the finger tips there, the nearest first.

        Raises:
            LegError: there is none.
        """
        found = reach(tips, _GUESSES, self.rng).configurations
        free = found[world.free(found)] if len(found) else found
        if not len(free):
            raise LegError(Obstacle.NO_ARM_SOLUTION, leg)
        order = np.argsort(np.linalg.norm(free[:, :2] - near[:2], axis=1))
        return iter(free[order[:_TRIES]])

    def meetings(
        self, hold_a: Hold, hold_b: Hold, u: Group, v: Group, ways: Sequence[Way], merged: Group
    ) -> Iterator[Meeting]:
        """Ways to stand in which both hands, each with its group, have them joined, and R_a comes straight out.

        Args:
            hold_a: of u's group, in the merged group's frame.
            hold_b: of v's group, in the merged group's frame.
            u: in the merged group's frame.
            v: in the merged group's frame.
            ways: straight out of the joint.
            merged: both.
        """
        rest = replace(self.moment, standing=tuple(s for s in self.moment.standing if not _is_in(s.group, merged)))
        grip_a, grip_b = Grip(u, hold_a), Grip(v, hold_b)
        far = np.array([1e3, 0.0, 0.0, *TUCKED])
        absent = rest.with_robot(0, Robot(far, hold_a.closed, grip_a)).with_robot(1, Robot(far, hold_b.closed, grip_b))
        world_a, world_b = self.world(absent, 0), self.world(absent, 1)
        for way, pose in self._poses_to_meet(hold_a, hold_b, ways, merged):
            b = reach(pose * hold_b.furniture_from_tips, _GUESSES, self.rng).configurations
            a = reach(pose * hold_a.furniture_from_tips, _GUESSES, self.rng).configurations
            b, a = (q[w.free(q)] if len(q) else q for q, w in ((b, world_b), (a, world_a)))
            if not len(a) or not len(b):
                continue
            # The farther R_b stands from where R_a would, the less they are in each other's way.
            apart = np.linalg.norm(b[:, None, :2] - a[None, :, :2], axis=2).mean(axis=1)
            for at_b in b[np.argsort(-apart)[:_PLACES_OF_B]]:
                world = self.world(absent.moved(1, at_b), 0)
                free = a[world.free(a)]
                order = np.argsort(-np.linalg.norm(free[:, :2] - at_b[:2], axis=1))
                for at_a in free[order[:_PLACES_OF_A]]:
                    out = line(at_a, way.length * (pose.rotation @ way.direction))
                    if out is not None and path_is_free(world, out):
                        yield Meeting(pose, at_a, at_b, out)

    def _poses_to_meet(
        self, hold_a: Hold, hold_b: Hold, ways: Sequence[Way], merged: Group
    ) -> Iterator[tuple[Way, SE3]]:
        """Poses of the merged group, near the middle, with the way out level, those that suit both arms best first."""
        points = hull_points(self.furniture, merged)
        some: list[tuple[Way, SE3]] = []
        about = align_axis(np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
        for way in ways:
            level = align_axis(way.direction, np.array([1.0, 0.0, 0.0]))
            for spin in np.arange(_SPINS) * 2.0 * np.pi / _SPINS:
                turn = about @ turn_about_vertical(spin) @ about.T @ level
                turned = points @ turn.T
                low, high = turned.min(axis=0), turned.max(axis=0)
                for height in _HEIGHTS:
                    shift = np.array([*(-0.5 * (low + high)[:2]), height - low[2]])
                    some.append((way, SE3(turn, shift)))
        far = np.maximum(
            *(
                nearness(
                    Poses(
                        np.array([p.rotation @ h.furniture_from_tips.rotation for _, p in some]),
                        np.array([p.act(h.furniture_from_tips.translation) for _, p in some]),
                    )
                )
                for h in (hold_a, hold_b)
            )
        )
        for index in np.argsort(far, kind="stable")[:_MEETINGS]:
            way, pose = some[index]
            spot = 0.3 * self.cell.radius * self.rng.uniform(-1.0, 1.0, 2)
            drawn = SE3(turn_about_vertical(self.rng.uniform(-np.pi, np.pi)), np.array([*spot, 0.0]))
            yield way, drawn * pose

    def join(self, meeting: Meeting) -> bool:
        """Drive both robots to a meeting and mate; False, and nothing is changed, if there is no way."""
        drives = ((1, meeting.b, "drive v"), (0, meeting.out[-1], "drive u"))
        before = self.reached
        for order in (drives, drives[::-1]):
            for robot, goal, name in order:
                way = self._go(self.world(self.moment, robot), self.moment.robots[robot].at, goal)
                if way is None:
                    break
                self._add(name, robot, way)
            else:
                self._add("mate", 0, tuple(reversed(meeting.out)))
                return True
            self.back_to(before)
        return False

    def part(self, merged: Group, hold_a: Hold, hold_b: Hold) -> None:
        """R_a opens its hand, backs off and drives away; R_b holds the merged group.

        Args:
            merged: both groups.
            hold_a: of it.
            hold_b: of it.

        Raises:
            LegError: it cannot be.
        """
        a, b = self.moment.robots
        self.moment = self.moment.with_robot(1, replace(b, grip=Grip(merged, hold_b)))
        self.moment = self.moment.with_robot(0, Robot(a.at, hold_a.open))
        world = self.world(self.moment, 0)
        back = self._back(world, a.at)
        if back is None:
            raise LegError(Obstacle.NO_PATH, "back off from u")
        self._add("back off from u", 0, back)
        self.park(0, world, "leave u")

    def _back(self, world: RobotWorld, at: Configuration) -> Path | None:
        """Straight back out of a grasp, driving or from where the platform stands."""
        for drive in (True, False):
            back = line(at, -_BACK * world_from_tips(at).rotation[:, 2], drive=drive)
            if back is not None and path_is_free(world, back):
                return back
        return None

    def park(self, robot: int, world: RobotWorld, name: str) -> None:
        """Fold the arm and drive to a free place near the middle.

        Raises:
            LegError: there is no way.
        """
        for _ in range(_PARKINGS):
            spot = 0.7 * self.cell.radius * self.rng.uniform(-1.0, 1.0, 2)
            goal = np.array([*spot, self.rng.uniform(-np.pi, np.pi), *TUCKED])
            if not world.free(goal[None])[0]:
                continue
            path = self._go(world, self.moment.robots[robot].at, goal)
            if path is not None:
                self._add(name, robot, path)
                return
        raise LegError(Obstacle.NO_PATH, name)

    def set_down(self, wanted: Sequence[Float[np.ndarray, "2"]]) -> None:
        """R_b sets what it holds on a post that rises for it, and drives away.

        Args:
            wanted: places in the ring that are free.

        Raises:
            LegError: it cannot be.
        """
        robot = self.moment.robots[1]
        assert robot.grip is not None
        grip = robot.grip
        failed = LegError(Obstacle.NO_STAND, "set down")
        carrying = self.world(self.moment, 1)
        for standing in self._places(grip.group, robot.at, wanted):
            tips = standing.group.world_from_furniture * grip.hold.furniture_from_tips
            with_post = replace(self.moment, posts=(*self.moment.posts, standing.stand))
            after = replace(self.moment, standing=(*self.moment.standing, standing))
            after = after.with_robot(1, Robot(robot.at, grip.hold.open))
            lowering, leaving = self.world(with_post, 1), self.world(after, 1)
            try:
                some = self._ways_to_stand(lowering, tips, robot.at, "set down")
            except LegError as none:
                failed = none
                continue
            failed = LegError(Obstacle.NO_PATH, "set down")
            for at in some:
                above = line(at, np.array([0.0, 0.0, _LIFT]))
                if above is None or not path_is_free(lowering, above):
                    continue
                back = self._back(leaving, at)
                if back is None:
                    continue
                path = self._go(carrying, robot.at, above[-1])
                if path is None:
                    continue
                self._add("carry", 1, path)
                self.moment = replace(self.moment, posts=with_post.posts)
                self._add("set down", 1, tuple(reversed(above)))
                self.moment = after.moved(1, self.moment.robots[1].at)
                self._add("back off", 1, back)
                self.park(1, leaving, "leave")
                return
        raise failed

    def _places(
        self, merged: Group, near: Configuration, wanted: Sequence[Float[np.ndarray, "2"]]
    ) -> Iterator[Standing]:
        """Ways for the merged group to stand on a post, each axis up once, those first that leave most grasps open;
        finished furniture upright if it can."""
        taken = [group_footprint(self.furniture, s.group) for s in self.moment.standing]
        order = np.argsort([np.linalg.norm(p - near[:2]) for p in wanted])
        places = [wanted[o] * f for f in _OUTWARD for o in order]
        found: list[tuple[float, Group, Stand]] = []
        for w in self.rng.permutation(len(UP_AXES)):
            turn = turn_about_vertical(self.rng.uniform(-np.pi, np.pi)) @ align_axis(UP_AXES[w], UP_AXES[0])
            held = on_post(self.furniture, merged.moved_to(SE3(turn, np.zeros(3))), np.zeros(2))
            if held is not None:
                upright = w == 0 and len(merged.parts) == len(self.furniture.parts)
                found.append((float(upright) + open_grasps(self.furniture, *held), *held))
        for _, group, stand in sorted(found, key=lambda item: -item[0]):
            place = free_place(places, reach_from(self.furniture, group, stand), taken)
            if place is None:
                continue
            shift = np.array([*place, 0.0])
            moved = SE3(np.eye(3), shift) * group.world_from_furniture
            yield Standing(group.moved_to(moved), Stand(stand.top + shift))


def _is_in(group: Group, merged: Group) -> bool:
    return set(group.parts) <= set(merged.parts)
