"""Tokens: invariant to world poses, cached without a difference, padded."""

from __future__ import annotations

import numpy as np
from relational_cases import observed

from roboassembly.learning.datasets import SampleSet
from roboassembly.learning.relational.policy_view import PolicyView
from roboassembly.learning.relational.tokens import TokenCache, Tokens, pad, tokens_of, tokens_of_sample


def test_tokens_do_not_depend_on_where_parts_lie() -> None:
    a, b = (tokens_of(PolicyView.from_observation(*observed(seed))) for seed in (0, 1))
    assert not np.allclose(observed(0)[0]["poses"], observed(1)[0]["poses"])
    for name in ("patch", "features", "matches", "bounds", "cycles_3", "cycles_4"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name


def test_a_cache_changes_nothing(cantilever: SampleSet) -> None:
    cache = TokenCache(max_entries=40)
    for sample in cantilever.samples:
        fresh, cached = tokens_of_sample(cantilever, sample), tokens_of_sample(cantilever, sample, cache)
        for name in Tokens.__dataclass_fields__:
            assert np.array_equal(getattr(fresh, name), getattr(cached, name)), name


def test_a_cache_drops_all_entries_when_it_is_full() -> None:
    cache, computed = TokenCache(max_entries=2), []

    def compute() -> int:
        computed.append(1)
        return len(computed)

    assert [cache.get(key, compute) for key in (b"a", b"b", b"a")] == [1, 2, 1]
    # The third key empties the cache first.
    assert [cache.get(key, compute) for key in (b"c", b"a")] == [3, 4]


def test_padding_adds_tokens_without_a_group(cantilever: SampleSet) -> None:
    states = [tokens_of_sample(cantilever, sample) for sample in cantilever.samples[:2]]
    batch = pad(states, 32)
    assert "grasps" not in batch
    for row, state in enumerate(states):
        n = len(state.part)
        assert np.array_equal(batch["group"][row], [*state.group, *[-1] * (32 - n)])
        assert np.array_equal(batch["matches"][row, :n, :n], state.matches)
        assert np.array_equal(batch["features"][row, :n], state.features)
        assert not batch["matches"][row, n:].any()
        assert not batch["bounds"][row, :, n:].any()
