"""Hands as the relational policy sees them: clearances against exact geometry, lessons of grasps, play with robots."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

import shapes
from roboassembly.datasets import catalogue
from roboassembly.envs.full import FullEnv
from roboassembly.envs.observation import Observer, surface_points
from roboassembly.errors import InputError
from roboassembly.evaluation.rollout import RolloutConfig, make_agent
from roboassembly.furniture.model import MAX_POINTS, Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.learning import checkpoint
from roboassembly.learning.datasets import dataset_file, group_labels
from roboassembly.learning.registry import load_policy
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.clearance import PartGrasps
from roboassembly.learning.relational.grasps import network as grasping
from roboassembly.learning.relational.grasps.dataset import NO, UNKNOWN, YES, GraspLabeler, GraspSamples
from roboassembly.learning.relational.grasps.features import (
    PAIR_FEATURES,
    SINGLE_FEATURES,
    GraspFeatures,
    grasp_features,
)
from roboassembly.learning.relational.grasps.on_policy import collect_on_policy, label_outcome, probe_grasps
from roboassembly.learning.relational.oracle_dataset import Labeler
from roboassembly.learning.relational.policy import GRASP_PARAMS, RelationalPolicy
from roboassembly.learning.relational.policy_view import PolicyView
from roboassembly.learning.relational.tokens import TokenCache, tokens_of_sample
from roboassembly.solvers.hand_oracle import HandOracle
from roboassembly.solvers.options import fitting
from roboassembly.task.full.failure import PICKING, FullVerdict
from roboassembly.task.full.grips import MateGrasp, can_grip, grip_of
from roboassembly.task.full.task import FullTask
from roboassembly.task.rules.connections import GRASPS
from roboassembly.task.rules.groups import Group, TaskState

COMING = [0, 1]
"""Columns of `GraspFeatures.single`: clearance of the approaching gripper to its part and the rest of its group."""
AT_OTHER = 5
"""Column of `GraspFeatures.single`: clearance of the closed gripper to the mated other group."""


def view_of(furniture: Furniture, state: TaskState, cloud_points: int = 2048) -> PolicyView:
    """What a policy is told, without paddings."""
    n = len(furniture.parts)
    seen = Observer(furniture, n, MAX_POINTS, cloud_points).observe(state)
    free = FullTask(furniture).rules.free_points(state)[:n]
    connections = seen["connections"].astype(float)
    return PolicyView(
        seen["shapes"].astype(float), seen["connection_points"].astype(float), connections, free,
        group_labels(connections), seen["grasp_regions"].reshape(n, GRASPS, 6).astype(float),
        seen["poses"].astype(float),
    )  # fmt: skip


def apart(furniture: Furniture, rng: np.random.Generator) -> TaskState:
    """Every part alone, anywhere and anyhow."""
    return TaskState(
        tuple(
            Group((i,), (i,), (a,), shapes.random_pose(rng, 2.0) * a.inverse())
            for i, a in enumerate(furniture.assembled)
        )
    )


@pytest.fixture(scope="module")
def post_on_board() -> Furniture:
    """A bar upright in the middle of a board: a hand that comes to the bar's lower end from above meets nothing but
    the board, 60 mm below its grasp; one that holds the board's edge is far from the bar."""
    return shapes.furniture(
        "post",
        {
            "board": shapes.box((-0.3, -0.3, 0.0), (0.3, 0.3, 0.02)),
            "bar": shapes.box((-0.02, -0.02, 0.02 + shapes.GAP), (0.02, 0.02, 0.32)),
        },
    )


def test_clearances_are_those_of_the_geometry(post_on_board: Furniture) -> None:
    seen = grasp_features(view_of(post_on_board, apart(post_on_board, np.random.default_rng(0))), 1, 0, 0, 0)
    assert seen.single.shape == (2, GRASPS, SINGLE_FEATURES)
    assert seen.pair.shape == (GRASPS, GRASPS, PAIR_FEATURES)
    assert seen.exists.all() == all(len(p.grasps) == 2 for p in post_on_board.parts)
    bar, board = post_on_board.parts[1], post_on_board.assembled[0]
    for g, (region, direction) in enumerate((r, d) for r in bar.grasps for d in r.approaches):
        # Joined, the hand's lowest point is above the board by: the grasp's height less what the hand reaches down.
        at = post_on_board.assembled[1].act(region.position)
        down = post_on_board.assembled[1].rotation @ direction
        assert board.translation[2] == pytest.approx(0.01)
        if abs(down[2]) < 0.1:
            # It comes from the side, its widest body is the palm: 63 mm to the sides, 20 mm along the fingers' breadth.
            assert (seen.single[0, g, AT_OTHER] < 1.0) == (at[2] - 0.02 < 0.07), (g, at, down)


