"""Dynamic execution: actuated joints, gravity, fingers that press; states checked exactly, joints where they fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roboassembly.geometry.poses import SE3
from roboassembly.robots.body import world_from_tips
from roboassembly.robots.timing import TimedPath
from roboassembly.simulation.execution import StepPhysics
from roboassembly.simulation.mobile_arms import Load, between_pads
from roboassembly.solvers.options import grasping
from roboassembly.task.full.execution import JOINT_ANGLE, JOINT_POSITION, ExecutionVerdict, execute
from roboassembly.task.full.segments import TUCKED
from roboassembly.task.full.task import FullTask
from roboassembly.task.full.timing import GRASP_SECONDS, RELEASE_SECONDS, REST_SECONDS
from roboassembly.task.plans.full_plan import FullStep
from shapes import brick, pose

A, B = np.array([0.0, 0.0, 0.0, *TUCKED]), np.array([3.0, 0.0, 0.0, *TUCKED])


def held_bar(shift: float = 0.0, mass: float = 0.5) -> Load:
    """A bar of 30 mm between the fingers of R_a at `A`, `shift` metres along their closing."""
    tips = world_from_tips(A)
    bar = brick(0.2, 0.03, 0.02)
    where = tips * pose(y=shift)
    return Load(where, mass, np.zeros(3), mass * 1e-3 * np.eye(3), (between_pads(bar, SE3.Identity(), 0.03),))


def far_bar() -> Load:
    return replace(held_bar(), pose=pose(10.0, 0.0, 1.0))


def test_fingers_hold_only_parts_between_them() -> None:
    cell = StepPhysics([A, B], [0.05, 0.0], [held_bar(), far_bar()])
    assert cell.grasp(0, 0, GRASP_SECONDS)
    left, right = cell.pad_forces(0, 0)
    assert 20.0 < left < 60.0
    assert left == pytest.approx(right, rel=0.1)
    cell.follow(0, TimedPath([A, A + np.array([0.3, 0.0, 0.4, 0.2, *np.zeros(6)])]))
    got = cell.tips(0).actInv(cell.pose(0))
    assert np.linalg.norm(got.translation) < 1e-3
    assert max(cell.log.tracking) < 1e-3

    empty = StepPhysics([A, B], [0.05, 0.0], [replace(held_bar(), pose=pose(5.0, 0.0, 1.0)), far_bar()])
    assert not empty.grasp(0, 0, GRASP_SECONDS)


def test_unheld_parts_fall() -> None:
    cell = StepPhysics([A, B], [0.05, 0.0], [held_bar(), far_bar()])
    assert cell.grasp(0, 0, GRASP_SECONDS)
    before = cell.pose(0).translation[2]
    cell.release(0, 0.08, RELEASE_SECONDS)
    fell = before - cell.pose(0).translation[2]
    # 0.4 s of free fall, less what the fingers take to open.
    assert 0.2 < fell < 0.5 * 9.81 * 0.4**2 + 0.01


def test_a_heavy_load_does_not_pull_the_hand_down() -> None:
    cell = StepPhysics([A, B], [0.05, 0.0], [held_bar(mass=3.0), far_bar()])
    assert cell.grasp(0, 0, GRASP_SECONDS)
    cell.follow(0, TimedPath([A, A + np.array([0.5, *np.zeros(9)])]), REST_SECONDS)
    off = cell.tips(0).translation - world_from_tips(A + 0.5 * np.eye(10)[0]).translation
    assert np.linalg.norm(off) < 1e-3


@pytest.fixture(scope="module")
def merge(chair) -> tuple[FullTask, float, FullStep]:
    """A stretcher into a leg."""
    task = FullTask(chair("stool", 0))
    state = task.initial_state(np.random.default_rng(0))
    names = [p.name for p in task.furniture.parts]
    c = next(c for c in task.furniture.connections if "leg" in names[c.part_a] and "stretcher" in names[c.part_b])
    for action in grasping(task, state, state.groups, frozenset({c.part_b}), frozenset({c.part_a})):
        step = task.step(state, action, 0).step
        if step is not None:
            return task, state.cell.density, step
    pytest.fail("nothing merges")


def test_a_planned_step_is_carried_out(merge: tuple[FullTask, float, FullStep]) -> None:
    task, density, step = merge
    done = execute(task.furniture, density, step)
    assert (done.ending, done.segment) == (ExecutionVerdict.DONE, "")
    assert done.success
    assert 0.0 < done.joint_position < JOINT_POSITION
    assert done.joint_angle < JOINT_ANGLE
    assert done.tracking < 0.002
    assert 20.0 < done.pad_force < 60.0
    assert done.states > 500
    assert execute(task.furniture, density, step) == done


def test_a_path_through_something_fails(merge: tuple[FullTask, float, FullStep]) -> None:
    task, density, step = merge
    drive = step.segments[0]
    post = next(s.post.top for s in drive.before.placed)
    through = drive.path[0].copy()
    through[:2] = post[:2]
    bad = replace(drive, path=(drive.path[0], through, *drive.path[1:]))
    done = execute(task.furniture, density, replace(step, segments=(bad, *step.segments[1:])))
    assert (done.ending, done.segment) == (ExecutionVerdict.COLLISION, "R_a: drive to group")


def test_a_grasp_beside_the_part_fails(merge: tuple[FullTask, float, FullStep]) -> None:
    task, density, step = merge
    segments = list(step.segments)
    # R_a stops where the drive ended, 100 mm short of the part.
    segments[1] = replace(segments[1], path=segments[1].path[:1])
    done = execute(task.furniture, density, replace(step, segments=tuple(segments)))
    assert (done.ending, done.segment) == (ExecutionVerdict.NOT_GRASPED, "R_a: approach")
