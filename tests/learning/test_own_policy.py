"""Policies in files of one's own: every command plays them, alike by however many, and says what is wrong with them."""

from __future__ import annotations

import json
import pickle
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from command_line import Run
from roboassembly.datasets.sets import furniture_refs
from roboassembly.envs.full import FullEnv
from roboassembly.envs.object_centric import ObjectCentricEnv
from roboassembly.errors import InputError, PolicyError, UnknownNameError
from roboassembly.evaluation.episodes import Episode
from roboassembly.evaluation.evaluate import episode_seed, evaluate
from roboassembly.evaluation.rollout import RolloutConfig, make_agent, rollout_policy
from roboassembly.furniture import storage
from roboassembly.furniture.model import Furniture
from roboassembly.learning.policy import guide_of
from roboassembly.learning.registry import load_policy, policy_factory
from roboassembly.solvers.full_search import solve_full
from roboassembly.solvers.search import solve
from scripts import script

ROOT = Path(__file__).parents[2]
DOC, EXAMPLE = ROOT / "docs" / "your-own-policy.md", ROOT / "examples" / "05_masked_ppo.py"

RANDOM = """
from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass
class Drawn:
    rng: np.random.Generator
    name: str = "drawn"
    cloud_points: int = 2
    settings: tuple[str, ...] = ("object-centric", "full")
    picked: list[tuple[int, ...]] = field(default_factory=list)

    def act(self, observation, mask):
        assert observation["shapes"].shape == (20, 2, 3)
        self.picked.append(tuple(self.rng.choice(np.argwhere(mask))))
        return self.picked[-1]


def policy(seed: int) -> Drawn:
    return Drawn(np.random.default_rng(seed))
"""
"""A data class, whose module has to be known by name while it is made."""

PLAN = """
import numpy as np


class Plan:
    name = "plan"
    cloud_points = 1
    settings = ("object-centric", "full")
    plan = {plan!r}

    def __init__(self, seed):
        pass

    def values(self, observation, mask):
        out = np.where(mask, np.float32(-9.0), np.float32(-np.inf))
        for rank, action in enumerate(self.plan):
            if len(action) == mask.ndim and mask[action]:
                out[action] = -0.1 * rank
        return out

    def act(self, observation, mask):
        values = self.values(observation, mask)
        return np.unravel_index(values.argmax(), values.shape)


policy = Plan
"""
"""A class that is made of a seed. It values the actions of a plan, each a little less than the one before."""


@pytest.fixture(scope="session")
def stool(chair) -> Furniture:
    """Five parts."""
    return chair("three_legged", 3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, stool: Furniture) -> Path:
    return storage.save(stool, tmp_path_factory.mktemp("stools") / "one")


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def actions_of(furniture: Furniture, seed: int) -> list[tuple[int, ...]]:
    plan = solve(furniture, seed).plan
    assert plan.success
    return [tuple(int(a) for a in step.action) for step in plan.steps]


def timeless(episodes: list[Episode]) -> list[Episode]:
    return [replace(e, planning_seconds=0.0, policy_seconds=0.0, step_seconds=()) for e in episodes]


# What plays


def test_evaluate_plays_a_file(run: Run, tmp_path: Path, stool: Furniture, folder: Path) -> None:
    plan = actions_of(stool, episode_seed(0, "one", 0))
    file = write(tmp_path / "plan.py", PLAN.format(plan=plan))
    command = ("evaluate", "--set", f"folder:{folder}", "--jobs", "1", "--json", "--policy", file)
    status, out, err = run(*command)
    assert (status, "Traceback" in err) == (0, False)
    report = json.loads(out)
    assert (report["policy"], report["search"], report["success_rate"]) == (str(file), False, 1.0)
    (played,) = report["per_furniture"]
    assert [tuple(a) for a in played["actions"]] == plan
    assert played["policy_seconds"] > 0.0
    # A plan that begins with a point that does not exist fails there and then.
    u, v, k, _, w = plan[0]
    wrong = (u, v, k, 9, w)
    write(file, PLAN.format(plan=[wrong]).replace("mask[action]", "True"))
    (played,) = json.loads(run(*command)[1])["per_furniture"]
    assert (played["success"], played["merges"], len(played["actions"])) == (False, 0, 1)
    assert played["verdict"] == "not_an_action"
    # Beside the file nothing is written.
    assert [p.name for p in tmp_path.iterdir()] == ["plan.py"]


