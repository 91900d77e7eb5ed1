"""The relational network: equivariant, the same on NumPy and JAX, averaged over augmentations."""

from __future__ import annotations

import jax
import numpy as np
from relational_cases import TINY, observed

from roboassembly.learning.augmentation import AUGMENTATIONS, augmented, up_axis_permutation
from roboassembly.learning.batches import padded_length
from roboassembly.learning.datasets import SampleSet
from roboassembly.learning.layers import Params
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.policy_view import PolicyView
from roboassembly.learning.relational.tokens import Tokens, pad, tokens_of, tokens_of_sample


def q_values(params: Params, tokens: Tokens) -> np.ndarray:
    n = len(tokens.part)
    return relational.apply(params, pad([tokens], padded_length(n)))[1][0, :n, :n]


def test_values_follow_a_renumbering_of_parts() -> None:
    observation, mask = observed(0)
    order = np.random.default_rng(3).permutation(len(mask))
    shuffled = {k: v[order] for k, v in observation.items()}
    shuffled["connections"] = shuffled["connections"][:, order]
    params = relational.init(np.random.default_rng(0), TINY)
    plain = tokens_of(PolicyView.from_observation(observation, mask))
    renumbered = tokens_of(PolicyView.from_observation(shuffled, mask[order][:, order]))
    row = {(int(order[p]), int(k)): i for i, (p, k) in enumerate(zip(renumbered.part, renumbered.point, strict=True))}
    index = [row[int(p), int(k)] for p, k in zip(plain.part, plain.point, strict=True)]
    assert np.allclose(q_values(params, renumbered)[np.ix_(index, index)], q_values(params, plain), atol=1e-4)


def test_numpy_and_jax_agree_and_padding_changes_nothing(cantilever: SampleSet) -> None:
    params = relational.init(np.random.default_rng(0), TINY)
    tokens = [tokens_of_sample(cantilever, sample) for sample in cantilever.samples]
    counts = [len(t.part) for t in tokens]
    narrow, wide = (pad(tokens, length) for length in (padded_length(max(counts)), 48))
    on_numpy = relational.apply(params, narrow)
    on_jax = jax.jit(relational.apply)(params, wide)
    for row, count in enumerate(counts):
        for a, b in zip(on_numpy, on_jax, strict=True):
            assert np.allclose(a[row, :count, :count], np.asarray(b)[row, :count, :count], atol=1e-4)
        assert not np.asarray(on_jax[2])[row, count:].any()


def test_values_are_averaged_over_augmentations(cantilever: SampleSet) -> None:
    params = relational.init(np.random.default_rng(0), TINY)
    tokens, change = tokens_of_sample(cantilever, cantilever.samples[0]), AUGMENTATIONS[5]
    plain = relational.values(params, tokens)
    assert np.array_equal(plain, relational.values(params, tokens, AUGMENTATIONS[:1]))
    other = augmented(cantilever, change)
    changed = relational.values(params, tokens_of_sample(other, other.samples[0]))[..., up_axis_permutation(change)]
    both = relational.values(params, tokens, (AUGMENTATIONS[0], change))
    valid = np.isfinite(plain)
    assert np.allclose(both[valid], 0.5 * (plain + changed)[valid], atol=1e-2)
    assert np.isneginf(both[~valid]).all()
