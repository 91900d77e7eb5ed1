"""Tests of the evaluation: intervals, reproducible episodes, and the round trip through Minari."""

from __future__ import annotations

import json
import os
import pickle
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from roboassembly.cli.evaluate import summary
from roboassembly.datasets import catalogue
from roboassembly.datasets.sets import Entry, FurnitureRef, furniture_hash, furniture_refs, sample_refs
from roboassembly.envs.observation import AS_IN_PAPER, ObservationConfig
from roboassembly.errors import InputError, MissingExtraError, RoboAssemblyError, UnknownNameError
from roboassembly.evaluation.episodes import Episode
from roboassembly.evaluation.evaluate import Evaluation, episode_seed, evaluate
from roboassembly.evaluation.export import check_target, export
from roboassembly.evaluation.rollout import SOLVERS, RolloutConfig, make_agent, rollout_policy, run_episode
from roboassembly.furniture import storage
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import Mesh
from roboassembly.learning.policy import surest
from roboassembly.solvers.search import solve
from roboassembly.statistics import success
from roboassembly.task.full.failure import Stage
from roboassembly.task.object_centric.task import ObjectCentricTask
from shapes import GAP, brick, furniture, pose


def episode(index: int, success: bool, **more) -> Episode:
    verdict = "merged" if success else "wrong_pair"
    return Episode(f"chair-{index}", 3, index, success, 2 * success, verdict, 10 * index, 0.5, **more)


def test_wilson_intervals_by_hand() -> None:
    """(p + z²/2n ± z √(p(1-p)/n + z²/4n²)) / (1 + z²/n) with z = 1.959964."""
    seven = success([True] * 7 + [False] * 3)
    assert seven == {"n": 10, "success_rate": 0.7, "ci95": [0.3968, 0.8922]}
    # All of 192: n / (n + z²) = 192 / 195.8415.
    assert success([True] * 192) == {"n": 192, "success_rate": 1.0, "ci95": [0.9804, 1.0]}
    # None of 192: z² / (n + z²).
    assert success([False] * 192)["ci95"] == [0.0, 0.0196]
    assert success([]) == {"n": 0, "success_rate": None, "ci95": None}


def test_report_by_hand() -> None:
    some = tuple(episode(i, i < 7, family="stool", unseen=i % 2 == 0, policy_seconds=0.1) for i in range(10))
    report = Evaluation(RolloutConfig("relational"), "chairs-412:test", 3, some).to_json()
    assert json.loads(json.dumps(report)) == {
        **report,
        "per_furniture": json.loads(json.dumps(report["per_furniture"])),
    }
    assert (report["policy"], report["set"], report["seed"], report["search"]) == (
        "relational", "chairs-412:test", 3, False,
    )  # fmt: skip
    assert (report["n"], report["success_rate"]) == (10, 0.7)
    assert report["planning_steps_mean"] == 45
    assert report["planning_steps_mean_solved"] == 30
    assert report["planning_seconds_mean"] == 0.5
    assert report["policy_seconds_mean"] == pytest.approx(0.1)
    # 0, 2, 4, 6 of 0, 2, 4, 6, 8.
    assert report["unseen"] == {"n": 5, "success_rate": 0.8, "ci95": [0.3755, 0.9638]}
    assert report["per_furniture"][8]["verdict"] == "wrong_pair"
    unknown = Evaluation(RolloutConfig("search"), "folder:x", 0, tuple(replace(e, unseen=None) for e in some)).to_json()
    assert unknown["unseen"] is None
    assert Evaluation(RolloutConfig("search"), "folder:x", 0, some[8:]).to_json()["planning_steps_mean_solved"] is None


def test_the_printed_summary() -> None:
    some = tuple(episode(i, i < 2, family="ab"[i % 2], unseen=i % 2 == 0) for i in range(4))
    head, columns, whole, known, unknown, a, b, failed = summary(Evaluation(RolloutConfig("random"), "s", 1, some))
    assert head == "random on s, seed 1"
    assert columns.split() == ["n", "success", "95", "%", "states"]
    assert whole.split() == ["all", "4", "50.0%", "15.0-", "85.0", "15"]
    assert (known.split()[4:6], unknown.split()[3:5]) == (["2", "50.0%"], ["2", "50.0%"])
    assert (a.split()[0], b.split()[0]) == ("a", "b")
    assert failed.split() == ["failed:", "2", "wrong_pair"]


