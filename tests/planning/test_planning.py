"""The planner held against an independent checker (python-fcl), and against problems with known answers."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import shapes
from roboassembly.errors import InputError
from roboassembly.geometry.poses import SE3, interpolate, poses_to_configurations
from roboassembly.geometry.scene import Body, Scene, Shape
from roboassembly.planning.mating import MatingProblem, plan_mating
from roboassembly.planning.problem import Budget, PathResult, PlanningStatus
from roboassembly.planning.rrt import rrt_connect, shortcut
from roboassembly.planning.world import ANGULAR_RESOLUTION, RESOLUTION, CollisionWorld, ExactChecks
from shapes import HERE, Checker, mover, pose, still

X, Y, Z = np.eye(3)
AXES = (Z, -Z, X, -X, Y, -Y)


def cluttered(seed: int, ground: bool = True) -> Scene:
    """An L-shaped mover of two shapes among random boxes."""
    rng = np.random.default_rng(seed)
    parts = [
        still(f"s{i}", shapes.brick(*rng.uniform(0.03, 0.3, size=3)), shapes.random_pose(rng, 0.25)) for i in range(5)
    ]
    body = Body(
        "mover",
        (Shape(shapes.l_shape(0.15), pose(0.02, 0, 0)), Shape(shapes.brick(0.2, 0.03, 0.03), pose(-0.1, 0, 0.05))),
        HERE,
        moves=True,
    )
    return Scene((*parts, body), ground=ground)


@pytest.mark.parametrize("seed", range(4))
def test_every_configuration_agrees_with_fcl(seed: int) -> None:
    scene = cluttered(seed)
    world, checker = CollisionWorld(scene), Checker(scene)
    rng = np.random.default_rng(seed + 100)
    poses = [shapes.random_pose(rng, 0.35) for _ in range(150)]
    poses = [SE3(p.rotation, p.translation + np.array([0, 0, 0.2])) for p in poses]
    truth = [checker.hits(p) for p in poses]
    assert 20 < sum(truth) < 140
    assert [not world.is_free(p) for p in poses] == truth
    assert world.states == len(poses)


def test_first_collision_is_the_first() -> None:
    world = CollisionWorld(
        Scene((still("wall", shapes.box((1, -1, -1), (1.1, 1, 1))), mover(shapes.brick(0.1, 0.1, 0.1))), ground=False)
    )
    row = poses_to_configurations([pose(x) for x in (0.0, 0.5, 0.94, 0.96, 0.0, 1.0)])
    assert world.first_collision(row) == 3
    assert world.states == 4
    assert world.first_collision(row[:, :3]) is None
    assert world.states == 7


def test_touching_the_ground_is_a_collision() -> None:
    scene = Scene((still("far", shapes.box((5, 5, 5), (6, 6, 6))), mover(shapes.brick(0.1, 0.1, 0.1))))
    world = CollisionWorld(scene)
    assert world.is_free(pose(z=0.0501))
    assert not world.is_free(pose(z=0.0499))
    assert not world.is_free(pose(z=-0.3))
    assert not world.edge_is_free(pose(z=0.2), pose(z=0.04))
    assert CollisionWorld(Scene(scene.bodies, ground=False)).is_free(pose(z=-0.3))


def test_empty_scene_is_free_everywhere() -> None:
    world = CollisionWorld(Scene((mover(shapes.brick(0.1, 0.1, 0.1)),), ground=False))
    assert world.edge_is_free(pose(z=5), pose(z=-5, rotation=shapes.turn(X, 2.0)))


@pytest.mark.parametrize("count", [0, 2])
def test_exactly_one_body_moves(count: int) -> None:
    with pytest.raises(InputError, match=f"{count} moving bodies; planning takes exactly one"):
        CollisionWorld(Scene(tuple(mover(shapes.brick(1, 1, 1)) for _ in range(count))))


@pytest.mark.parametrize("thickness", [0.0002, 0.001, 0.01])
@pytest.mark.parametrize("turned", [False, True])
def test_thin_wall_in_the_middle_of_a_long_edge_is_caught(thickness: float, turned: bool) -> None:
    wall = shapes.brick(thickness, 2, 2)
    rng = np.random.default_rng(1)
    for _ in range(10):
        where = pose(rng.uniform(0.5, 1.5), 0, 0)
        world = CollisionWorld(Scene((still("wall", wall, where), mover(shapes.brick(0.05, 0.05, 0.05))), ground=False))
        end = pose(2.0, 0.1, 0.1, shapes.turn((1, 1, 0), 0.5) if turned else None)
        fraction = world.free_fraction(HERE, end)
        # Free until the box's face is at the wall, and no farther.
        contact = (where.translation[0] - thickness / 2 - (0.025 if not turned else 0.05)) / 2
        assert 0 < fraction < 1
        assert fraction >= contact - 0.01
        assert fraction * 2 + 0.025 < where.translation[0] - thickness / 2
        assert not world.edge_is_free(HERE, end)
        assert not world.edge_is_free(end, HERE)


def test_thin_plate_smaller_than_the_body_is_caught() -> None:
    plate = shapes.brick(0.0005, 0.05, 0.05)
    rng = np.random.default_rng(0)
    for _ in range(30):
        where = pose(rng.uniform(0.5, 1.5), 0, 0)
        world = CollisionWorld(Scene((still("plate", plate, where), mover(shapes.brick(0.2, 0.2, 0.2))), ground=False))
        assert not world.edge_is_free(HERE, pose(2.0))


def test_a_body_around_another_is_in_collision() -> None:
    world = CollisionWorld(
        Scene((still("in", shapes.brick(0.05, 0.05, 0.05)), mover(shapes.brick(0.2, 0.2, 0.2))), ground=False)
    )
    assert not world.is_free(HERE)


@pytest.mark.parametrize("seed", [0, 2, 3, 7, *(pytest.param(s, marks=pytest.mark.slow) for s in (1, 4, 5, 6))])
def test_a_free_edge_is_free_at_a_quarter_millimetre(seed: int) -> None:
    """Whatever the box test and the coarse samples let pass: a finer, independent sampling finds (next to) nothing."""
    scene = cluttered(seed, ground=seed % 2 == 0)
    rng = np.random.default_rng(seed + 7)
    axes = Rotation.random(random_state=rng).as_matrix() if seed % 3 == 0 else None
    world, checker = CollisionWorld(scene, box_axes=axes), Checker(scene)
    free = blocked = 0
    while free < 6 or blocked < 3:
        start = shapes.random_pose(rng, 0.5)
        start.translation = start.translation + np.array([0, 0, 0.4])
        kind = rng.integers(3)
        end = SE3(
            start.rotation if kind == 0 else start.rotation @ Rotation.from_rotvec(rng.normal(size=3)).as_matrix(),
            start.translation + (0 if kind == 1 else rng.normal(scale=0.2, size=3)),
        )
        if checker.hits(start):
            continue
        fraction = world.free_fraction(start, end)
        if fraction == 1.0:
            free += 1
            states = shapes.sampled([start, end], 0.0005, world.radius)
            # Between exact tests a corner may graze by less than the resolution, for as short a while.
            hits = [i for i, p in enumerate(states) if checker.hits(p)]
            assert len(hits) <= 4, (seed, len(hits), len(states))
        else:
            blocked += 1
            states = shapes.sampled([start, end], RESOLUTION / 4, world.radius)
            assert any(checker.hits(p) for p in states)
            # What counts as the free fraction is free, and the next step is not.
            first = next(i for i, p in enumerate(states) if checker.hits(p)) / (len(states) - 1)
            length = (
                np.linalg.norm(end.translation - start.translation)
                + world.radius * Rotation.from_matrix(start.rotation.T @ end.rotation).magnitude()
            )
            assert abs(fraction - first) * length < 2 * RESOLUTION or fraction < first


def test_box_test_never_misses_a_collision() -> None:
    """Stretches that no exact test looked at are free at 0.25 mm, without exception."""
    checked = 0
    for seed in range(12):
        scene = cluttered(seed)
        world, checker = CollisionWorld(scene), Checker(scene)
        rng = np.random.default_rng(seed)
        for _ in range(8):
            start = shapes.random_pose(rng, 0.6)
            turn = start.rotation if rng.random() < 0.7 else Rotation.random(random_state=rng).as_matrix()
            end = SE3(turn, start.translation + rng.normal(scale=0.3, size=3))
            angle = float(Rotation.from_matrix(start.rotation.T @ end.rotation).magnitude())
            cuts = np.linspace(0, 1, 9)
            flags = world.boxes_free(start, end, cuts, angle)
            for k in np.flatnonzero(flags):
                states = interpolate(start, end, np.linspace(cuts[k], cuts[k + 1], 60))
                checked += 1
                assert not any(checker.hits(SE3(Rotation.from_quat(s[3:]).as_matrix(), s[:3].copy())) for s in states.T)
    assert checked > 100


def test_states_are_counted() -> None:
    wall = still("wall", shapes.box((1, -1, -1), (1.1, 1, 1)))
    world = CollisionWorld(Scene((wall, mover(shapes.brick(0.1, 0.1, 0.1))), ground=False))
    assert world.edge_is_free(HERE, pose(0.0, 3.0, 0.0))  # parallel to the wall: one box
    assert world.states == 1
    assert world.edge_is_free(HERE, HERE)
    assert world.states == 1
    world.states = 0
    assert world.free_fraction(HERE, pose(0.9)) == 1.0
    assert world.states == 1
    assert world.free_fraction(HERE, pose(1.0)) < 1.0
    # One whole box, 34 stretches, and exact tests of the last stretches, at 2 mm, until the hit at 0.95 m.
    assert 36 < world.states - 1 < 36 + 34
    world.states = 0
    world.is_free(HERE)
    assert world.states == 1


def test_resolution_of_exact_tests() -> None:
    """No two neighbouring samples differ by more than 2 mm of the fastest point, nor by more than a degree."""
    scene = Scene(
        (still("around", shapes.box((-1, -1, -1), (1, 1, 1))), mover(shapes.brick(0.4, 0.01, 0.01))), ground=False
    )
    seen: list[np.ndarray] = []

    class Spy(CollisionWorld):
        def first_collision(self, configurations: np.ndarray) -> int | None:
            seen.append(configurations)
            return super().first_collision(configurations)

    world = Spy(scene)
    start, end = HERE, pose(0.1, 0.05, 0.0, shapes.turn((0, 1, 1), 1.5))
    assert world.edge_is_free(start, end)  # inside the hollow surface nothing is touched, and every box overlaps
    states = np.concatenate([poses_to_configurations([start]), *seen], axis=1)
    points = np.array([s.reshape(1, 3) for s in world.points])[:, 0]
    turns = Rotation.from_quat(states[3:].T)
    placed = np.einsum("nij,pj->npi", turns.as_matrix(), points) + states[:3].T[:, None]
    assert np.linalg.norm(np.diff(placed, axis=0), axis=2).max() <= RESOLUTION + 1e-9
    assert (turns[1:] * turns[:-1].inv()).magnitude().max() <= ANGULAR_RESOLUTION + 1e-9
    assert np.allclose(states[:3, -1], end.translation)


def test_distance_to_clear() -> None:
    wall, other = shapes.box((-0.5, -0.5, 0), (0.5, 0.5, 0.2)), shapes.box((3, 3, 0), (4, 4, 1))
    scene = Scene((still("wall", wall), still("other", other), mover(shapes.brick(0.1, 0.1, 0.1), pose(0.3, 0, 0.1))))
    world = CollisionWorld(scene)
    here = pose(0.3, 0, 0.1)
    assert world.distance_to_clear(here, X, "wall") == pytest.approx(0.25, abs=1e-6)
    assert world.distance_to_clear(here, -X, "wall") == pytest.approx(0.85, abs=1e-6)
    assert world.distance_to_clear(here, Z, "wall") == pytest.approx(0.15, abs=1e-6)
    diagonal = (X + Z) / np.sqrt(2)
    assert world.distance_to_clear(here, diagonal, "wall") == pytest.approx(0.15 * np.sqrt(2), abs=1e-6)
    assert world.distance_to_clear(here, X, "nobody") == 0.0
    # Free to rise from there on: the wall reaches above the body's lower side until it is past it or over it ...
    assert world.distance_to_clear(here, X, "wall", Z) == pytest.approx(0.25, abs=1e-6)
    assert world.distance_to_clear(here, diagonal, "wall", Z) == pytest.approx(0.15 * np.sqrt(2), abs=1e-6)
    # ... and stays above what goes below it.
    assert world.distance_to_clear(here, -diagonal, "wall", Z) == pytest.approx(0.85 * np.sqrt(2), abs=1e-6)
    beneath, above = pose(0.3, 0, -0.1), pose(0.3, 0, 0.3)
    assert world.distance_to_clear(beneath, X, "wall") == 0.0
    assert world.distance_to_clear(beneath, X, "wall", Z) == pytest.approx(0.25, abs=1e-6)
    assert world.distance_to_clear(above, X, "wall", Z) == 0.0
    assert world.top == pytest.approx(1.0)
    assert world.lowest_point(here) == pytest.approx(0.05)
    assert world.radius == pytest.approx(0.05 * np.sqrt(3))


# Mating


def mating(scene: Scene, goal: SE3, budget: Budget | None = None, seed: int = 0, retreats: tuple = AXES) -> PathResult:
    body = next(b for b in scene.bodies if b.moves)
    result = plan_mating(
        CollisionWorld(scene), MatingProblem(body.pose, goal, "partner", tuple(retreats)), budget or Budget(), seed
    )
    assert result.states > 0
    assert result.seconds >= 0.0
    assert result.solved == (result.status is PlanningStatus.SOLVED)
    if result.solved:
        assert np.allclose(result.path[0].homogeneous, body.pose.homogeneous, atol=1e-9)
        assert np.allclose(result.path[-1].homogeneous, goal.homogeneous, atol=1e-9)
        assert not Checker(scene).path_hits(result.path, 0.001)
    else:
        assert result.path == ()
    return result


@cache
def socket() -> tuple:
    c = 0.0005
    return shapes.of_solid(
        shapes.block((-0.1, -0.1, 0.002), (0.1, 0.1, 0.1))
        - shapes.block((-0.02 - c, -0.02 - c, 0.05), (0.02 + c, 0.02 + c, 1))
    )


PEG = (0.04, 0.04, 0.2)
IN_SOCKET = pose(0, 0, 0.05 + 0.0005 + 0.1)


def test_peg_goes_into_its_hole_along_the_axis() -> None:
    scene = Scene(
        (still("partner", socket()), mover(shapes.brick(*PEG), pose(0.5, 0.3, 0.05, shapes.turn(X, np.pi / 2))))
    )
    result = mating(scene, IN_SOCKET, Budget(states=0))
    assert result.solved
    assert result.planner == "retreat"
    last = result.path[-1].translation - result.path[-2].translation
    assert np.allclose(last[:2], 0, atol=1e-9)
    assert last[2] < -0.049


def test_tilted_peg_and_hole() -> None:
    """The axis alone leads out; up and the level directions do not."""
    for tilt in (0.05, 0.3):
        tilted = pose(0, 0, 0.05, shapes.turn(Y, tilt))
        scene = Scene(
            (
                still("partner", socket(), tilted),
                mover(shapes.brick(*PEG), pose(0.6, 0, 0.05, shapes.turn(X, np.pi / 2))),
            )
        )
        axis = tilted.rotation[:, 2]
        result = mating(scene, tilted * IN_SOCKET, Budget(states=0), retreats=(axis, *AXES))
        assert result.solved
        step = result.path[-2].translation - result.path[-1].translation
        assert step @ axis > 0.999 * np.linalg.norm(step)


def test_slightly_tilted_peg_and_hole() -> None:
    tilted = pose(0, 0, 0.05, shapes.turn(Y, 0.035))
    scene = Scene(
        (still("partner", socket(), tilted), mover(shapes.brick(*PEG), pose(0.6, 0, 0.05, shapes.turn(X, np.pi / 2))))
    )
    assert mating(scene, tilted * IN_SOCKET, Budget(states=0), retreats=(tilted.rotation[:, 2], *AXES)).solved


def test_a_rail_rises_along_slanted_walls() -> None:
    """A low partner, and slanted walls of 0.3 m on both sides: the rail rises along the slant only."""
    tilted = pose(0, 0, 0.05, shapes.turn(Y, 0.06))
    walls = [
        still(f"wall{side}", shapes.brick(0.02, 0.2, 0.3), tilted * pose(0.0605 * side, 0, 0.15)) for side in (1, -1)
    ]
    partner = still("partner", shapes.brick(0.09, 0.1, 0.01), tilted * pose(0, 0, 0.005))
    scene = Scene((partner, *walls, mover(shapes.brick(0.1, 0.1, 0.04), pose(0.6, 0, 0.05))))
    axis = tilted.rotation[:, 2]
    result = mating(scene, tilted * pose(0, 0, 0.0305), Budget(states=0), retreats=(axis, *AXES))
    assert result.solved
    assert result.planner == "retreat"
    step = result.path[-2].translation - result.path[-1].translation
    assert step @ axis > 0.999 * np.linalg.norm(step)
    assert np.linalg.norm(step) > 0.25


def test_goal_in_collision() -> None:
    scene = Scene((still("partner", socket()), mover(shapes.brick(*PEG), pose(0.5, 0, 0.15))))
    result = mating(scene, pose(0.01, 0, 0.1505))
    assert result.status is PlanningStatus.GOAL_IN_COLLISION
    assert mating(scene, pose(0.5, 0, 0.05)).status is PlanningStatus.GOAL_IN_COLLISION  # in the ground


def test_start_in_collision() -> None:
    scene = Scene(
        (
            still("partner", socket()),
            still("other", shapes.box((0.4, -1, 0), (0.5, 1, 0.1))),
            mover(shapes.brick(*PEG), pose(0.5, 0, 0.15)),
        )
    )
    assert mating(scene, IN_SOCKET).status is PlanningStatus.START_IN_COLLISION


def test_unreachable_between_two_plates() -> None:
    """A bone: thick ends on either side of a closed hole, with next to no room."""
    c = 0.0005
    bone = shapes.of_solid(
        shapes.block((-0.05, -0.05, -0.1), (0.05, 0.05, -0.02))
        + shapes.block((-0.02, -0.02, -0.1), (0.02, 0.02, 0.1))
        + shapes.block((-0.05, -0.05, 0.02), (0.05, 0.05, 0.1))
    )
    plate = shapes.of_solid(
        shapes.block((-0.2, -0.2, -0.02 + c), (0.2, 0.2, 0.02 - c))
        - shapes.block((-0.02 - c, -0.02 - c, -1), (0.02 + c, 0.02 + c, 1))
    )
    scene = Scene((still("partner", plate, pose(z=0.3)), mover(bone, pose(0.6, 0, 0.11))))
    result = mating(scene, pose(z=0.3))
    assert result.status is PlanningStatus.UNREACHABLE
    assert result.states < 5_000


def cage() -> Scene:
    """A box with a window in its lid, and a bar that is longer than the window: it has to come in upright, and turn."""
    hollow = shapes.block((-0.2, -0.2, 0.002), (0.2, 0.2, 0.4)) - shapes.block((-0.18, -0.18, 0.02), (0.18, 0.18, 0.38))
    hollow -= shapes.block((-0.11, -0.11, 0.3), (0.11, 0.11, 0.5))
    return Scene((still("partner", shapes.of_solid(hollow)), mover(shapes.brick(0.28, 0.03, 0.03), pose(0.6, 0, 0.02))))


IN_CAGE = pose(0, 0, 0.15)


def test_rrt_connect_solves_without_a_straight_retreat() -> None:
    result = mating(cage(), IN_CAGE, Budget(states=60_000))
    assert result.solved
    assert result.planner == "rrt-connect"
    assert mating(cage(), IN_CAGE, Budget(states=0)).status is PlanningStatus.BUDGET_EXHAUSTED


def same(a: PathResult, b: PathResult) -> bool:
    return (
        a.status == b.status
        and a.states == b.states
        and len(a.path) == len(b.path)
        and all(np.array_equal(p.homogeneous, q.homogeneous) for p, q in zip(a.path, b.path, strict=True))
    )


def test_the_same_seed_gives_the_same_path() -> None:
    results = [mating(cage(), IN_CAGE, Budget(states=60_000), seed) for seed in (1, 2, 1, 2)]
    assert all(r.solved for r in results)
    assert same(results[0], results[2])
    assert same(results[1], results[3])
    assert not same(results[0], results[1])


def test_global_random_state_neither_matters_nor_changes() -> None:
    np.random.seed(3)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    one = mating(cage(), IN_CAGE, Budget(states=60_000))
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002
    np.random.seed(4)  # noqa: NPY002
    assert same(one, mating(cage(), IN_CAGE, Budget(states=60_000)))


@pytest.mark.parametrize("states", [100, 1_000, 5_000])
def test_budget_in_states_is_kept(states: int) -> None:
    closed = shapes.block((-0.2, -0.2, 0.002), (0.2, 0.2, 0.4)) - shapes.block((-0.18, -0.18, 0.02), (0.18, 0.18, 0.38))
    scene = Scene(
        (still("partner", shapes.of_solid(closed)), mover(shapes.brick(0.28, 0.03, 0.03), pose(0.6, 0, 0.02)))
    )
    retreats = mating(scene, IN_CAGE, Budget(states=0)).states
    result = mating(scene, IN_CAGE, Budget(states=states))
    assert result.status is PlanningStatus.BUDGET_EXHAUSTED
    # Retreats are tried in any case; the last edge is finished.
    assert result.states < max(states, retreats) + 500


def test_budget_in_seconds_is_kept() -> None:
    closed = shapes.block((-0.2, -0.2, 0.002), (0.2, 0.2, 0.4)) - shapes.block((-0.18, -0.18, 0.02), (0.18, 0.18, 0.38))
    scene = Scene(
        (still("partner", shapes.of_solid(closed)), mover(shapes.brick(0.28, 0.03, 0.03), pose(0.6, 0, 0.02)))
    )
    result = mating(scene, IN_CAGE, Budget(states=10**9, seconds=0.3))
    assert result.status is PlanningStatus.BUDGET_EXHAUSTED
    assert result.seconds < 3.0


def test_start_equals_goal() -> None:
    """Start and goal are one, with and without a straight way out."""
    free = Scene((still("partner", socket()), mover(shapes.brick(*PEG), IN_SOCKET)))
    assert mating(free, IN_SOCKET).solved
    caught = Scene((cage().bodies[0], mover(shapes.brick(0.28, 0.03, 0.03), IN_CAGE)))
    assert mating(caught, IN_CAGE, Budget(states=5_000)).status in (
        PlanningStatus.SOLVED,
        PlanningStatus.BUDGET_EXHAUSTED,
    )


def test_hook_comes_out_in_two_straight_moves() -> None:
    """An L hooked under a bar: aside first, then up."""
    hook = shapes.of_solid(
        shapes.block((0, -0.02, 0.0), (0.02, 0.02, 0.3)) + shapes.block((-0.06, -0.02, 0.0), (0.02, 0.02, 0.02))
    )
    frame = shapes.of_solid(
        shapes.block((-0.045, -0.2, 0.03), (-0.005, 0.2, 0.06))
        + shapes.block((-0.2, -0.2, 0.002), (-0.15, 0.2, 0.06))
        + shapes.block((-0.2, -0.2, 0.03), (-0.005, -0.16, 0.06))
    )
    scene = Scene((still("partner", frame), mover(hook, pose(0.5, 0, 0.01))))
    result = mating(scene, pose(z=0.008), Budget(states=0))
    assert result.solved
    assert result.planner == "retreat"


def test_a_key_slides_out_and_on_from_under_a_roof() -> None:
    """Out of its hole after 10 cm, but a wide roof is above; it can only rise 40 cm farther on."""
    c = 0.0005
    frame = shapes.of_solid(
        shapes.block((-0.5, -0.3, 0.002), (0.0, 0.3, 0.1))
        - shapes.block((-0.1, -0.02 - c, 0.04 - c), (1, 0.02 + c, 0.08 + c))
        + shapes.block((-0.5, -0.3, 0.0), (-0.4, 0.3, 0.6))
        + shapes.block((-0.5, -0.3, 0.5), (0.4, 0.3, 0.6))
    )
    key = shapes.brick(0.1, 0.04, 0.04)
    scene = Scene((still("partner", frame), mover(key, pose(1.0, 0, 0.03))))
    # To the left it could rise sooner, but there is no way.
    result = mating(scene, pose(-0.05 + c, 0, 0.06), Budget(states=0), retreats=(X, Y, -Y))
    assert result.solved
    assert result.planner == "retreat"


def test_rrt_ends_at_one_of_its_goals() -> None:
    scene = cage()
    world = CollisionWorld(scene)
    start = pose(0.6, 0, 0.6)
    goals = [IN_CAGE, pose(-0.6, 0, 0.1)]
    bounds = np.array([[-1.0, -1, 0], [1, 1, 1]])
    path = rrt_connect(world, start, goals, bounds, Budget(states=60_000), 0)
    assert path is not None
    assert np.allclose(path[0].homogeneous, start.homogeneous, atol=1e-9)
    assert min(np.abs(path[-1].homogeneous - g.homogeneous).max() for g in goals) < 1e-9
    checker = Checker(scene)
    assert not checker.path_hits(path, 0.001)
    short = shortcut(path, world.edge_is_free, 0, 40)
    assert len(short) <= len(path)
    assert np.array_equal(short[0].homogeneous, path[0].homogeneous)
    assert np.array_equal(short[-1].homogeneous, path[-1].homogeneous)
    assert not checker.path_hits(short, 0.001)


def test_shortcut_removes_needless_waypoints() -> None:
    world = CollisionWorld(Scene((still("far", shapes.box((5, 5, 5), (6, 6, 6))), mover(shapes.brick(0.1, 0.1, 0.1)))))
    zigzag = [pose(x, (-1) ** i * 0.2, 0.5) for i, x in enumerate(np.linspace(0, 1, 8))]
    assert len(shortcut(zigzag, world.edge_is_free, 0, 40)) == 2


def test_exact_tests_among_many_shapes_leave_out_none_in_the_way() -> None:
    """Of more than 20 still shapes only near ones are part of a test; the answers are those with all of them."""
    rng = np.random.default_rng(3)
    others = [still(f"p{i}", shapes.brick(0.1, 0.1, 0.1), shapes.random_pose(rng, 2.0)) for i in range(60)]
    scene = Scene((mover(shapes.brick(0.2, 0.1, 0.05)), *others))
    world, whole = CollisionWorld(scene, box_axes=shapes.turn((1, 2, 3), 0.4)), ExactChecks(scene)
    hits = 0
    for _ in range(200):
        poses = poses_to_configurations([shapes.random_pose(rng, 2.0) for _ in range(rng.integers(1, 4))])
        found = world.first_collision(poses)
        assert found == whole.first_collision(poses)
        hits += found is not None
    assert 20 < hits < 180
    assert world.states == whole.states