def test_hands_that_the_own_group_blocks_are_seen_to_be_blocked() -> None:
    furniture = catalogue.make("ladder", 3)
    *parts, last = range(len(furniture.parts))
    # All but one part joined, that one far away.
    whole = Group(tuple(parts), tuple(parts), furniture.assembled[:last], SE3.Identity())
    alone = Group((last,), (last,), (furniture.assembled[last],), shapes.pose(x=3.0))
    told = view_of(furniture, TaskState((whole, alone)))
    seen, free = [], []
    for part in parts:
        handling = grasp_features(told, part, 0, last, 0)
        for g in range(GRASPS):
            held = grip_of(furniture, whole, part, g)
            assert (held is not None) == handling.exists[g].any()
            if held is not None:
                seen.append(handling.single[0, g, COMING].min())
                free.append(can_grip(furniture, whole, held))
    seen, free = np.array(seen), np.array(free)
    assert 0.1 < free.mean() < 0.9
    # Clouds have gaps: told apart for nearly all.
    assert ((seen > 0.0) == free).mean() > 0.95


def test_hands_that_their_own_part_blocks_are_seen_to_be_blocked() -> None:
    seen, free = [], []
    for family in ("rocker", "windsor", "cantilever"):
        furniture = catalogue.make(family, 3)
        state = apart(furniture, np.random.default_rng(0))
        told = view_of(furniture, state)
        for u, group in enumerate(state.groups):
            handling = grasp_features(told, u, 0, (u + 1) % len(furniture.parts), 0)
            for g in np.flatnonzero(handling.exists.any(axis=1)).tolist():
                held = grip_of(furniture, group, u, g)
                assert held is not None
                seen.append(handling.single[0, g, COMING].min())
                free.append(can_grip(furniture, group, held))
    seen, free = np.array(seen), np.array(free)
    # A hand has to come with a millimetre to spare on each side; columns are in shares of 50 mm.
    assert (~free).sum() > 2
    assert (seen[~free] < 1.5 / 50.0).all()
    assert (seen[free] > 1.5 / 50.0).mean() > 0.9


def test_where_things_lie_does_not_matter_but_for_what_is_up(post_on_board: Furniture) -> None:
    rng = np.random.default_rng(0)
    state = apart(post_on_board, rng)
    turn = SE3(shapes.turn((0.0, 0.0, 1.0), 1.0), np.array([0.4, -0.3, 0.0]))
    moved = TaskState(tuple(g.moved_to(turn * g.world_from_furniture) for g in state.groups))
    a, b = (grasp_features(view_of(post_on_board, s), 1, 0, 0, 0) for s in (state, moved))
    np.testing.assert_allclose(a.single, b.single, atol=1e-4)
    np.testing.assert_allclose(a.pair, b.pair, atol=1e-4)


def test_hand_oracle_says_what_the_task_says() -> None:
    task = FullTask(catalogue.make("stool", 3))
    oracle = HandOracle(task)
    rng = np.random.default_rng(0)
    state = task.initial_state(rng).groups
    joints = oracle.mates(state)
    assert any(j.viable for j in joints)
    for index in rng.permutation(len(joints))[:12]:
        joint = joints[index]
        pairs = [((joint.u, joint.k), (joint.v, joint.l))]
        found = next(fitting(task, state, pairs), None)
        if found is not None:
            assert joint.feasible_w.all()
            assert isinstance(task.mate_grasp(state, found), MateGrasp)
        if not joint.feasible_w.any():
            assert found is None
        assert joint.feasible_w.all() == joint.feasible_w.any()
    # What a play of good pairs leads to is never without a good pair.
    clouds = np.array([surface_points(p.mesh, 32) for p in task.furniture.parts], np.float32)
    play = Labeler(task.furniture, clouds, oracle).rollout(rng)
    assert len(play.states) == len(task.furniture.parts) - 1