def test_failure_stages_of_full_episodes() -> None:
    ends = [
        ("grasp_blocked", Stage.GRASP), ("cannot_release", Stage.RELEASE), ("no_arm_solution", Stage.MATE),
        ("joint_blocked", Stage.MATE), ("no_path", Stage.DRIVE_TO_MATE), ("no_path", Stage.LEAVE),
        ("no_path", Stage.CARRY), ("no_placement", Stage.SET_DOWN), ("wrong_pair", ""), ("no_plan", ""),
        ("not_grasped", ""), ("merged", ""),
    ]  # fmt: skip
    some = tuple(
        replace(episode(i, verdict == "merged"), verdict=verdict, stage=stage)
        for i, (verdict, stage) in enumerate(ends)
    )
    assert Evaluation(RolloutConfig("x", setting="full"), "s", 1, some).to_json()["failures"] == {
        "placing": 3, "grasp blocked": 1, "cannot release": 1, "no arm solution": 1, "mating path": 1, "path": 1,
        "wrong pair": 1, "no plan": 1, "not grasped": 1,
    }  # fmt: skip
    assert "failures" not in Evaluation(RolloutConfig("x"), "s", 1, some).to_json()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> str:
    root = tmp_path_factory.mktemp("set")
    for name in ("cantilever", "shell", "stool"):
        storage.save(catalogue.make(name), root / name)
    return f"folder:{root}"


class Replay:
    """Policy that repeats the plans of the search; it recognizes pieces by their number of parts."""

    name = "replay"
    cloud_points = 1

    def __init__(self, plans: dict[int, list[tuple[int, ...]]]) -> None:
        self.plans = plans

    def act(self, observation, mask) -> np.ndarray:
        parts = int(observation["shapes"].any(axis=(1, 2)).sum())
        joined = (observation["connections"] != 0).any(axis=2) | np.eye(len(mask), dtype=bool)
        groups = len({int(i) for i in np.argmax(joined, axis=1)[:parts]})
        return np.array(self.plans[parts][parts - groups])


def test_custom_policy_that_repeats_the_plan_of_the_search() -> None:
    furniture = catalogue.make("stool", 2)
    plan = solve(furniture, 4).plan
    actions = [step.action for step in plan.steps]
    done = run_episode(Replay({len(furniture.parts): actions}), furniture, 4)
    assert (done.success, done.merges, done.verdict, done.seed) == (True, len(actions), "merged", 4)
    assert done.actions == tuple(actions)
    assert done.planning_steps > 0
    assert done.planning_seconds > 0.0
    assert done.policy_seconds > 0.0
    # A wrong third action ends it there.
    wrong = [*actions[:2], (actions[2][0], actions[2][1], 9, 9, 0)]
    done = run_episode(Replay({len(furniture.parts): wrong}), furniture, 4)
    assert (done.success, done.merges, done.verdict, len(done.actions)) == (False, 2, "not_an_action", 3)


def test_evaluated_over_a_set(folder: str) -> None:
    picks = furniture_refs(folder)
    plans = {}
    for p in picks:
        furniture = p.furniture()
        plans[len(furniture.parts)] = [s.action for s in solve(furniture, episode_seed(0, p.name, 0)).plan.steps]
    assert len(plans) == len(picks)
    episodes = list(evaluate(RolloutConfig(Replay(plans)), picks, 0, 1))
    assert [e.success for e in episodes] == [True] * 3
    assert [e.furniture for e in episodes] == [p.furniture().name for p in picks]


def timeless(episodes: list[Episode]) -> list[Episode]:
    return [replace(e, planning_seconds=0.0, policy_seconds=0.0, step_seconds=()) for e in episodes]


def test_episodes_do_not_depend_on_jobs_limits_or_order(folder: str) -> None:
    picks = furniture_refs(folder)
    alone = timeless(list(evaluate(RolloutConfig("random"), picks, 7, 1, episodes=2)))
    assert len(alone) == 6
    assert len({e.seed for e in alone}) == 6
    assert len({e.actions for e in alone}) > 3
    before = dict(os.environ)
    assert timeless(list(evaluate(RolloutConfig("random"), picks, 7, 2, episodes=2))) == alone
    assert dict(os.environ) == before
    assert timeless(list(evaluate(RolloutConfig("random"), picks[1::-1], 7, 1))) == [alone[2], alone[0]]
    assert timeless(list(evaluate(RolloutConfig("random"), picks[:1], 8, 1))) != alone[:1]


