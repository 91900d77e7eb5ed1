"""Mating: two robots drive to where their groups mate, R_a brings its group in, lets go of it and leaves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, align_axis, turn_about_vertical
from roboassembly.geometry.scene import Shape
from roboassembly.planning.robot_path import Configuration, Path, line
from roboassembly.planning.robot_world import RobotWorld, Tally
from roboassembly.robots.kinematics import Poses
from roboassembly.robots.reach import nearness, reach
from roboassembly.task.full.cell_state import CellState, Payload, Robot
from roboassembly.task.full.failure import Failure, FullVerdict, Stage
from roboassembly.task.full.grips import MateGrasp, Retract, hand_shapes
from roboassembly.task.full.segments import (
    GUESSES,
    TUCKED,
    Planned,
    StepContext,
    child_seed,
    parking_path,
    retreat_path,
)
from roboassembly.task.rules.groups import Group, hull_points

_SPINS = 16
"""Turns of the merged group about the direction of the mating motion that are considered."""
_STEEP = 0.4
"""Sine of the angle of climb from which on a retract is not level: platforms drive level."""
_HEIGHTS = (0.45, 0.6, 0.75, 0.9)
"""Heights of the merged group's lowest point above the floor that are considered [m]."""
_POSES = 6
"""Poses of the merged group that are looked at, those first that both arms reach best."""
_STANCES_OF_B, _STANCES_OF_A = 3, 4
"""Configurations of each robot that are tried at a pose."""
_BEYOND = (0.4, 0.15, 0.0)
"""Distances [m] beyond the end of the retract from which R_a starts the mating motion, the first that is free: paths
end where there is room."""
_FAR = np.array([1e3, 0.0, 0.0, *TUCKED])
"""Configuration of a robot that is in nobody's way."""


@dataclass(frozen=True, eq=False)
class MateStance:
    """Configurations of both robots in which they mate two groups."""

    world_from_furniture: SE3
    """Pose of the merged group."""
    a: Configuration
    """R_a's configuration when the groups are mated."""
    b: Configuration
    out: Path
    """R_a's path straight out of the joint, with its group; reversed it is the mating motion."""
    back: Path
    """Path of R_a's empty hand, once the groups are mated."""


def mate_stances(
    context: StepContext, state: CellState, grasp: MateGrasp, seed: np.random.SeedSequence, tally: Tally
) -> Iterator[MateStance]:
    """Yield stances in which both hands hold the mated groups, R_a comes straight out, and so does its empty hand.

    The first stance of each pose comes before the second one of any: what is wrong with one often is with its like.

    Args:
        context: of the step.
        state: unchanged; only what stands in the cell counts, not where the robots are.
        grasp: both grips at the joint.
        seed: of all draws.
        tally: counts the tested configurations.
    """
    merged, (grip_a, grip_b) = grasp.merge.merged, grasp.merged_grips
    rest = replace(state, placed=tuple(p for p in state.placed if not set(p.group.parts) <= set(merged.parts)))
    payload_a, payload_b = (
        Payload(group, grip) for group, grip in zip(grasp.merged_groups, grasp.merged_grips, strict=True)
    )
    mated = rest.with_robot(0, Robot(_FAR, grip_a.closed, payload_a)).with_robot(
        1, Robot(_FAR, grip_b.closed, payload_b)
    )
    released = mated.with_robot(0, Robot(_FAR, grip_a.open)).with_robot(
        1, Robot(_FAR, grip_b.closed, Payload(merged, grip_b))
    )
    holding = [_holding(context, rest, grasp, robot, tally) for robot in (0, 1)]

    def at_pose(retract: Retract, pose: SE3, drawn: np.random.SeedSequence) -> Iterator[MateStance]:
        ends = list[Float[np.ndarray, "n 10"]]()
        for robot, grip in enumerate((grip_a, grip_b)):
            rng = np.random.default_rng(child_seed(drawn, robot))
            found = reach(pose * grip.furniture_from_tips, GUESSES, rng)
            ends.append(found[holding[robot].free(found)])
            if not len(ends[-1]):
                return
        a, b = ends
        # The farther R_b stands from where R_a would, the less they are in each other's way.
        distance = np.linalg.norm(b[:, None, :2] - a[None, :, :2], axis=2).mean(axis=1)
        for at_b in b[np.argsort(-distance)][:_STANCES_OF_B]:
            world = context.world(mated.moved(1, at_b), 0, tally)
            empty: RobotWorld | None = None
            order = np.argsort(-np.linalg.norm(a[:, :2] - at_b[:2], axis=1))
            for at_a in islice(world.each_free(a[order]), _STANCES_OF_A):
                empty = empty or context.world(released.moved(1, at_b), 0, tally)
                back = retreat_path(empty, at_a)
                if back is None:
                    continue
                out = _path_out(world, at_a, pose, retract)
                if out is not None:
                    yield MateStance(pose, at_a, at_b, out, back)

    poses = _mating_poses(context, grasp, child_seed(seed, 0))
    left = [at_pose(retract, pose, child_seed(seed, 1, i)) for i, (retract, pose) in enumerate(poses)]
    while left:
        for stances in tuple(left):
            stance = next(stances, None)
            if stance is None:
                left.remove(stances)
            else:
                yield stance