def test_pairs_without_room_for_hands_cannot_be_joined() -> None:
    task = FullTask(catalogue.make("panel", 13))
    clouds = np.array([surface_points(p.mesh, 2048) for p in task.furniture.parts], np.float32)
    teacher = Labeler(task.furniture, clouds, HandOracle(task))
    memory, rng = TokenCache(), np.random.default_rng(0)
    plays = [teacher.rollout(rng) for _ in range(3)]
    joined, tight = 0, 0
    for lesson in (lesson for play in plays for lesson in (*play.states, *play.dead_ends)):
        tokens = tokens_of_sample(teacher.sample_set(()), lesson, memory)
        assert tokens.clearance is not None
        index = np.full(lesson.free.shape, -1)
        index[tokens.part, tokens.point] = np.arange(len(tokens.part))
        best: dict[tuple[int, int], tuple[float, bool]] = {}
        for u, k, v, l, _, *ways in lesson.mates.tolist():  # noqa: E741
            row, column = index[u, k], index[v, l]
            room = float(min(tokens.clearance[row, column, 0], tokens.clearance[column, row, 0]))
            groups = int(tokens.group[row]), int(tokens.group[column])
            before, joins = best.get(groups, (-1.0, False))
            best[groups] = max(before, room), joins or any(ways)
        joined += sum(joins for _, joins in best.values())
        # Boxes are somewhat larger than a hand: two millimetres, at a scale of ten.
        tight += sum(room < -0.2 for room, _ in best.values())
        assert not any(joins for room, joins in best.values() if room < -0.2)
    assert joined > 10
    assert tight > 0


def test_room_by_hand() -> None:
    """One hand, its tips 0.1 m up and pointing down at a rod that is 20 mm wide; things come from the side."""
    poses = np.zeros((GRASPS, 6))
    poses[2] = 0.0, 0.0, 0.1, np.pi, 0.0, 0.0
    rod = np.array([[x, y, 0.1] for x in np.linspace(-0.1, 0.1, 41) for y in (-0.01, 0.01)])
    grasps = PartGrasps(poses, rod, np.zeros((0, 3)), np.eye(3), np.zeros(3))
    assert grasps.placed.exists.tolist() == [g == 2 for g in range(GRASPS)]
    assert grasps.placed.opening[2] == pytest.approx(0.02)
    seen = grasps.features(np.array([0.1, 0.0, 0.1]), np.eye(3))
    assert not seen[[0, 1, 3, 4, 5, 6, 7]].any()
    # 0.1 m from the point, times four; coming down; closing across.
    np.testing.assert_allclose(seen[2, :9], [-0.4, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0], atol=2e-3)
    joints, nowhere = np.tile(np.eye(3), (2, 1, 1)), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    # A point 20 mm above the tips lies between the fingers, one 80 mm above in the palm; from a metre off neither does.
    for height, blocked in ((0.12, False), (0.18, True), (0.05, False)):
        told = grasps.mate_clearance(joints, nowhere, np.array([[0.0, 0.0, height]]))
        assert (told[0, 2] < 0.0) == blocked, height
        assert told[1, 2] > 0.99


@pytest.fixture(scope="module")
def course() -> GraspSamples:
    return GraspLabeler(FullTask(shapes.stand()), tries=1).collect(np.random.default_rng(0), episodes=1)


def test_lessons_of_grasps_are_what_fresh_tests_say(course: GraspSamples, tmp_path: Path) -> None:
    task = FullTask(shapes.stand())
    first = task.initial_state(np.random.default_rng(0))
    assert len(course.samples) >= len(task.furniture.parts) - 1
    lesson = course.samples[0]
    u, k, v, l = lesson.pair  # noqa: E741
    for g_a, g_b in np.argwhere(lesson.fit != UNKNOWN).tolist():
        fresh = task.mate_grasp(first.groups, (u, v, k, l, g_a, g_b))
        assert isinstance(fresh, MateGrasp) == (lesson.fit[g_a, g_b] == YES)
        assert lesson.fit[g_a, g_b] == YES or lesson.reach[g_a, g_b] == UNKNOWN
    # What could not be taken fails when it is tried; where all is known to work, it does.
    for g_a, g_b in np.argwhere(lesson.fit == YES).tolist():
        taken = lesson.pick[0, g_a] == YES == lesson.pick[1, g_b]
        outcome = task.step(first, (u, v, k, l, g_a, g_b), 5)
        if not taken or lesson.reach[g_a, g_b] == NO:
            assert outcome.verdict is FullVerdict.NO_ARM_SOLUTION or (
                outcome.failure is not None and outcome.failure.stage in PICKING
            )
        if lesson.finish[g_a, g_b] == YES:
            assert taken
            assert lesson.reach[g_a, g_b] == YES
    course.save(tmp_path / "a.npz")
    again = GraspSamples.load(tmp_path / "a.npz")
    assert again.name == course.name
    assert np.array_equal(again.grasps, course.grasps)
    for a, b in zip(again.samples, course.samples, strict=True):
        assert a.pair == b.pair
        assert all(np.array_equal(getattr(a, n), getattr(b, n)) for n in ("pick", "fit", "reach", "finish"))
        assert np.array_equal(a.connections, b.connections)
    (tmp_path / "a.npz").write_bytes(b"no archive")
    with pytest.raises(InputError, match="remove it"):
        GraspSamples.load(tmp_path / "a.npz")


