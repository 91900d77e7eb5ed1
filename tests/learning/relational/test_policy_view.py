"""The view of a policy: the state that it expects after a merge is the state that follows."""

from __future__ import annotations

import numpy as np
import pytest

from roboassembly.datasets import catalogue
from roboassembly.envs.object_centric import ObjectCentricEnv
from roboassembly.geometry.poses import rotations_from_euler
from roboassembly.learning.datasets import SampleSet
from roboassembly.learning.relational.policy_view import PolicyView
from roboassembly.solvers.search import solve


@pytest.mark.parametrize("name", ["cantilever:1", "panel:2"])
def test_the_expected_state_after_a_merge_is_the_state_that_follows(name: str) -> None:
    env = ObjectCentricEnv(name, cloud_points=64)
    observation, info = env.reset(seed=0)
    plan = solve(catalogue.find(name), 0).plan
    for step in plan.steps:
        u, v, k, l, _ = step.action  # noqa: E741
        before = PolicyView.from_observation(observation, info["action_mask"])
        assert not before.complete
        expected = before.after_merge(u, k, v, l)
        observation, _, _, _, info = env.step(np.array(step.action))
        found = PolicyView.from_observation(observation, info["action_mask"])
        n = len(env.state.part_poses)
        assert np.array_equal(expected.group[:n], found.group[:n])
        assert np.abs(expected.connections[..., :3] - found.connections[..., :3]).max() < 0.003
        turns = [rotations_from_euler(view.connections[:n, :n, 3:]) for view in (expected, found)]
        assert np.abs(turns[0] - turns[1]).max() < 0.01
        assert np.array_equal(expected.free, found.free)
    assert info["success"]
    assert found.complete
    assert expected.complete


def test_the_moving_group_is_expected_where_the_waiting_one_stands() -> None:
    env = ObjectCentricEnv("panel:2", cloud_points=8)
    observation, info = env.reset(seed=0)
    view = PolicyView.from_observation(observation, info["action_mask"])
    for step in solve(catalogue.find("panel:2"), 0).plan.steps:
        u, v, k, l, _ = step.action  # noqa: E741
        waiting = view.group == view.group[v]
        after = view.after_merge(u, k, v, l)
        assert np.array_equal(after.poses[waiting], view.poses[waiting])
        turns, places = rotations_from_euler(after.poses[:, 3:]), after.poses[:, :3]
        for i, j in zip(*np.nonzero(after.connections.any(axis=2)), strict=True):
            expected = turns[i] @ after.connections[i, j, :3] + places[i]
            assert np.abs(places[j] - expected).max() < 1e-6
            assert np.abs(turns[j] - turns[i] @ rotations_from_euler(after.connections[i, j, 3:])).max() < 1e-6
        assert {int(after.group[u])} <= after.moved
        view = after
    assert view.complete


def test_a_sample_and_an_observation_give_the_same_kind_of_view(cantilever: SampleSet) -> None:
    view = PolicyView.from_sample(cantilever, cantilever.samples[0])
    parts, points = view.free.shape
    assert view.action_shape == (parts, parts, points, points, 6)
    assert view.group.tolist() == list(range(parts))
    assert not view.grasps.any()
    assert np.array_equal(view.clouds, cantilever.clouds.astype(float))