def test_episode_seeds_are_stable() -> None:
    """Published figures can be reproduced."""
    words = np.random.SeedSequence([5, 0xCBF43926, 2]).generate_state(1)
    assert episode_seed(5, "123456789", 2) == int(words[0]) // 2  # CRC-32's check value


def test_solvers_run_episodes(folder: str) -> None:
    picks = [p for p in furniture_refs(folder) if p.name == "shell"]
    ends = {name: next(iter(evaluate(RolloutConfig(name), picks, 0, 1))) for name in SOLVERS}
    parts = len(catalogue.make("shell").parts)
    assert all(e.parts == parts for e in ends.values())
    assert (ends["search"].success, ends["search"].merges, ends["search"].verdict) == (True, parts - 1, "merged")
    assert len(ends["search"].actions) == parts - 1
    assert (ends["joint-rrt"].success, ends["joint-rrt"].verdict) == (False, "budget_exhausted")
    assert ends["joint-rrt"].planning_steps >= 100_000
    assert all(e.success == (e.verdict == "merged") for e in ends.values())


def test_set_marks_unseen_families() -> None:
    made = catalogue.make("cantilever", 2)
    entry = Entry("cantilever", 2, 0, "test", None, True, len(made.parts), 0.5, False, 100, furniture_hash(made))
    known = next(iter(evaluate(RolloutConfig("search"), [FurnitureRef(entry.name, entry, None)], 0, 1)))
    assert (known.family, known.unseen, known.success) == ("cantilever", True, True)
    with pytest.raises(InputError, match="no longer what its data set"):
        list(evaluate(RolloutConfig("search"), [FurnitureRef(entry.name, _other(entry), None)], 0, 1))


def _other(entry: Entry) -> Entry:
    return Entry(**{**{f: getattr(entry, f) for f in entry.__struct_fields__}, "hash": "0" * 16})


def test_names_are_checked_before_any_episode() -> None:
    with pytest.raises(UnknownNameError, match="did you mean joint-rrt"):
        evaluate(RolloutConfig("joint-rtt"), [], 0, 4)
    with pytest.raises(InputError, match="'joint-rrt' cannot guide the search"):
        make_agent(RolloutConfig("joint-rrt", search=True))
    with pytest.raises(InputError, match="'random' does not value actions"):
        make_agent(RolloutConfig("random", search=True))


class Dies:
    """Policy that ends its process."""

    name = "dies"
    cloud_points = 1

    def act(self, observation, mask) -> np.ndarray:
        os._exit(7)


def test_dead_worker_raises_a_clear_error(folder: str) -> None:
    with pytest.raises(RoboAssemblyError, match=r"a worker process died .* 0 of 1 pieces.*cantilever"):
        list(evaluate(RolloutConfig(Dies()), furniture_refs(folder)[:1], 0, 2))


def test_a_policy_guides_the_search(folder: str) -> None:
    picks = [p for p in furniture_refs(folder) if p.name in ("stool", "cantilever")]

    class Shy(Replay):
        """Policy with equal low values for all actions."""

        def values(self, observation, mask) -> np.ndarray:
            return np.where(mask, np.float32(0.0), np.float32(-np.inf))

    for done in evaluate(RolloutConfig(Shy({}), search=True), picks, 0, 1):
        assert done.success
        assert done.policy_seconds > 0.0


def test_full_setting_with_audit_and_execution(armchair: Furniture) -> None:
    pytest.importorskip("fcl")
    done = make_agent(RolloutConfig(setting="full", execution="dynamic", audit=True))(armchair, 0)
    assert (done.success, done.verdict, done.merges, done.violations, done.reason) == (True, "merged", 2, 0, "")
    assert [len(a) for a in done.actions] == [6, 6]
    assert done.executed is not None
    assert (done.executed["success"], done.executed["steps"], done.executed["ending"]) == (True, 2, "done")
    assert 0.0 < done.executed["tracking_error_mm"] < 5.0
    assert 0.0 < sum(done.step_seconds) <= done.planning_seconds
    assert Episode(**json.loads(json.dumps(asdict(done)))).executed == done.executed
    failed = replace(done, success=False, verdict="off_the_path", step_seconds=())
    unplanned = replace(failed, executed=None, violations=None)
    report = Evaluation(
        RolloutConfig(setting="full", execution="dynamic", audit=True), "s", 0, (done, failed, unplanned)
    ).to_json()
    assert (report["setting"], report["execution"], report["violations"]) == ("full", "dynamic", 0)
    assert report["success_rate"] == pytest.approx(1 / 3)
    assert report["planned"]["success_rate"] == pytest.approx(2 / 3)
    assert report["merge_seconds_median"] == pytest.approx(sum(done.step_seconds) / 2)


