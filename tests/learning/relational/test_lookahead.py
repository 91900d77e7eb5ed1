"""Lookahead with robots: which merges it foresees, and how `act` follows them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from roboassembly.datasets import catalogue
from roboassembly.envs.full import FullEnv
from roboassembly.learning.layers import Params
from roboassembly.learning.registry import load_policy
from roboassembly.learning.relational.grasps import lookahead
from roboassembly.learning.relational.grasps.lookahead import ForeseenMerges, GraspValues, RankedActions, foresee
from roboassembly.learning.relational.policy import RelationalPolicy
from roboassembly.learning.relational.policy_view import PolicyView

Partition = frozenset[frozenset[int]]


def row_of_parts(count: int) -> PolicyView:
    """Return a view of `count` cubes; point 0 of each part fits point 1 of any other one, and so on in a ring."""
    points = np.zeros((count, count, 9))
    angle = 2.0 * np.pi * np.arange(count) / count
    points[:, :, 0], points[:, :, 1] = np.cos(angle), np.sin(angle)
    points[:, :, 3], points[:, :, 4] = np.cos(angle), np.sin(angle)
    points[:, :, 8] = 1.0
    return PolicyView(
        np.zeros((count, 4, 3)),
        points,
        np.zeros((count, count, 6)),
        np.ones((count, count), bool),
        np.arange(count),
        np.zeros((count, 8, 6)),
        np.zeros((count, 6)),
        [bytes([i]) for i in range(count)],
    )


def partition(view: PolicyView) -> Partition:
    return frozenset(frozenset(np.flatnonzero(view.group == g).tolist()) for g in np.unique(view.group))


class NoGrasps(GraspValues):
    """All grasps are certain."""

    def __init__(self) -> None:
        super().__init__({})

    def __call__(self, view: PolicyView, u: int, v: int, k: int, l: int) -> np.ndarray:  # noqa: E741
        return np.zeros((8, 8), np.float32)


class Script:
    """Ranks the merges of a state by hand.

    Args:
        preferred: for each state, the pairs of parts that may be joined there, the best first.
    """

    def __init__(self, preferred: Mapping[Partition, list[tuple[int, int]]]) -> None:
        self.preferred = preferred
        self.seen: list[Partition] = []

    def __call__(self, view: PolicyView) -> RankedActions:
        self.seen.append(partition(view))
        n = len(view.group)
        pairs = np.full((n, n, n, n), -np.inf)
        for place, (u, v) in enumerate(self.preferred.get(self.seen[-1], [])):
            pairs[u, v, v, u] = -0.1 * place
        return RankedActions(view, pairs, NoGrasps())


def split(text: str) -> Partition:
    """Return the partition that a text names, such as `01 2 3`."""
    return frozenset(frozenset(int(c) for c in group) for group in text.split())


def test_a_dead_end_is_left_by_a_merge_of_what_it_keeps_apart() -> None:
    """Once 0 and 1 are joined, 2 finds no place; whether 3 is there does not matter."""
    script = Script(
        {
            split("0 1 2 3"): [(0, 1), (0, 3), (0, 2)],
            split("01 2 3"): [(0, 3), (3, 0)],
            split("02 1 3"): [(0, 1)],
            split("012 3"): [(0, 3)],
        }
    )
    start = script(row_of_parts(4))
    assert foresee(start, script, 20) == [frozenset({0, 2}), frozenset({0, 1}), frozenset({0, 3})]
    # 0 with 3 first would end with the same groups 013 and 2, and is not looked at.
    assert script.seen == [split(text) for text in ("0 1 2 3", "01 2 3", "013 2", "02 1 3", "012 3")]


def test_the_number_of_states_is_limited() -> None:
    script = Script({split("0 1 2"): [(0, 1), (0, 2)], split("02 1"): [(0, 1)]})
    assert foresee(script(row_of_parts(3)), script, 3) == [frozenset({0, 2}), frozenset({0, 1})]
    assert foresee(script(row_of_parts(3)), script, 2) is None


def test_nothing_is_foreseen_where_every_way_ends() -> None:
    script = Script({split("0 1 2"): [(0, 1), (0, 2), (1, 2)]})
    assert foresee(script(row_of_parts(3)), script, 50) is None
    assert script.seen == [split(text) for text in ("0 1 2", "01 2", "02 1", "12 0")]


def test_grasps_decide_and_unlikely_ones_are_dead_ends() -> None:
    view = row_of_parts(3)
    pairs = np.full((3,) * 4, -np.inf)
    pairs[0, 1, 1, 0], pairs[0, 2, 2, 0] = -0.2, -0.6
    asked: list[tuple[int, int]] = []

    class Grasps(NoGrasps):
        def __call__(self, view: PolicyView, u: int, v: int, k: int, l: int) -> np.ndarray:  # noqa: E741
            asked.append((u, v))
            values = np.full((8, 8), -5.0, np.float32)
            values[3, 4] = -0.7 if v == 1 else -0.01
            return values

    ranked = RankedActions(view, pairs, Grasps())
    best = ranked.best(lambda _: True)
    # -0.2 - 0.7 is worse than -0.6 - 0.01.
    assert best is not None
    assert (best.action, best.groups) == ((0, 2, 2, 0, 3, 4), frozenset({0, 2}))
    other = ranked.best(lambda groups: groups != best.groups)
    assert other is not None
    assert other.action == (0, 1, 1, 0, 3, 4)
    assert asked == [(0, 1), (0, 2)]
    pairs[0, 1, 1, 0] = -0.4
    assert RankedActions(view, pairs, Grasps()).best(frozenset({0, 1}).__eq__) is None


def test_foreseen_merges_are_followed_while_states_are_as_expected() -> None:
    script = Script(
        {
            split("0 1 2"): [(0, 1), (0, 2)],
            split("02 1"): [(0, 1), (1, 0)],
        }
    )
    view, memory = row_of_parts(3), ForeseenMerges()
    first = memory.next(script(view), script, 20)
    assert first is not None
    assert first.groups == frozenset({0, 2})
    memory.expect(view, first.action)
    looked = len(script.seen)
    u, v, k, l = first.action[:4]  # noqa: E741
    second = memory.next(script(view.after_merge(u, k, v, l)), script, 20)
    assert second is not None
    assert second.groups == frozenset({0, 1})
    assert len(script.seen) == looked + 1
    # Another state than the expected one: a new episode.
    again = memory.next(script(view), script, 20)
    assert again == first


def test_what_the_actual_state_prefers_is_looked_at_first() -> None:
    preferred = {
        split("0 1 2 3"): [(0, 1)],
        split("01 2 3"): [(0, 2), (0, 3)],
        split("012 3"): [(0, 3)],
        split("013 2"): [(0, 2)],
    }
    script, view, memory = Script(preferred), row_of_parts(4), ForeseenMerges()
    first = memory.next(script(view), script, 20)
    assert first is not None
    memory.expect(view, first.action)
    u, v, k, l = first.action[:4]  # noqa: E741
    after = view.after_merge(u, k, v, l)
    preferred[split("01 2 3")] = [(0, 3), (0, 2)]
    second = memory.next(script(after), script, 20)
    assert second is not None
    assert second.groups == frozenset({0, 3})
    # Its dead end sends it back to what was foreseen.
    memory.expect(view, first.action)
    del preferred[split("013 2")]
    third = memory.next(script(after), script, 20)
    assert third is not None
    assert third.groups == frozenset({0, 2})


def test_after_a_hopeless_state_nothing_is_looked_at_until_another_episode_begins() -> None:
    script, view, memory = Script({split("0 1 2"): [(0, 1)]}), row_of_parts(3), ForeseenMerges()
    assert memory.next(script(view), script, 20) is None
    memory.expect(view, (0, 1, 1, 0, 0, 0))
    looked = len(script.seen)
    assert memory.next(script(view.after_merge(0, 1, 1, 0)), script, 20) is None
    assert len(script.seen) == looked + 1
    script.preferred = {split("0 1 2"): [(0, 2)], split("02 1"): [(0, 1)]}
    assert memory.next(script(view), script, 20) is not None


def test_grasps_of_untouched_groups_are_valued_once(monkeypatch: pytest.MonkeyPatch) -> None:
    view, calls = row_of_parts(4), []

    def log_probability(params: Params, features: tuple[int, ...]) -> np.ndarray:
        calls.append(features)
        return np.zeros((8, 8), np.float32)

    monkeypatch.setattr(lookahead, "grasp_features", lambda view, *mate: mate)
    monkeypatch.setattr(lookahead.grasping, "log_probability", log_probability)
    values = GraspValues({})
    values(view, 0, 1, 1, 0)
    elsewhere = view.after_merge(2, 3, 3, 2)
    values(elsewhere, 0, 1, 1, 0)
    assert len(calls) == 1
    values(view.after_merge(1, 3, 3, 1), 0, 1, 1, 0)
    assert len(calls) == 2


@pytest.mark.slow
@pytest.mark.parametrize("limit", [0, 60])
def test_the_policy_gives_up_a_merge_that_would_spoil_a_later_one(limit: int) -> None:
    """Without lookahead, the policy comes to a joint of this chair that no two arms reach."""
    policy = load_policy("relational")
    assert isinstance(policy, RelationalPolicy)
    policy = replace(policy, lookahead=limit)
    env = FullEnv(catalogue.make("windsor", 101), cloud_points=policy.cloud_points)
    observation, info = env.reset(seed=0)
    over = False
    while not over:
        observation, _, terminated, truncated, info = env.step(policy.act(observation, info["action_mask"]))
        over = terminated or truncated
    assert info["success"] == (limit > 0)
