"""Policies: what they pick is what the network says, checkpoints that do not fit are refused, acting needs no JAX."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from roboassembly.datasets import catalogue
from roboassembly.envs.object_centric import ObjectCentricEnv
from roboassembly.errors import InputError, UnknownNameError
from roboassembly.furniture.model import PAPER_PARTS, PAPER_POINTS
from roboassembly.learning import checkpoint, policy_weights
from roboassembly.learning.checkpoint import Checkpoint
from roboassembly.learning.paper import autoencoder
from roboassembly.learning.paper import network as paper
from roboassembly.learning.policy import ConfidentPolicy, RandomPolicy, guide_of, surest
from roboassembly.learning.registry import load_policy
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.policy import RelationalPolicy
from roboassembly.solvers.search import solve

CONFIG = relational.RelationalConfig(token=16, pair=8, layers=1, heads=2, conflict_inputs=4, conflicts=2)


@pytest.fixture(scope="module")
def params() -> dict:
    return relational.init(np.random.default_rng(0), CONFIG)


def save(path: Path, params: dict, network: object = None, kind: str = "relational") -> Path:
    config = {"network": asdict(CONFIG) if network is None else network}
    checkpoint.save(path, Checkpoint(kind, params, config, {}))
    return path


def test_ties_within_rounding_choose_the_first() -> None:
    values = np.full((2, 2, 1, 1, 6), -np.inf, np.float32)
    values[0, 1, 0, 0] = [1.0, 2.9999, 0.0, 3.0, 2.99, 0.0]
    assert surest(values).tolist() == [0, 1, 0, 0, 1]
    with pytest.raises(InputError, match="no action"):
        surest(np.full((2, 2, 1, 1, 6), -np.inf, np.float32))


def test_the_random_policy_takes_every_action_that_exists_and_no_other() -> None:
    mask = np.zeros((3, 3, 1, 1, 6), bool)
    mask[0, 1, 0, 0, 2] = mask[2, 0, 0, 0, 5] = mask[1, 0, 0, 0, 0] = True
    policy = RandomPolicy(np.random.default_rng(0))
    taken = [tuple(policy.act({}, mask).tolist()) for _ in range(300)]
    assert set(taken) == {(0, 1, 0, 0, 2), (2, 0, 0, 0, 5), (1, 0, 0, 0, 0)}
    assert all(taken.count(a) > 60 for a in set(taken))
    again = RandomPolicy(np.random.default_rng(0))
    assert [tuple(again.act({}, mask).tolist()) for _ in range(300)] == taken
    with pytest.raises(InputError, match="no action"):
        policy.act({}, np.zeros_like(mask))


def test_names_and_files(params: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert load_policy("random", 3).name == "random"
    with pytest.raises(UnknownNameError, match="did you mean relational"):
        load_policy("relatonal")
    with pytest.raises(InputError, match=r"no checkpoint at 'gone\.npz'"):
        load_policy("gone.npz")
    loaded = load_policy(str(save(tmp_path / "p.npz", params)))
    assert isinstance(loaded, RelationalPolicy)
    assert isinstance(loaded, ConfidentPolicy)
    assert loaded.cloud_points == 2048
    np.testing.assert_array_equal(loaded.params["q"]["w"], params["q"]["w"])
    # What is shipped is read from the package's own folder.
    monkeypatch.setattr(policy_weights.resources, "files", lambda package: tmp_path)
    with pytest.raises(InputError, match="no weights for the policy 'relational'"):
        load_policy("relational")
    save(tmp_path / "weights" / "relational.npz", params)
    assert load_policy("relational").name == "relational"


def _without(params: dict, *path: str) -> dict:
    name, *rest = path
    if not rest:
        return {k: v for k, v in params.items() if k != name}
    return {**params, name: _without(params[name], *rest)}


NETWORK = asdict(CONFIG)
BAD: dict[str, tuple[Callable[[dict], dict], object, str]] = {
    "no sizes": (dict, {"token": 16}, "should hold token, pair"),
    "not sizes": (dict, [1, 2], "should hold token, pair"),
    "negative": (dict, {**NETWORK, "pair": -8}, r"\['pair'\] is -8; expected 1 to 4096"),
    "huge": (dict, {**NETWORK, "token": 10**9}, "is 1000000000"),
    "text": (dict, {**NETWORK, "layers": "many"}, "is 'many'; expected one like 3"),
    "heads": (dict, {**NETWORK, "heads": 3}, "3 heads do not divide tokens of 16"),
    "other sizes": (dict, {**NETWORK, "token": 32}, r"'/patch/1/w' is float32 \(128, 16\); .* \(128, 32\)"),
    "more layers": (dict, {**NETWORK, "layers": 2}, r"at '/blocks' it lacks \['1'\]"),
    "array gone": (lambda p: _without(p, "pair", "0", "b"), NETWORK, r"at '/pair/0' it lacks \['b'\]"),
    "array more": (lambda p: {**p, "z": np.zeros(2, np.float32)}, NETWORK, r"has \['z'\] besides"),
    "not nested": (lambda p: {**p, "q": np.zeros(2, np.float32)}, NETWORK, "'/q' is not what"),
    "whole numbers": (lambda p: {**p, "q": {"w": np.zeros((32, 1), int), "b": p["q"]["b"]}}, NETWORK, "int64"),
    "not finite": (lambda p: {**p, "q": {**p["q"], "b": np.full(1, np.nan, np.float32)}}, NETWORK, "not finite"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_checkpoint_that_does_not_fit_is_refused_with_the_reason(params: dict, tmp_path: Path, case: str) -> None:
    change, network, words = BAD[case]
    with pytest.raises(InputError, match=words):
        load_policy(str(save(tmp_path / "bad.npz", change(params), network)))


def test_a_paper_checkpoint(first_state, tmp_path: Path) -> None:
    rng, config = np.random.default_rng(0), paper.PaperConfig(hidden=8, feature=8, slot=4)
    inputs = {
        "mean": np.zeros(paper.state_size(False), np.float32),
        "scale": np.ones(paper.state_size(False), np.float32),
    }
    whole = {"network": paper.init(rng, config), "inputs": inputs, "encoder": autoencoder.init(rng)}
    policy = load_policy(str(save(tmp_path / "p.npz", whole, asdict(config), "paper")))
    observation, mask = first_state
    assert mask[tuple(policy.act(observation, mask))]
    assert guide_of(policy) is not None
    with pytest.raises(InputError, match=r"'/network/state/0/.*w' is float32 \(6320, 8\); .* \(6320, 16\)"):
        load_policy(str(save(tmp_path / "p.npz", whole, {**asdict(config), "hidden": 16}, "paper")))
    with pytest.raises(InputError, match=r"lacks \['inputs'\]"):
        load_policy(str(save(tmp_path / "p.npz", _without(whole, "inputs"), asdict(config), "paper")))


def test_other_kinds_are_refused(params: dict, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds a 'autoencoder' network, which is no policy"):
        load_policy(str(save(tmp_path / "other.npz", params, kind="autoencoder")))
    (tmp_path / "junk.npz").write_bytes(b"PK\x03\x04 not really")
    with pytest.raises(InputError, match="not a checkpoint"):
        load_policy(str(tmp_path / "junk.npz"))


def test_acting_imports_no_jax(params: dict, tmp_path: Path) -> None:
    file = save(tmp_path / "p.npz", params)
    script = (
        "import sys\n"
        "from roboassembly.evaluation.rollout import run_episode\n"
        "from roboassembly.learning.registry import load_policy\n"
        "from roboassembly.datasets import catalogue\n"
        "run_episode(load_policy(sys.argv[1]), catalogue.make('cantilever', 1), 0)\n"
        "assert 'jax' not in sys.modules and 'optax' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", script, str(file)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


class Knows:
    """Values the actions of a plan, each a little less than the one before; all else nothing."""

    name = "knows"
    cloud_points = 1

    def __init__(self, actions: list[tuple[int, ...]]) -> None:
        self._actions = actions

    def values(self, observation, mask) -> np.ndarray:
        out = np.where(mask, np.float32(-9.0), np.float32(-np.inf))
        for index, action in enumerate(self._actions):
            if mask[action]:
                out[action] = -0.1 * index
        return out

    def act(self, observation, mask) -> np.ndarray:
        return surest(self.values(observation, mask))


def test_a_policy_guides_the_search() -> None:
    furniture = catalogue.make("stool", 1)
    plain = solve(furniture, 5)
    policy = Knows([step.action for step in plain.plan.steps])
    result = solve(furniture, 5, guide=guide_of(policy))
    assert result.plan.success
    assert result.guided == len(furniture.parts) - 1
    assert [s.action for s in result.plan.steps] == [s.action for s in plain.plan.steps]
    with pytest.raises(InputError, match="'random' does not value actions"):
        guide_of(load_policy("random"))


def test_guide_suggests_existing_actions_best_first(params: dict) -> None:
    env = ObjectCentricEnv("cantilever:1")
    env.reset(seed=0)
    mask = env.action_mask
    suggestions = guide_of(RelationalPolicy(params))(env.task, env.state)
    assert 5 <= len(suggestions) <= 32
    assert all(mask[s.action] and 0.0 < s.score < 1.0 for s in suggestions)
    scores = [s.score for s in suggestions]
    assert all(a >= b - 1e-3 for a, b in pairwise(scores))
    # The environment's own mask, at the guide's padding, is what the guide goes by.
    assert mask.shape == (PAPER_PARTS, PAPER_PARTS, PAPER_POINTS, PAPER_POINTS, 6)
    # Policies that know no chances suggest by odds: the best has 1.
    first, second, *_ = guide_of(Knows([(0, 1, 0, 0, 2)]))(env.task, env.state)
    assert (first.action, first.score) == ((0, 1, 0, 0, 2), 1.0)
    assert second.score == pytest.approx(np.exp(-9.0), rel=1e-3)