def drive_and_mate(
    context: StepContext, state: CellState, stance: MateStance, seed: np.random.SeedSequence
) -> Planned | Failure:
    """Plan to drive both robots, each with its group, to a stance, and to mate the groups.

    R_b drives first; if that fails, R_a does.

    Args:
        context: of the step.
        state: at the beginning; both groups are in the hands.
        stance: where to mate.
        seed: of all draws.
    """
    tally = Tally()
    goals = (stance.out[-1], stance.b)
    failure = Failure(FullVerdict.NO_PATH, Stage.DRIVE_TO_MATE)
    for order in ((1, 0), (0, 1)):
        done: Planned | None = Planned(state)
        for robot in order:
            world = context.world(done.state, robot, tally)
            path = context.connect(
                world, done.state.robots[robot].at, goals[robot][None], child_seed(seed, order[0], robot)
            )
            if path is None:
                failure, done = Failure(FullVerdict.NO_PATH, Stage.DRIVE_TO_MATE, robot), None
                break
            done = done.move(Stage.DRIVE_TO_MATE, robot, path)
        if done is not None:
            return replace(done.move(Stage.MATE, 0, tuple(reversed(stance.out))), states=tally.states)
    return replace(failure, states=tally.states)


def release(
    context: StepContext, state: CellState, stance: MateStance, grasp: MateGrasp, seed: np.random.SeedSequence
) -> Planned | Failure:
    """Plan R_a to open its hand, back off and drive away; R_b then holds the merged group alone.

    Args:
        context: of the step.
        state: right after the mating motion.
        stance: where the groups were mated.
        grasp: how they are held.
        seed: of all draws.
    """
    tally = Tally()
    a, b = state.robots
    grip_a, grip_b = grasp.merged_grips
    joined = state.with_robot(1, replace(b, payload=Payload(grasp.merge.merged, grip_b)))
    done = Planned(joined.with_robot(0, Robot(a.at, grip_a.open))).move(Stage.RELEASE, 0, stance.back)
    path = parking_path(context, context.world(done.state, 0, tally), done.state.robots[0].at, seed)
    if path is None:
        return Failure(FullVerdict.NO_PATH, Stage.LEAVE, 0, states=tally.states)
    return replace(done.move(Stage.LEAVE, 0, path), states=tally.states)


def _holding(context: StepContext, rest: CellState, grasp: MateGrasp, robot: int, tally: Tally) -> RobotWorld:
    """Return the collision model of one robot with all in its hand that is at the joint: both groups, the other hand.

    What is free in it depends on the pose of the joint, and not on where the other robot stands.
    """
    own, other = grasp.merged_grips[robot], grasp.merged_grips[1 - robot]
    tips = own.furniture_from_tips.inverse() * other.furniture_from_tips
    hand = [Shape(s.mesh, tips * s.body_from_mesh, s.convex) for s in hand_shapes(other.closed)]
    load = Payload(grasp.merge.merged, own).shapes(context.furniture)
    away = rest.with_robot(0, Robot(_FAR, 0.0)).with_robot(1, Robot(_FAR, 0.0))
    around = away.around(context.furniture, robot)
    return RobotWorld(around, own.closed, [*load, *hand], tally=tally, cache=context.worlds)


def _path_out(world: RobotWorld, at: Configuration, pose: SE3, retract: Retract) -> Path | None:
    """Return R_a's path out of a joint, longer than the retract if that is free; None if there is none.

    Args:
        world: R_a with its group, among all else.
        at: R_a's configuration at the joint.
        pose: pose of the merged group.
        retract: motion out of the joint.
    """
    path: Path = (at,)
    *before, last = retract.motions
    for motion in before:
        way = line(at, motion.length * (pose.rotation @ motion.direction))
        if way is None or not world.path_is_free(way):
            return None
        path, at = (*path, *way[1:]), way[-1]
    for beyond in _BEYOND:
        way = line(at, (last.length + beyond) * (pose.rotation @ last.direction))
        if way is not None and world.path_is_free(way):
            return (*path, *way[1:])
    return None


def _mating_poses(context: StepContext, grasp: MateGrasp, seed: np.random.SeedSequence) -> list[tuple[Retract, SE3]]:
    """Return poses of the merged group near the middle, with the retract level; the easiest for both arms first."""
    candidates = _level_poses(context.furniture, grasp.merge.merged, grasp.retracts)
    far = np.maximum(
        *(
            nearness(
                Poses(
                    np.array([p.rotation @ grip.furniture_from_tips.rotation for _, p in candidates]),
                    np.array([p.act(grip.furniture_from_tips.translation) for _, p in candidates]),
                )
            )
            for grip in grasp.merged_grips
        )
    )
    rng, poses = np.random.default_rng(seed), list[tuple[Retract, SE3]]()
    order: list[int] = np.argsort(far, kind="stable").tolist()
    for index in order[:_POSES]:
        retract, pose = candidates[index]
        spot = 0.3 * context.cell.radius * rng.uniform(-1.0, 1.0, 2)
        drawn = SE3(turn_about_vertical(rng.uniform(-np.pi, np.pi)), np.array([*spot, 0.0]))
        poses.append((retract, drawn * pose))
    return poses


def _level_poses(furniture: Furniture, merged: Group, retracts: Sequence[Retract]) -> list[tuple[Retract, SE3]]:
    """Return poses above the origin in which each retract begins along the world's x axis, and goes on about level."""
    points = hull_points(furniture, merged)
    poses: list[tuple[Retract, SE3]] = []
    about = align_axis(np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    for retract in retracts:
        level = align_axis(retract.motions[0].direction, np.array([1.0, 0.0, 0.0]))
        for spin in np.arange(_SPINS) * 2.0 * np.pi / _SPINS:
            turn = about @ turn_about_vertical(spin) @ about.T @ level
            if any(abs(float((turn @ motion.direction)[2])) > _STEEP for motion in retract.motions):
                continue
            turned = points @ turn.T
            low, high = turned.min(axis=0), turned.max(axis=0)
            for height in _HEIGHTS:
                shift = np.array([*(-0.5 * (low + high)[:2]), height - low[2]])
                poses.append((retract, SE3(turn, shift)))
    return poses