def test_refusals_of_the_full_setting() -> None:
    with pytest.raises(InputError, match="'joint-rrt' chooses no grasps; --setting full takes --policy search"):
        make_agent(RolloutConfig("joint-rrt", setting="full"))
    with pytest.raises(InputError, match="'replay' chooses no grasps"):
        make_agent(RolloutConfig(Replay({}), setting="full"))
    with pytest.raises(InputError, match="--execution dynamic takes --setting full"):
        make_agent(RolloutConfig("search", execution="dynamic"))
    board = furniture("board", {"a": brick(0.4, 0.3, 0.2), "b": brick(0.4, 0.3, 0.2).transformed(pose(z=0.2 + GAP))})
    done = make_agent(RolloutConfig(setting="full", execution="dynamic"))(board, 0)
    assert (done.success, done.verdict, done.merges) == (False, "refused", 0)
    assert "no hand" in done.reason or "no grasp" in done.reason, done.reason


def test_a_sample_is_drawn_by_the_seed() -> None:
    picks = [FurnitureRef(str(i), None, None) for i in range(20)]
    some = [p.name for p in sample_refs(picks, 5, 3)]
    assert some == [p.name for p in sample_refs(picks, 8, 3)][:5]
    assert len(set(some)) == 5
    assert some != [p.name for p in sample_refs(picks, 5, 4)]
    assert len(sample_refs(picks, 50, 0)) == 20
    assert sample_refs(picks, None, 0) == picks


# Minari


@pytest.fixture(scope="module")
def played(folder: str) -> list[tuple[FurnitureRef, Episode]]:
    picks = [p for p in furniture_refs(folder) if p.name in ("cantilever", "stool")]
    done = [(p, e) for p in picks for e in evaluate(RolloutConfig("search"), [p], 0, 1, episodes=2)]
    return [(done[0][0], episode(0, False, actions=((0, 0, 0, 0, 0),))), *done]


def test_a_minari_data_set_is_read_again_and_replayed(
    played: list[tuple[FurnitureRef, Episode]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    minari = pytest.importorskip("minari")
    pytest.importorskip("h5py")
    done = export(tmp_path / "sets" / "two-v0", played, "search", cloud_points=16)
    assert (done.episodes, done.refused) == (4, 0)
    assert done.steps == sum(e.merges for _, e in played)
    assert [p.name for p in (tmp_path / "sets").iterdir()] == ["two-v0"]

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "sets"))
    dataset = minari.load_dataset("two-v0")
    assert (dataset.total_episodes, dataset.total_steps) == (4, done.steps)
    assert dataset.spec.env_spec.id == "RoboAssembly/ObjectCentric-v0"
    env = dataset.recover_environment()
    about = list(dataset.storage.get_episode_metadata(range(4)))
    for recorded, meta, (_, source) in zip(dataset.iterate_episodes(), about, played[1:], strict=True):
        assert recorded.rewards.tolist() == [1.0] * (source.merges - 1) + [5.0]
        assert recorded.terminations.tolist() == [False] * (source.merges - 1) + [True]
        assert [tuple(a) for a in recorded.actions.tolist()] == list(source.actions)
        assert dataset.observation_space.contains({k: v[0] for k, v in recorded.observations.items()})
        observation, info = env.reset(seed=meta["seed"], options=meta["options"])
        assert info["furniture"] == source.furniture
        for i, action in enumerate(recorded.actions):
            for key, value in observation.items():
                np.testing.assert_array_equal(recorded.observations[key][i], value)
            observation, reward, *_, info = env.step(action)
            assert reward == recorded.rewards[i]
        assert info["success"]


def test_export_errors(played: list[tuple[FurnitureRef, Episode]], tmp_path: Path) -> None:
    pytest.importorskip("minari")
    with pytest.raises(
        InputError, match="'chairs' is not the name of a Minari data set; expected one like 'chairs-v0'"
    ):
        check_target(tmp_path / "chairs")
    (tmp_path / "there-v0").mkdir()
    with pytest.raises(InputError, match="something already"):
        check_target(tmp_path / "there-v0")
    with pytest.raises(InputError, match="no episode succeeded"):
        export(tmp_path / "none-v0", played[:1], "random")
    never = [(p, replace(e, actions=e.actions[:1])) for p, e in played[1:2]]
    with pytest.raises(InputError, match="none of 1 episodes succeeded again"):
        export(tmp_path / "none-v0", never, "random")
    assert [p.name for p in tmp_path.iterdir()] == ["there-v0"]