def test_a_file_guides_the_search(run: Run, tmp_path: Path, stool: Furniture, folder: Path) -> None:
    seed = episode_seed(0, "one", 0)
    plan = actions_of(stool, seed)
    file = write(tmp_path / "plan.py", PLAN.format(plan=plan))
    command = ("evaluate", "--set", f"folder:{folder}", "--jobs", "1", "--json", "--search", "--policy", file)
    (played,) = json.loads(run(*command)[1])["per_furniture"]
    assert [tuple(a) for a in played["actions"]] == plan
    result = solve(stool, seed, guide=guide_of(load_policy(str(file), seed)))
    assert (result.guided, result.attempts) == (len(plan), len(plan))
    # What is wrong costs time only.
    write(file, PLAN.format(plan=[]))
    (played,) = json.loads(run(*command)[1])["per_furniture"]
    assert (played["success"], played["merges"]) == (True, len(plan))
    assert played["policy_seconds"] > 0.0


def test_assemble_takes_a_file(run: Run, tmp_path: Path, stool: Furniture, folder: Path) -> None:
    plan = actions_of(stool, 5)
    file = write(tmp_path / "plan.py", PLAN.format(plan=plan))
    command = ("assemble", folder, "--policy", file, "--seed", "5", "--no-film", "--json", "--out", tmp_path / "out")
    for more in ((), ("--no-search",)):
        status, out, _ = run(*command, *more)
        report = json.loads(out)
        assert (status, report["policy"], report["guided_merges"]) == (0, str(file), len(plan))
        written = json.loads((tmp_path / "out" / "plan.json").read_text())
        assert [tuple(s["action"]) for s in written["steps"]] == plan
    write(file, RANDOM)
    status, out, err = run(*command, "--no-search")
    assert (status, json.loads(out)["success"], "without search: merge 1 ended as" in err) == (1, False, True)


def test_with_robots(run: Run, tmp_path: Path, armchair: Furniture) -> None:
    at = storage.save(armchair, tmp_path / "set" / "armchair")
    seed = episode_seed(0, "armchair", 0)
    plan = [tuple(int(a) for a in s.action) for s in solve_full(armchair, seed).plan.steps]
    assert [len(a) for a in plan] == [6, 6]
    file = write(tmp_path / "plan.py", PLAN.format(plan=plan))
    command = ("evaluate", "--set", f"folder:{at}", "--setting", "full", "--jobs", "1", "--json", "--policy", file)
    # Guided it does as planned. Alone the environment draws the planner's numbers, so that a path may not be found.
    status, out, _ = run(*command, "--search")
    report = json.loads(out)
    assert (status, report["setting"], report["success_rate"]) == (0, "full", 1.0)
    assert [tuple(a) for a in report["per_furniture"][0]["actions"]] == plan
    status, out, _ = run(*command)
    (played,) = json.loads(out)["per_furniture"]
    done = rollout_policy(load_policy(str(file), seed), armchair, seed, "full")
    assert [tuple(a) for a in played["actions"]] == list(done.actions) == plan[: len(done.actions)]
    assert (status, played["success"], played["merges"]) == (0, done.plan.success, len(done.plan.steps))
    # What does not say that it chooses hands is not asked to.
    write(file, PLAN.format(plan=plan).replace("settings =", "stands ="))
    status, out, err = run(*command)
    assert status == 2
    assert "'plan' chooses no grasps; --setting full takes --policy search, or a policy whose `settings` name it" in err
    write(file, PLAN.format(plan=plan).replace('("object-centric", "full")', '["full"]'))
    assert "'plan' plays with robots only" in run("evaluate", "--policy", file, "--set", f"folder:{at}")[2]


@pytest.mark.slow
def test_each_episode_has_a_policy_of_its_own(tmp_path: Path, folder: Path, stool: Furniture) -> None:
    """So that what is drawn depends on the episode alone: not on the jobs, nor on what was played before."""
    more = storage.save(stool, folder.parent / "two")
    file = write(tmp_path / "drawn.py", RANDOM)
    way, picks = RolloutConfig(str(file)), [*furniture_refs(f"folder:{folder}"), *furniture_refs(f"folder:{more}")]
    alone = timeless(list(evaluate(way, picks, 3, 1, episodes=4)))
    assert len({e.actions for e in alone}) == 8
    assert timeless(list(evaluate(way, picks, 3, 2, episodes=4))) == alone
    assert timeless(list(evaluate(way, picks[1:], 3, 1, episodes=1))) == alone[4:5]
    for episode in alone:
        policy = load_policy(str(file), episode.seed)
        done = rollout_policy(policy, stool, episode.seed)
        assert done.actions == episode.actions == tuple(policy.picked)  # pyright: ignore[reportAttributeAccessIssue]