def test_what_an_action_tells_of_its_hands() -> None:
    task = FullTask(shapes.stand())
    state = task.initial_state(np.random.default_rng(0))
    observer = Observer(task.furniture, len(task.furniture.parts), MAX_POINTS, 1)
    rng, seen = np.random.default_rng(1), set[FullVerdict]()
    right = [a for a in np.argwhere(task.existing_actions(state)).tolist() if task.merge(state.groups, tuple(a[:4]))]
    for index in rng.permutation(len(right))[:14]:
        action = tuple(right[index])
        fresh, outcome = task.mate_grasp(state.groups, action), task.step(state, action, 5)
        lesson = label_outcome(task, state, observer, action, outcome)
        u, v, k, l, g_a, g_b = action  # noqa: E741
        assert lesson.pair == (u, k, v, l)
        # One answer each at most, and what was found out before anything moved is what a fresh test says.
        assert all((told != UNKNOWN).sum() <= 1 for told in (lesson.fit, lesson.reach, lesson.finish))
        assert lesson.fit[g_a, g_b] == (YES if isinstance(fresh, MateGrasp) else NO)
        assert (lesson.finish[g_a, g_b] == YES) == (outcome.verdict is FullVerdict.MERGED)
        told = [lesson.fit[g_a, g_b], lesson.reach[g_a, g_b], *lesson.pick[[0, 1], [g_a, g_b]], lesson.finish[g_a, g_b]]
        assert told.count(NO) == (outcome.verdict is not FullVerdict.MERGED)
        # After a first no nothing is known.
        assert set(told[told.index(NO) + 1 :] if NO in told else ()) <= {UNKNOWN}
        seen.add(outcome.verdict)
    assert FullVerdict.MERGED in seen
    assert len(seen) > 1


def test_what_is_asked_of_actions_is_what_fresh_tests_say() -> None:
    task = FullTask(shapes.stand())
    state = task.initial_state(np.random.default_rng(0))
    observer = Observer(task.furniture, len(task.furniture.parts), MAX_POINTS, 1)
    actions = [tuple(a) for a in np.argwhere(task.existing_actions(state)).tolist()]
    right = [a for a in actions if task.merge(state.groups, a[:4])]
    wrong = [a for a in actions if not task.merge(state.groups, a[:4])]
    lessons = list(probe_grasps(task, state, observer, [*wrong[:5], *right[::4]], np.random.default_rng(1)))
    assert {lesson.pair for lesson in lessons} == {(a[0], a[2], a[1], a[3]) for a in right[::4]}
    room = 0
    for lesson in lessons:
        u, k, v, l = lesson.pair  # noqa: E741
        for g_a, g_b in np.argwhere(lesson.fit != UNKNOWN).tolist():
            joint = task.mate_grasp(state.groups, (u, v, k, l, g_a, g_b))
            assert lesson.fit[g_a, g_b] == (YES if isinstance(joint, MateGrasp) else NO)
            room += 1
        for g_a, g_b in np.argwhere(lesson.reach != UNKNOWN).tolist():
            joint = task.mate_grasp(state.groups, (u, v, k, l, g_a, g_b))
            assert isinstance(joint, MateGrasp)
            assert lesson.reach[g_a, g_b] == task.can_mate(state, joint, 2)
            assert lesson.pick[0, g_a] == task.can_pick(state, u, joint.grip_a, 0, 3)
            assert lesson.pick[1, g_b] == task.can_pick(state, v, joint.grip_b, 1, 4)
        assert (lesson.finish == UNKNOWN).all()
    assert room == len(right[::4])
    # Arms are asked about of the first that have room.
    assert sum(int((lesson.reach != UNKNOWN).sum()) for lesson in lessons) == 3


