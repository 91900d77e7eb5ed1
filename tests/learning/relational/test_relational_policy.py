"""The relational policy: values, both settings, its checkpoint."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from relational_cases import TINY

from roboassembly.datasets import catalogue
from roboassembly.envs.full import FullEnv
from roboassembly.envs.object_centric import ObjectCentricEnv
from roboassembly.errors import InputError
from roboassembly.evaluation.rollout import RolloutConfig, make_agent, rollout_policy
from roboassembly.learning import checkpoint
from roboassembly.learning.datasets import CLOUD_POINTS
from roboassembly.learning.layers import Params
from roboassembly.learning.registry import load_policy
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational import policy as policies
from roboassembly.learning.relational.features import sunk
from roboassembly.learning.relational.grasps import network as grasping
from roboassembly.learning.relational.layout_search import Layout, LayoutProblem, find_layouts
from roboassembly.learning.relational.policy import RelationalPolicy
from roboassembly.learning.relational.policy_view import PolicyView
from roboassembly.learning.relational.tokens import tokens_of
from roboassembly.task.full.failure import FullVerdict


@pytest.fixture(scope="module")
def params() -> Params:
    return relational.init(np.random.default_rng(0), TINY)


def test_rounding_does_not_choose_between_equal_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last bits of a product may depend on where in memory its factors lie."""
    env = ObjectCentricEnv("stool:1", cloud_points=CLOUD_POINTS)
    observation, info = env.reset(seed=0)
    mask = info["action_mask"]
    policy = load_policy("relational")
    assert isinstance(policy, RelationalPolicy)
    chosen = policy.act(observation, mask)
    exact, rng = relational.judged, np.random.default_rng(0)

    def noisy(params, tokens, augmentations):
        fits, q = exact(params, tokens, augmentations)
        return tuple(x + rng.uniform(-1e-6, 1e-6, size=x.shape).astype(np.float32) for x in (fits, q))

    monkeypatch.setattr(relational, "judged", noisy)
    for _ in range(5):
        np.testing.assert_array_equal(policy.act(observation, mask), chosen)


def test_values_are_those_of_the_network_at_the_right_places(
    params: Params, first_state: tuple[dict[str, np.ndarray], np.ndarray]
) -> None:
    observation, mask = first_state
    policy = RelationalPolicy(params, layout_width=0)
    values = policy.values(observation, mask)
    assert values.dtype == np.float32
    np.testing.assert_array_equal(np.isfinite(values), mask)
    tokens = tokens_of(PolicyView.from_observation(observation, mask))
    sinks = sunk(tokens.bounds)
    q = relational.values(params, tokens) - 10.0 * sinks
    row, column, w = np.unravel_index(np.argmax(q), q.shape)
    best = (tokens.part[row], tokens.part[column], tokens.point[row], tokens.point[column], w)
    assert values[best] == values.max()
    assert sinks[np.isfinite(q)].any()
    rng = np.random.default_rng(1)
    for i, j in rng.integers(len(tokens.part), size=(50, 2)):
        here = values[tokens.part[i], tokens.part[j], tokens.point[i], tokens.point[j]]
        np.testing.assert_allclose(here, q[i, j], rtol=0, atol=0.00051)
    action = policy.act(observation, mask)
    assert mask[tuple(action)]
    assert values[tuple(action)] >= values.max() - 1e-3
    chance = policy.probabilities(observation, mask)
    np.testing.assert_allclose(chance[mask], 1.0 / (1.0 + np.exp(-values[mask])), rtol=1e-4, atol=1e-6)
    assert not chance[~mask].any()


def test_choices_are_mates_of_the_layout(
    first_state: tuple[dict[str, np.ndarray], np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only pairs of the layout keep their values, and a pair that is known to be wrong is in none."""
    observation, mask = first_state
    policy = load_policy("relational")
    assert isinstance(policy, RelationalPolicy)
    tokens = tokens_of(PolicyView.from_observation(observation, mask))
    free = replace(policy, layout_width=0).values(observation, mask)
    found: list[list[Layout]] = []

    def find(problem: LayoutProblem, width: int) -> list[Layout]:
        found.append(find_layouts(problem, width))
        return found[-1]

    monkeypatch.setattr(policies, "find_layouts", find)
    values = policy.values(observation, mask)
    assert found[0]
    placed_by = frozenset[tuple[int, int]]().union(*(layout.placed_by for layout in found[0]))
    inside = np.zeros((len(tokens.part), len(tokens.part)), bool)
    for k, l in placed_by:  # noqa: E741
        inside[k, l] = inside[l, k] = True
    u, k = tokens.part[:, None], tokens.point[:, None]
    v, l = tokens.part[None], tokens.point[None]  # noqa: E741
    valid = tokens.group[:, None] != tokens.group
    changed = (values[u, v, k, l] < free[u, v, k, l] - 10.0).all(axis=2)
    assert np.array_equal(changed[valid], ~inside[valid])
    row, column = min(placed_by)
    pair = int(tokens.part[row]), int(tokens.part[column]), int(tokens.point[row]), int(tokens.point[column])
    policy.revised_values(observation, mask, [pair])
    assert all((row, column) not in layout.placed_by for layout in found[1])


@pytest.mark.slow
def test_a_policy_with_a_grasp_network_acts_in_the_full_setting() -> None:
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
    *_, info = env.step(action)
    # It knows pairs, but no grasps.
    assert info["verdict"] not in (FullVerdict.WRONG_PAIR, FullVerdict.NOT_AN_ACTION)
    random = make_agent(RolloutConfig("random", setting="full"))(furniture, 0)
    assert (random.success, len(random.actions)) == (False, random.merges + 1)
    done = make_agent(RolloutConfig(policy, setting="full"))(furniture, 0)
    assert done.actions
    assert len(done.actions[0]) == 6
    with pytest.raises(InputError, match="has no grasp network"):
        replace(shipped, grasp_params=None).values(observation, mask)


def test_a_checkpoint_may_hold_a_grasp_network(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    grasps, params = grasping.init(rng), relational.init(rng, relational.RelationalConfig())
    config = {"network": asdict(relational.RelationalConfig())}
    whole = checkpoint.Checkpoint(relational.KIND, {**params, "grasps": grasps}, config, {})
    checkpoint.save(tmp_path / "p.npz", whole)
    policy = load_policy(str(tmp_path / "p.npz"))
    assert isinstance(policy, RelationalPolicy)
    assert policy.settings == ("object-centric", "full")
    broken = {**grasps, "grasp_pair": {"w": grasps["grasp_pair"]["w"][:2], "b": grasps["grasp_pair"]["b"]}}
    checkpoint.save(tmp_path / "p.npz", replace(whole, params={**params, "grasps": broken}))
    with pytest.raises(InputError, match="grasp_pair"):
        load_policy(str(tmp_path / "p.npz"))


def test_meshes_show_a_lock_that_clouds_do_not() -> None:
    """A folding chair that the policy locks up if it knows the clouds of its parts only."""
    chair, policy = catalogue.make("folding", 5), load_policy("relational")
    without, first, again = (rollout_policy(policy, chair, 0, meshes=known) for known in (False, True, True))
    assert not without.plan.success
    assert first.plan.success
    assert first.actions == again.actions