def test_a_policys_seed_follows_from_the_episodes_and_is_another(tmp_path: Path) -> None:
    make = policy_factory(str(write(tmp_path / "drawn.py", RANDOM)))
    draws = [make(seed).rng.random() for seed in (0, 1, 2, 0)]  # pyright: ignore[reportAttributeAccessIssue]
    assert draws[0] == draws[3]
    assert len(set(draws)) == 3
    # The parts lie where numbers of the episode's own seed say.
    assert not set(draws) & {np.random.default_rng(seed).random() for seed in (0, 1, 2)}


def test_policy_file_is_executed_once(tmp_path: Path) -> None:
    count = "from pathlib import Path\nwith Path(__file__).with_suffix('.log').open('a') as f:\n    f.write('x')\n"
    file = write(tmp_path / "random.py", RANDOM + count)
    import random

    make = policy_factory(str(file))
    made = [make(seed) for seed in range(3)]
    assert (tmp_path / "random.log").read_text() == "x"
    assert sys.modules["random"] is random
    # Its objects find their class again: they may be handed to workers.
    again = pickle.loads(pickle.dumps(made[0]))
    assert type(again) is type(made[0])
    # Changed at once, of the same length, and read anew.
    write(file, file.read_text().replace('"drawn"', '"other"'))
    assert policy_factory(str(file))(0).name == "other"


# What is wrong

