"""Physics: the same scene as the planner's, things that fall come to rest where they should."""

from __future__ import annotations

from itertools import pairwise

import mujoco
import numpy as np
import pytest

import shapes
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import WOOD_DENSITY
from roboassembly.geometry.poses import SE3, pose_to_seven
from roboassembly.geometry.scene import Body, Scene, Shape
from roboassembly.planning.world import CollisionWorld
from roboassembly.simulation.model import compile_scene, mass_properties
from roboassembly.simulation.settle import MAX_SECONDS, settle
from shapes import HERE, Checker, mover, pose, still


def put(model: mujoco.MjModel, where: SE3) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:7] = pose_to_seven(where)
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize("seed", range(4))
def test_planning_and_physics_see_the_same_collisions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # Everything is about equally big: nothing fits wholly inside anything else.
    parts = [
        still(f"b{i}", shapes.brick(*rng.uniform(0.1, 0.2, size=3)), shapes.random_pose(rng, 0.25)) for i in range(3)
    ]
    parts.append(still("prism", shapes.prism(7, 0.08, 0.2, top=0.06), shapes.random_pose(rng, 0.25)))
    body = Body(
        "mover",
        (
            Shape(shapes.brick(0.15, 0.1, 0.12), pose(0.05)),
            Shape(shapes.prism(5, 0.07, 0.2), shapes.random_pose(rng, 0.1)),
        ),
        HERE,
        moves=True,
    )
    scene = Scene((*parts, body))
    world, checker, model = CollisionWorld(scene), Checker(scene), compile_scene(scene)
    outcomes = {True: 0, False: 0}
    for _ in range(120):
        where = shapes.random_pose(rng, 0.35)
        where.translation = where.translation + np.array([0, 0, 0.15])
        data = put(model, where)
        depth = min((c.dist for c in data.contact[: data.ncon]), default=np.inf)
        hit = not world.is_free(where)
        if abs(depth) < 1e-3 or (not hit and abs(world.lowest_point(where)) < 1e-3):
            continue
        if not hit and checker.distance(where) < 1e-3:
            continue
        outcomes[hit] += 1
        assert hit == (depth < 0), (depth, where)
    assert min(outcomes.values()) > 15


def test_bodies_and_joints_bear_the_scenes_names_and_poses() -> None:
    where = pose(1, 2, 3, shapes.turn((1, 1, 0), 0.7))
    model = compile_scene(
        Scene((still("wall", shapes.brick(1, 1, 1), pose(5)), mover(shapes.brick(0.1, 0.2, 0.3), where)))
    )
    data = mujoco.MjData(model)
    assert np.allclose(data.qpos, pose_to_seven(where))
    mujoco.mj_forward(model, data)
    assert np.allclose(data.body("mover").xpos, [1, 2, 3])
    assert np.allclose(data.body("wall").xpos, [5, 0, 0])
    assert model.joint("mover").type == mujoco.mjtJoint.mjJNT_FREE
    assert model.njnt == 1
    assert model.opt.gravity[2] < -9.7


def test_geoms_are_where_the_shapes_are() -> None:
    own = pose(0.3, -0.1, 0.2, shapes.turn((0, 1, 2), 1.1))
    mesh = shapes.l_shape(0.2)
    body = Body("mover", (Shape(mesh, own),), pose(0, 0, 1), moves=True)
    model = compile_scene(Scene((body,)))
    data = put(model, body.pose)
    # MuJoCo moves mesh frames to their own liking; its placed vertices must be the hull's.
    geom = model.geom("mover/0")
    start, count = model.mesh_vertadr[geom.dataid[0]], model.mesh_vertnum[geom.dataid[0]]
    placed = (
        model.mesh_vert[start : start + count] @ data.geom("mover/0").xmat.reshape(3, 3).T + data.geom("mover/0").xpos
    )
    expected = np.array([(body.pose * own).act(v) for v in mesh.hull_vertices])
    apart = np.linalg.norm(placed[:, None] - expected[None], axis=2)
    assert apart.min(axis=0).max() < 1e-5
    assert apart.min(axis=1).max() < 1e-5


def test_mass_and_inertia_of_two_boxes() -> None:
    """Parallel axes, by hand: a cube of 0.1 at the origin, another 0.4 further along x, turned about x."""
    cube = shapes.brick(0.1, 0.1, 0.1)
    far = pose(0.4, 0, 0, shapes.turn((1, 0, 0), 0.5))
    body = Body("pair", (Shape(cube, HERE), Shape(cube, far)), HERE, moves=True)
    mass, center, inertia = mass_properties(body)
    one = WOOD_DENSITY * 0.001
    assert mass == pytest.approx(2 * one, rel=1e-6)
    assert np.allclose(center, [0.2, 0, 0], atol=1e-9)
    own = one * 0.01 / 6
    assert np.allclose(
        inertia, np.diag([2 * own, 2 * (own + one * 0.04), 2 * (own + one * 0.04)]), rtol=1e-5, atol=1e-9
    )
    model = compile_scene(Scene((body,)))
    assert model.body("pair").mass[0] == pytest.approx(mass)
    assert sorted(model.body("pair").inertia) == pytest.approx(sorted(np.diag(inertia)), rel=1e-6)
    assert np.allclose(model.body("pair").ipos, center)