def test_errors_of_workers_keep_their_type() -> None:
    for error in (
        UnknownNameError("policy", "serch", ["search"]),
        MissingExtraError("jax", "learn"),
        InputError("bad"),
    ):
        again = pickle.loads(pickle.dumps(error))
        assert type(again) is type(error)
        assert str(again) == str(error)


class Stubborn:
    """Values one wrong pair most, then a right pair with a `w` that cannot work, then one that can."""

    name, cloud_points = "stubborn", 1

    def __init__(self, order: list[tuple[int, ...]]) -> None:
        self.order = order

    def act(self, observation, mask):
        return surest(self.values(observation, mask))

    def values(self, observation, mask):
        values = np.where(mask, -1.0, -np.inf).astype(np.float32)
        for rank, action in enumerate(self.order):
            values[action] = 10.0 - rank
        return values


def test_a_policy_with_several_tries_goes_on_where_it_was_refused() -> None:
    """A wrong pair is not tried again with another `w`, nor the other way round; what could not be carried out is."""
    stool = catalogue.make("stool", 1)
    task = ObjectCentricTask(stool)
    state = task.initial_state(np.random.default_rng(5))
    mask = task.existing_actions(state)
    pairs = [tuple(pair) for pair in np.argwhere(mask.any(axis=-1)).tolist()]
    wrong = next(p for p in pairs if task.prepare(state, (*p, 0)) is None)
    u, v, k, l = wrong  # noqa: E741
    joint = stool.connections[0]
    right = (joint.part_a, joint.part_b, joint.point_a, joint.point_b)
    works = [w for w in range(6) if task.step(state, (*right, w), 0).step is not None]
    fails = [w for w in range(6) if w not in works]
    assert works
    assert fails
    order = [(*wrong, 0), (*wrong, 1), (v, u, l, k, 2), (*right, fails[0]), (*right, works[0])]
    first = [rollout_policy(Stubborn(order), stool, 5, tries=tries).actions[:tries] for tries in (1, 2, 3)]
    assert first[0] == ((*wrong, 0),)
    assert first[1] == ((*wrong, 0), (*right, fails[0]))
    assert first[2] == ((*wrong, 0), (*right, fails[0]), (*right, works[0]))
    assert len(rollout_policy(Stubborn(order), stool, 5, tries=3).plan.steps) >= 1


def test_tries_and_hints_are_for_policies_alone() -> None:
    for config in (RolloutConfig(tries=3), RolloutConfig("relational", search=True, tries=3)):
        with pytest.raises(InputError, match="acts alone"):
            make_agent(config)


class Framed(Stubborn):
    """Remembers in which frames it plays."""

    def with_frames(self, frames: str):
        self.frames = frames
        return self


@pytest.mark.parametrize("frames", ["aligned", "own"])
def test_a_policy_learns_in_which_frames_it_plays(frames) -> None:
    policy = Framed([])
    rollout_policy(policy, catalogue.make("stool", 1), 0, observes=ObservationConfig(frames))
    assert policy.frames == frames


class Informed(Stubborn):
    """Remembers the meshes that it is told."""

    meshes: tuple[Mesh, ...] = ()

    def with_meshes(self, meshes: Sequence[Mesh]):
        self.meshes = tuple(meshes)
        return self


def test_a_policy_gets_the_meshes_in_the_frames_of_its_observations() -> None:
    furniture, policy = catalogue.make("stool", 1), Informed([])
    rollout_policy(policy, furniture, 0)
    assert policy.meshes == tuple(part.mesh for part in furniture.parts)
    rollout_policy(policy, furniture, 0, observes=ObservationConfig("own"))
    assert [len(mesh.faces) for mesh in policy.meshes] == [len(part.mesh.faces) for part in furniture.parts]
    assert not np.allclose(policy.meshes[0].vertices, furniture.parts[0].mesh.vertices)


@pytest.mark.parametrize(
    ("observes", "meshes"),
    [(AS_IN_PAPER, False), (ObservationConfig(clouds="resampled"), True), (ObservationConfig(noise=0.001), True)],
)
def test_a_policy_gets_no_meshes_if_it_is_to_do_with_points(observes, meshes) -> None:
    policy = Informed([])
    rollout_policy(policy, catalogue.make("stool", 1), 0, observes=observes, meshes=meshes)
    assert policy.meshes == ()