WHOLE = "class P:\n    name, cloud_points, settings = 'p', 1, ('object-centric',)\n    def act(self, o, m): ...\n"
BAD = {
    "no python": ("def policy(seed:\n", r"line 1: SyntaxError"),
    "no text": ("x = '\0'\n", "SyntaxError|ValueError"),
    "fails": ("import numpy\n\nx = [][1]\n", r"line 3: IndexError: list index out of range"),
    "lacks a library": ("import no_such_library\n", r"line 1: ModuleNotFoundError: No module named 'no_such_library'"),
    "ends": ("import sys\nsys.exit()\n", r"line 2: SystemExit"),
    "several lines": ("raise ValueError('one\\ntwo')\n", r"line 1: ValueError: one two"),
    "nothing": ("", r"defines no policy; expected a function policy\(seed\) that returns a policy"),
    "a number": ("policy = 3\n", "has a int as its policy"),
    "takes nothing": ("def policy(): ...\n", r"TypeError: policy\(\) takes 0 positional arguments but 1 was given"),
    "fails when made": ("def policy(seed):\n    return 1 / 0\n", "line 2: ZeroDivisionError: division by zero"),
    "returns nothing": ("def policy(seed): ...\n", r"policy\(seed\) returned nothing"),
    "a class": (WHOLE + "def policy(seed): return P\n", r"returned the class P, not an object of it"),
    "no policy": (
        "def policy(seed): return 7\n",
        "a int, which is no policy: it lacks `name`, a text, and `cloud_points`",
    ),
    "no act": (WHOLE.replace("act", "play") + "def policy(seed): return P()\n", "lacks `act`, a method"),
    "act is data": (WHOLE + "def policy(seed):\n    p = P()\n    p.act = 3\n    return p\n", "whose `act` is 3"),
    "nameless": (WHOLE.replace("'p'", "5") + "def policy(seed): return P()\n", "whose `name` is 5; expected a text"),
    "no points": (
        WHOLE.replace(" 1,", " 0,") + "def policy(seed): return P()\n",
        "whose `cloud_points` is 0; expected a whole",
    ),
    "half points": (WHOLE.replace(" 1,", " 1.5,") + "def policy(seed): return P()\n", "whose `cloud_points` is 1.5"),
    "settings": (
        WHOLE.replace("centric", "full") + "def policy(seed): return P()\n",
        r"whose `settings` is \('object-fu",
    ),
    "a setting": (
        WHOLE.replace("('object-centric',)", "'full'") + "def policy(seed): return P()\n",
        "is 'full'; expected some of",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_invalid_policy_file_prints_one_line_and_exits_with_2(
    run: Run, tmp_path: Path, folder: Path, case: str
) -> None:
    text, words = BAD[case]
    file = write(tmp_path / "bad.py", text)
    modules = set(sys.modules)
    status, out, err = run("evaluate", "--policy", file, "--set", f"folder:{folder}", "--jobs", "2")
    assert (status, out) == (2, "")
    assert len(err.strip().splitlines()) == 1
    assert err.startswith(f"error: '{file}'")
    assert re.search(words, err), err
    assert not [m for m in set(sys.modules) - modules if "policy_file_" in m] or case not in ("fails", "ends")


def test_no_file(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    monkeypatch.chdir(tmp_path)
    for command in (("assemble", folder), ("evaluate", "--set", f"folder:{folder}")):
        status, out, err = run(*command, "--policy", "gone.py")
        words = "no policy file at 'gone.py'; name a Python file that defines policy(seed)"
        assert (status, out, err) == (2, "", f"error: {words}\n")
    (tmp_path / "folder.py").mkdir()
    with pytest.raises(InputError, match="no policy file"):
        load_policy("folder.py")
    with pytest.raises(UnknownNameError, match=r"PATH\.npz, PATH\.py"):
        load_policy("zzzzzz")
    with pytest.raises(UnknownNameError, match=r"PATH\.npz, PATH\.py"):
        make_agent(RolloutConfig("zzzzzz"))
    assert [p.name for p in tmp_path.iterdir()] == ["folder.py"]


def test_policy_without_values_cannot_guide(run: Run, tmp_path: Path, folder: Path) -> None:
    file = write(tmp_path / "drawn.py", RANDOM)
    for command in (("evaluate", "--search", "--set", f"folder:{folder}"), ("assemble", folder)):
        status, _, err = run(*command, "--policy", file)
        assert status == 2
        assert "'drawn' does not value actions (it has no method `values`), so it cannot guide the search" in err


ANSWERS = {
    "none": ("None", "picked None; expected 5 integers"),
    "too few": ("[0, 1, 0, 0]", r"picked \[0, 1, 0, 0\]; expected 5 integers"),
    "too many": ("(0, 1, 0, 0, 0, 0)", "expected 5 integers"),
    "a table": ("np.argwhere(mask)[:1]", r"picked array\(\[\[.*; expected 5 integers"),
    "floats": ("np.zeros(5)", "picked array"),
    "ragged": ("[[0, 1], 0, 0, 0, 0]", "picked"),
    "truths": ("[True] * 5", "picked"),
}


@pytest.mark.parametrize("case", ANSWERS)
def test_invalid_action_ends_the_run(run: Run, tmp_path: Path, folder: Path, case: str) -> None:
    answer, words = ANSWERS[case]
    file = write(tmp_path / "bad.py", RANDOM.replace("return self.picked[-1]", f"return {answer}"))
    status, out, err = run("evaluate", "--policy", file, "--set", f"folder:{folder}", "--jobs", "1")
    assert (status, out, "Traceback" in err) == (2, "", False)
    (line,) = [li for li in err.splitlines() if li.startswith("error: ")]
    assert line.startswith("error: the policy 'drawn' picked")
    assert re.search(words, line), line


def test_policy_errors_in_the_full_setting_are_not_refusals(tmp_path: Path, armchair: Furniture) -> None:
    file = write(tmp_path / "bad.py", RANDOM.replace("return self.picked[-1]", "return [0, 1, 0, 0, 0]"))
    with pytest.raises(PolicyError, match="expected 6 integers"):
        make_agent(RolloutConfig(str(file), setting="full"))(armchair, 0)
    write(file, PLAN.format(plan=[]).replace("return out", "return out[0]"))
    with pytest.raises(
        PolicyError, match=r"`values` of the policy 'plan' has the shape \(20, 10, 10, 8, 8\), the mask"
    ):
        make_agent(RolloutConfig(str(file), setting="full", search=True))(armchair, 0)


def test_non_finite_values_are_refused(tmp_path: Path, stool: Furniture) -> None:
    file = write(tmp_path / "bad.py", PLAN.format(plan=[]).replace("-9.0", "np.nan"))
    with pytest.raises(PolicyError, match="is not a number for some action that exists"):
        make_agent(RolloutConfig(str(file), search=True))(stool, 0)
    # Where no action exists it may say what it likes.
    write(file, PLAN.format(plan=actions_of(stool, 0)).replace("np.float32(-np.inf)", "np.float32(np.nan)"))
    done = make_agent(RolloutConfig(str(file), search=True))(stool, 0)
    assert done.success
    assert list(done.actions) == actions_of(stool, 0)


def test_error_in_a_policy_keeps_its_traceback(tmp_path: Path, stool: Furniture) -> None:
    """With all that Python tells of it."""
    file = write(tmp_path / "bad.py", RANDOM.replace("return self.picked[-1]", "return self.pikced"))
    with pytest.raises(AttributeError, match="pikced") as caught:
        make_agent(RolloutConfig(str(file)))(stool, 0)
    assert str(caught.traceback[-1].path) == str(file)


# The page


def blocks() -> list[str]:
    """Files that the page shows."""
    return [
        b for b in re.findall(r"```python\n(.*?)```", DOC.read_text(), re.S) if "\npolicy = " in b or "def policy(" in b
    ]


def test_the_pages_files_play_in_both_settings(tmp_path: Path, stool: Furniture) -> None:
    assert len(blocks()) >= 2
    for index, text in enumerate(blocks()):
        file = write(tmp_path / f"policy_{index}.py", text)
        for setting, env in (("object-centric", ObjectCentricEnv), ("full", FullEnv)):
            policy = load_policy(str(file), 1)
            assert setting in policy.settings  # pyright: ignore[reportAttributeAccessIssue]
            observation, info = env(stool, cloud_points=policy.cloud_points).reset(seed=1)
            assert info["action_mask"][tuple(policy.act(observation, info["action_mask"]))]
        if hasattr(policy, "values"):
            assert solve(stool, 1, guide=guide_of(policy)).plan.success


# The example


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    pytest.importorskip("torch")
    pytest.importorskip("sb3_contrib")
    return script(write(tmp_path_factory.mktemp("example") / "masked_ppo.py", EXAMPLE.read_text()))


@pytest.mark.slow
@pytest.mark.parametrize("setting", ["object-centric", "full"])
def test_the_examples_numbers_are_the_environments_actions(example: ModuleType, stool: Furniture, setting: str) -> None:
    import torch

    inner = (FullEnv if setting == "full" else ObjectCentricEnv)(stool, cloud_points=example.CLOUD)
    env = example.Pairs(inner)
    seen, info = env.reset(seed=2)
    assert env.observation_space.contains(seen)
    mask = info["action_mask"]
    assert env.action_masks().sum() == mask.sum()
    scores = example.Scores()
    policy = example.PairPolicy({setting: scores})
    observation, _ = inner.reset(seed=2)
    values = policy.values(observation, mask)
    np.testing.assert_array_equal(np.isfinite(values), mask)
    with torch.no_grad():
        told = scores(torch.from_numpy(seen)[None], setting == "full")[0].numpy()
    # The number of an action and the action itself are worth the same.
    for number in np.random.default_rng(0).choice(np.flatnonzero(env.action_masks()), 20):
        i, j, *way = np.unravel_index(number, env.shape)
        (u, k), (v, l) = env.points[i], env.points[j]  # noqa: E741
        assert mask[(u, v, k, l, *way)]
        assert values[(u, v, k, l, *way)] == pytest.approx(told.ravel()[number], abs=1e-5)
    # How steeply a hand comes down is told as the poses have it.
    from roboassembly.geometry.poses import pose_to_euler
    from shapes import random_pose

    for some in (random_pose(np.random.default_rng(s), 1.0) for s in range(5)):
        np.testing.assert_allclose(example.rotation(pose_to_euler(some)[3:]), some.rotation, atol=1e-9)


@pytest.mark.slow
def test_the_example_learns_and_plays(example: ModuleType, run: Run, stool: Furniture, folder: Path) -> None:
    file = Path(example.__file__ or "")
    command = ("evaluate", "--policy", file, "--set", f"folder:{folder}", "--episodes", "20", "--jobs", "1", "--json")
    status, _, err = run(*command)
    assert status == 2
    assert "FileNotFoundError: no weights at" in err
    untrained = example.PairPolicy({"object-centric": example.Scores()})
    before = [rollout_policy(untrained, stool, seed) for seed in range(20)]
    done = subprocess.run(
        [sys.executable, str(file), "--steps", "6144", "--furniture", str(folder)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    report = json.loads(run(*command)[1])
    merges = [e["merges"] for e in report["per_furniture"]]
    assert np.mean(merges) > 1.0 + np.mean([len(p.plan.steps) for p in before])
    assert json.loads(run(*command, "--search")[1])["success_rate"] == 1.0
    # Of hands it knows nothing yet, and yet it chooses some.
    robots = json.loads(run(*command, "--setting", "full")[1])
    assert {len(e["actions"][0]) for e in robots["per_furniture"]} == {6}
