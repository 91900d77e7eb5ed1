"""Physics under control: commands are followed, hands grip by contact, bodies weigh what they weigh."""

from __future__ import annotations

import numpy as np
import pytest

from roboassembly.geometry.poses import SE3
from roboassembly.geometry.scene import Shape
from roboassembly.robots.body import world_from_tips
from roboassembly.simulation.control_model import CellBody, CellContents, PhysicsScales
from roboassembly.simulation.control_physics import CONTROL_RATE, CellPhysics
from roboassembly.simulation.convex_pieces import convex_pieces
from roboassembly.task.full.segments import TUCKED
from shapes import brick, pose

A, B = np.array([0.0, 0.0, 0.0, *TUCKED]), np.array([3.0, 0.0, 0.0, *TUCKED])
BAR = brick(0.2, 0.03, 0.02)
MASS = 0.3


def cell(shift: float = 0.0, scales: PhysicsScales | None = None) -> CellPhysics:
    """A bar of 30 mm between the fingers of R_a, `shift` metres along their closing; R_b is far away."""
    where = world_from_tips(A) * pose(y=shift)
    bar = CellBody(MASS, np.zeros(3), MASS * 1e-3 * np.eye(3), (Shape(BAR, SE3.Identity()),))
    contents = CellContents({7: bar}, on_posts={7: where}, posts={7: (where.translation - [0.0, 0.0, 0.3],)})
    return CellPhysics([A, B], [0.05, 0.0], contents, scales)


def hold(physics: CellPhysics, opening: float, steps: int) -> None:
    for _ in range(steps):
        physics.advance(physics.commands, [opening, 0.0])


def gripped(scales: PhysicsScales | None = None) -> CellPhysics:
    physics = cell(scales=scales)
    for _ in range(20):
        hold(physics, 0.0, 1)
        if physics.pressed_body(0) is not None:
            physics.grip(0, 7)
            return physics
    pytest.fail("nothing gripped")


def test_commands_are_followed_to_a_millimetre() -> None:
    """A drive of 0.5 m with a joint that turns by 0.4 rad: a smooth path, sampled at 20 Hz."""
    physics, count = cell(shift=2.0), 40
    goal = A + np.array([0.5, 0.0, 0.3, 0.4, *np.zeros(6)])
    errors: list[float] = []
    for s in np.arange(1, count + 1) / count:
        share = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
        physics.advance(np.stack([A + share * (goal - A), B]), [0.05, 0.0])
        wanted = world_from_tips(physics.commands[0]).translation
        errors.append(float(np.linalg.norm(physics.tips(0).translation - wanted)))
    assert physics.seconds == pytest.approx(count / CONTROL_RATE)
    assert max(errors) < 5e-3
    for _ in range(6):
        physics.advance(physics.commands, [0.05, 0.0])
    np.testing.assert_allclose(physics.configuration(0), goal, atol=1e-3)
    np.testing.assert_allclose(physics.velocity(0), 0.0, atol=1e-3)
    assert not physics.touching


def test_a_hand_needs_both_pads() -> None:
    physics = gripped()
    left, right = physics.contact(0).forces
    # Ten times the weight of the bar on each finger.
    assert left == pytest.approx(10.0 * MASS * 9.81, rel=0.1)
    assert right == pytest.approx(left, rel=0.1)
    assert physics.opening(0) == pytest.approx(0.03, abs=1e-3)
    assert physics.holders(7) == (0,)
    assert physics.grasped(1) is None
    assert 7 not in physics.contents.posts

    empty = cell(shift=2.0)
    hold(empty, 0.0, 20)
    assert empty.contact(0) is None
    assert empty.pressed_body(0) is None
    assert empty.opening(0) < 1e-3

    beside = cell(shift=0.04)
    hold(beside, 0.0, 20)
    # The bar is outside of one finger: that one may touch it, the other does not.
    assert beside.pressed_body(0) is None


def test_what_is_held_comes_along_and_does_not_pull_the_arm_down() -> None:
    physics = gripped()
    before = physics.tips(0).actInv(physics.pose(7))
    for k in range(20):
        physics.advance(np.stack([A + np.array([0.0, 0.0, 0.02 * (k + 1), *np.zeros(7)]), B]), [0.0, 0.0])
    hold(physics, 0.0, 6)
    after = physics.tips(0).actInv(physics.pose(7))
    assert np.linalg.norm(after.translation - before.translation) < 2e-4
    wanted = world_from_tips(physics.commands[0]).translation
    assert np.linalg.norm(physics.tips(0).translation - wanted) < 1e-3


def test_what_is_let_go_of_falls_freely_and_what_stands_stays() -> None:
    physics = gripped()
    physics.release(0)
    start = physics.pose(7).translation[2]
    seconds = 0.1
    hold(physics, 0.08, round(seconds * CONTROL_RATE))
    fallen = start - physics.pose(7).translation[2]
    # The fingers brake it until they have opened.
    assert 0.2 * 0.5 * 9.81 * seconds**2 < fallen < 1.1 * 0.5 * 9.81 * seconds**2

    physics = gripped()
    physics.release(0)
    there = physics.pose(7)
    physics.stand(7, [there.translation - [0.0, 0.0, 0.011]])
    hold(physics, 0.08, 10)
    assert physics.pose(7).isApprox(there, 1e-9)
    assert physics.holders(7) == ()


def test_scales_multiply_stiffness_and_friction() -> None:
    """Half the stiffness is half the force at the same error; damping changes by the square root."""
    stiff, soft = cell(), cell(scales=PhysicsScales(stiffness=0.5, friction=0.25))
    ratio = soft.model.actuator_gainprm[:10, 0] / stiff.model.actuator_gainprm[:10, 0]
    np.testing.assert_allclose(ratio, 0.5)
    damping = soft.model.actuator_biasprm[:10, 2] / stiff.model.actuator_biasprm[:10, 2]
    np.testing.assert_allclose(damping, np.sqrt(0.5))
    np.testing.assert_allclose(soft.model.geom_friction, 0.25 * stiff.model.geom_friction)


def test_pieces_cover_the_solid_and_little_else() -> None:
    """A brick is its own piece; an L of two bricks is not its hull, which is 1.5 times as large."""
    assert len(convex_pieces(BAR)) == 1
    import trimesh

    from roboassembly.geometry.meshes import Mesh

    foot, back = trimesh.creation.box([0.4, 0.1, 0.1]), trimesh.creation.box([0.1, 0.1, 0.4])
    back.apply_translation([-0.15, 0.0, 0.15])
    angle = Mesh.from_trimesh(trimesh.boolean.union([foot, back], engine="manifold"))
    pieces = convex_pieces(angle)
    assert sum(piece.volume for piece in pieces) == pytest.approx(angle.volume, rel=0.05)
    assert angle.hull.volume > 1.4 * angle.volume
    # Around a grasp of the back is a piece of its own, 60 mm long.
    grasped = convex_pieces(angle, [(pose(x=-0.15, z=0.25), 0.1)])
    assert grasped[0].bounds[:, 2] == pytest.approx([0.22, 0.28])
    assert sum(piece.volume for piece in grasped) == pytest.approx(angle.volume, rel=0.05)