def test_practice_is_written_once_and_the_same_again(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    config = relational.RelationalConfig(token=16, pair=8, layers=1, heads=2, conflict_inputs=4, conflicts=2)
    params = {**relational.init(rng, config), GRASP_PARAMS: grasping.init(rng)}
    player_file, names = tmp_path / "player.npz", ["three_legged:24", "upholstered:14"]
    checkpoint.save(player_file, checkpoint.Checkpoint(relational.KIND, params, {"network": asdict(config)}, {}))
    done = {g.name: g for g in collect_on_policy(names, tmp_path / "a", player_file, episodes=1, seed=3, jobs=1)}
    # No hand can hold an upholstered chair.
    assert done["upholstered:14"].states == 0
    assert not list(collect_on_policy(names, tmp_path / "a", player_file, episodes=1, seed=3, jobs=1))
    again = {g.name: g for g in collect_on_policy(names, tmp_path / "b", player_file, episodes=1, seed=3, jobs=1)}
    for name, told in done.items():
        assert (told.states, told.mistakes) == (again[name].states, again[name].mistakes)
        lessons = GraspSamples.load(dataset_file(tmp_path / "a", name)).samples
        assert len(lessons) == told.states
        assert sum(int((lesson.finish == YES).sum()) for lesson in lessons) == told.choices - told.mistakes


def test_chances_of_hands_by_hand() -> None:
    params = grasping.init(np.random.default_rng(0))
    params["mate"]["1"]["w"][:], params["mate"]["1"]["b"][:] = 0.0, [0.0, np.log(3.0), 0.0]
    params["pick"]["2"]["w"][:], params["pick"]["2"]["b"][:] = 0.0, np.log(4.0)
    there = np.ones((GRASPS, GRASPS), bool)
    there[3] = False
    one, two = np.zeros((2, GRASPS, SINGLE_FEATURES), np.float32), np.zeros((GRASPS, GRASPS, PAIR_FEATURES), np.float32)
    chance = grasping.log_probability(params, GraspFeatures(one, two, there))
    # Half a chance of room, three quarters that the arms meet, half that all else works; four fifths for each hand.
    assert np.exp(chance[there]) == pytest.approx(0.5 * 0.75 * 0.5 * 0.8 * 0.8)
    assert (chance[~there] == -np.inf).all()


def test_grasps_are_learnt(course: GraspSamples, tmp_path: Path) -> None:
    pytest.importorskip("jax")
    from roboassembly.learning.relational.grasps import imitation as grasp_imitation

    course.save(tmp_path / "a.npz")
    examples = grasp_imitation.examples_of([tmp_path / "a.npz"], 1)
    training = grasp_imitation.Training(steps=1_200, batch=8)
    steps = list(grasp_imitation.train(examples, tmp_path / "net.npz", training, {}))
    assert steps[-1][1]["loss"] < 0.5 * steps[0][1]["loss"]
    params = checkpoint.load(tmp_path / "net.npz", grasping.KIND).params
    told = grasp_imitation.quality(params, examples)
    assert min(told[name] for name in ("take", "fit", "first")) > 0.9
    assert set(np.unique(examples.together)) == {UNKNOWN, NO, YES}


def test_a_policy_with_hands_plays_with_robots() -> None:
    furniture = catalogue.make("three_legged", 1)
    shipped = load_policy("relational")
    assert isinstance(shipped, RelationalPolicy)
    policy = replace(shipped, grasp_params=grasping.init(np.random.default_rng(0)))
    env = FullEnv(furniture, cloud_points=policy.cloud_points)
    observation, info = env.reset(seed=0)
    mask = info["action_mask"]
    values = policy.values(observation, mask)
    assert values.shape == mask.shape
    assert np.array_equal(values > -np.inf, mask)
    assert ((policy.probabilities(observation, mask) > 0.0) <= mask).all()
    action = policy.act(observation, mask)
    assert mask[tuple(action)]
    *_, told = env.step(action)
    # Pairs are known to it, hands are not.
    assert told["verdict"] not in (FullVerdict.WRONG_PAIR, FullVerdict.NOT_AN_ACTION)
    drawn = make_agent(RolloutConfig("random", setting="full"))(furniture, 0)
    assert (drawn.success, len(drawn.actions)) == (False, drawn.merges + 1)
    done = make_agent(RolloutConfig(policy, setting="full"))(furniture, 0)
    assert done.actions
    assert len(done.actions[0]) == 6
    with pytest.raises(InputError, match="has no grasp network"):
        replace(shipped, grasp_params=None).values(observation, mask)


def test_a_checkpoint_carries_hands(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    hands, params = grasping.init(rng), relational.init(rng, relational.RelationalConfig())
    config = {"network": asdict(relational.RelationalConfig())}
    whole = checkpoint.Checkpoint(relational.KIND, {**params, "grasps": hands}, config, {})
    checkpoint.save(tmp_path / "p.npz", whole)
    policy = load_policy(str(tmp_path / "p.npz"))
    assert isinstance(policy, RelationalPolicy)
    assert policy.settings == ("object-centric", "full")
    broken = {**hands, "grasp_pair": {"w": hands["grasp_pair"]["w"][:2], "b": hands["grasp_pair"]["b"]}}
    checkpoint.save(tmp_path / "p.npz", replace(whole, params={**params, "grasps": broken}))
    with pytest.raises(InputError, match="grasp_pair"):
        load_policy(str(tmp_path / "p.npz"))