def test_mass_does_not_depend_on_how_a_body_is_cut() -> None:
    whole = Body("one", (Shape(shapes.box((0, 0, 0), (0.3, 0.1, 0.1)), HERE),), HERE, moves=True)
    turn = pose(0.3, 0.1, 0, shapes.turn((0, 0, 1), np.pi))
    cut = Body(
        "two",
        (Shape(shapes.box((0, 0, 0), (0.1, 0.1, 0.1)), HERE), Shape(shapes.box((0, 0, 0), (0.2, 0.1, 0.1)), turn)),
        HERE,
        moves=True,
    )
    for a, b in zip(mass_properties(whole), mass_properties(cut), strict=True):
        assert np.allclose(a, b, rtol=1e-5, atol=1e-9)


def heights(body: Body, where: SE3) -> np.ndarray:
    return np.concatenate([
        (s.mesh.vertices @ (where * s.body_from_mesh).rotation[2]) + (where * s.body_from_mesh).translation[2]
        for s in body.shapes
    ])  # fmt: skip


@pytest.mark.parametrize(
    ("turned", "height"),
    [
        (shapes.turn((1, 0, 0), 0.2), 0.1),
        (shapes.turn((0, 1, 0), 0.3), 0.1),
        (shapes.turn((1, 0, 0), np.pi / 2 + 0.2), 0.2),
    ],
)
def test_a_tilted_box_falls_flat(turned: np.ndarray, height: float) -> None:
    body = mover(shapes.brick(0.3, 0.2, 0.1), pose(0.5, 0.2, 0.3, turned))
    settled = settle(body, 0.05)
    assert settled.at_rest
    assert settled.seconds < MAX_SECONDS
    rest = settled.poses[-1]
    level = np.abs(rest.rotation[2])
    assert np.sort(level) == pytest.approx([0, 0, 1], abs=5e-3)
    assert heights(body, rest).max() == pytest.approx(height, abs=2e-3)
    assert heights(body, rest).min() == pytest.approx(0, abs=2e-3)
    assert np.allclose(settled.poses[0].homogeneous, body.pose.homogeneous)
    assert np.linalg.norm(rest.translation[:2] - [0.5, 0.2]) < 0.3


def test_a_box_past_its_edge_tips_over() -> None:
    """0.1 wide and 0.3 high, it stands at 18 degrees from the upright and falls beyond."""
    edge = np.arctan2(0.1, 0.3)
    for lean, upright in ((0.8 * edge, True), (1.2 * edge, False)):
        shape = shapes.brick(0.1, 0.2, 0.3)
        low = (shape.vertices @ shapes.turn((0, 1, 0), lean).T)[:, 2].min()
        settled = settle(mover(shape, pose(0, 0, 0.001 - low, shapes.turn((0, 1, 0), lean))), 0.05)
        assert settled.at_rest
        assert (abs(settled.poses[-1].rotation[2, 2]) > 0.99) == upright


def table_body(table: Furniture, where: SE3) -> Body:
    shapes_ = tuple(Shape(p.mesh, s) for p, s in zip(table.parts, table.assembled, strict=True))
    return Body("table", shapes_, where, moves=True)


@pytest.mark.parametrize("lean", [0.0, 0.15])
def test_a_table_comes_to_rest_on_its_feet(table: Furniture, lean: float) -> None:
    body = table_body(table, pose(0, 0, 0.08, shapes.turn((1, 0.3, 0), lean)))
    settled = settle(body, 0.05)
    assert settled.at_rest
    assert settled.poses[-1].rotation[2, 2] > 0.9999
    assert heights(body, settled.poses[-1]).min() == pytest.approx(0, abs=2e-3)
    assert settled.poses[-1].translation[2] == pytest.approx(0, abs=2e-3)


def test_settling_is_the_same_every_time(table: Furniture) -> None:
    body = table_body(table, pose(0, 0, 0.3, shapes.turn((1, 0.3, 0.2), 1.2)))
    one, two = settle(body, 0.05), settle(body, 0.05)
    assert len(one.poses) == len(two.poses)
    assert all(np.array_equal(a.homogeneous, b.homogeneous) for a, b in zip(one.poses, two.poses, strict=True))


def test_settling_is_sampled_evenly() -> None:
    settled = settle(mover(shapes.brick(0.1, 0.1, 0.1), pose(0, 0, 0.6)), 0.04)
    assert settled.seconds == pytest.approx(0.04 * (len(settled.poses) - 1))
    # Free fall: 0.55 m take a third of a second; the speed at which it starts is 0.
    drop = [0.6 - p.translation[2] for p in settled.poses]
    for k in range(1, 8):
        assert drop[k] == pytest.approx(9.81 * (0.04 * k) ** 2 / 2, rel=0.15)
    assert all(np.isfinite(p.homogeneous).all() for p in settled.poses)
    assert max(np.linalg.norm(b.translation - a.translation) for a, b in pairwise(settled.poses)) < 0.15


def test_a_round_leg_stops_rolling() -> None:
    settled = settle(mover(shapes.prism(24, 0.02, 0.4), pose(0, 0, 0.03, shapes.turn((1, 0, 0), np.pi / 2))), 0.05)
    assert settled.at_rest
    assert abs(settled.poses[-1].rotation[2, 2]) < 0.01


def test_thin_parts_compile() -> None:
    for thickness in (1e-3, 1e-4):
        settled = settle(mover(shapes.brick(0.4, 0.3, thickness), pose(0, 0, 0.05)), 0.05)
        assert settled.poses[-1].translation[2] == pytest.approx(thickness / 2, abs=2e-3)
