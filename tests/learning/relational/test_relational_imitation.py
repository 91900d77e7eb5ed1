"""Imitation of the oracle: losses, batches, training that continues where it stopped."""

from __future__ import annotations

from pathlib import Path

import jax
import numpy as np
import pytest
from relational_cases import TINY

from roboassembly.datasets import catalogue
from roboassembly.envs.observation import surface_points
from roboassembly.errors import InputError
from roboassembly.learning import checkpoint
from roboassembly.learning.batches import padded_length
from roboassembly.learning.datasets import SampleSet
from roboassembly.learning.relational import imitation
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.collect import collect
from roboassembly.learning.relational.examples import examples_of, load_examples
from roboassembly.learning.relational.oracle_dataset import Labeler


def test_an_epoch_shows_every_state_and_resumes_anywhere(cantilever: SampleSet) -> None:
    examples = examples_of([cantilever])
    training = imitation.RelationalTraining(batch=2, augment=False)
    whole = list(imitation.epoch(examples, np.random.default_rng(0), training))
    assert len(whole) == imitation.epoch_length(examples, 2)
    rest = list(imitation.epoch(examples, np.random.default_rng(0), training, first=1))
    for a, b in zip(whole[1:], rest, strict=True):
        assert all(np.array_equal(a[name], b[name]) for name in a)
    shown = {batch["fits"][row].tobytes() for batch in whole for row in range(len(batch["fits"]))}
    assert len(shown) >= len(examples)


@pytest.mark.slow
def test_dead_ends_teach_that_no_action_is_viable() -> None:
    furniture = catalogue.make("windsor", 0)
    clouds = np.array([surface_points(p.mesh, 64) for p in furniture.parts], np.float32)
    labeler = Labeler(furniture, clouds)
    episode = labeler.rollout(np.random.default_rng(1))
    examples = examples_of([labeler.sample_set((*episode.states, *episode.dead_ends))])
    assert [e.viable.any() for e in examples] == [True] * len(episode.states) + [False] * len(episode.dead_ends)
    # Which action is chosen in a dead end does not matter.
    params = relational.init(np.random.default_rng(0), TINY)
    dead = [e for e in examples if not e.viable.any()][:2]
    batch = imitation.batch_of(dead, padded_length(max(len(e.fits) for e in dead)))
    _, terms = jax.jit(imitation.losses)(params, batch)
    assert not np.asarray(terms["choice"]).any()
    assert (np.asarray(terms["values"]) > 0.0).all()
    assert imitation.viable_share(params, examples) == imitation.viable_share(params, examples[: len(episode.states)])


def test_the_viable_share_counts_states_whose_best_action_is_viable(tmp_path: Path) -> None:
    list(collect(["cantilever:1"], tmp_path, episodes=1, seed=0, jobs=1))
    examples = load_examples(tmp_path, ["cantilever:1"], 1)
    params = relational.init(np.random.default_rng(1), TINY)
    viable: list[bool] = []
    for e in examples:
        q = relational.values(params, e.tokens)
        if e.viable.any():
            viable.append(bool(e.viable[np.unravel_index(np.argmax(q), q.shape)]))
    assert imitation.viable_share(params, examples) == pytest.approx(np.mean(viable))


@pytest.mark.slow
def test_a_gradient_is_the_same_in_pieces(cantilever: SampleSet) -> None:
    examples = examples_of([cantilever])[:4]
    params = relational.init(np.random.default_rng(0), TINY)
    batch = imitation.batch_of(examples, 48)  # 192 tokens: pieces of two states
    (loss, _), whole = jax.jit(jax.value_and_grad(imitation.losses, has_aux=True))(params, batch)
    found, terms = imitation.gradient_of(params, batch)
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(found), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-5)
    assert terms["loss"] == pytest.approx(float(loss), rel=1e-5)


@pytest.mark.slow
def test_training_fits_one_chair_and_continues_where_it_was_killed(cantilever: SampleSet, tmp_path: Path) -> None:
    examples = examples_of([cantilever])
    training = imitation.RelationalTraining(steps=40, learning_rate=1e-2, warmup=5, batch=2, keep_every=0.0)
    whole = list(imitation.train(examples, tmp_path / "whole.npz", training, TINY, {}))
    assert whole[-1][1]["loss"] < 0.5 * whole[0][1]["loss"]
    assert np.mean([terms["chosen"] for _, terms in whole[-10:]]) > 0.9

    run = imitation.train(examples, tmp_path / "killed.npz", training, TINY, {})
    for step, _ in run:
        if step == 21:
            break
    del run
    rest = list(imitation.train(examples, tmp_path / "killed.npz", training, TINY, {}))
    assert rest[0][0] == 22
    assert rest[-1][0] == 40
    ends = [checkpoint.load(tmp_path / name, "relational").params for name in ("whole.npz", "killed.npz")]
    assert all(np.array_equal(a, b) for a, b in zip(*map(jax.tree.leaves, ends), strict=True))
    with pytest.raises(InputError, match="other training"):
        next(imitation.train(examples, tmp_path / "killed.npz", imitation.RelationalTraining(steps=7), TINY, {}))
