"""The PointNet auto-encoder: Chamfer by hand, the order of points, sizes, resuming."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from roboassembly.errors import InputError
from roboassembly.learning import checkpoint
from roboassembly.learning.paper import autoencoder
from roboassembly.learning.paper.autoencoder import FEATURE, AutoencoderTraining


def test_chamfer_by_hand() -> None:
    a = np.array([[[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]])
    b = np.array([[[0.0, 0.0, 1.0], [2.0, 0.0, 0.0], [5.0, 0.0, 0.0]]])
    # From a: 1 and 0, mean 0.5. From b: 1, 0 and 9, mean 10 / 3. Squared, and not averaged over the two.
    assert autoencoder.chamfer(a, b) == pytest.approx([0.5 + 10.0 / 3.0])
    assert autoencoder.chamfer(b, a) == pytest.approx(autoencoder.chamfer(a, b))
    assert autoencoder.chamfer(a, a) == pytest.approx([0.0])


def _clouds(count: int, points: int = 32) -> np.ndarray:
    rng = np.random.default_rng(0)
    return (rng.normal(size=(count, points, 3)) * rng.uniform(0.01, 0.4, (count, 1, 3))).astype(np.float32)


def test_order_of_points_does_not_matter_size_does() -> None:
    params, clouds = autoencoder.init(np.random.default_rng(1)), _clouds(4)
    features = autoencoder.encode(params, clouds)
    assert features.shape == (4, FEATURE)
    shuffled = np.random.default_rng(2).permutation(clouds, axis=1)
    np.testing.assert_allclose(autoencoder.encode(params, shuffled), features, atol=1e-5)
    twice = autoencoder.encode(params, 2.0 * clouds)
    np.testing.assert_allclose(twice[:, :-4], features[:, :-4], atol=1e-5)
    np.testing.assert_allclose(twice[:, -4:], 2.0 * features[:, -4:], atol=1e-5)


def test_numpy_and_jax_agree() -> None:
    jnp = pytest.importorskip("jax.numpy")
    params, clouds = autoencoder.init(np.random.default_rng(1)), _clouds(3)
    np.testing.assert_allclose(
        autoencoder.encode(params, clouds), autoencoder.encode(params, jnp.asarray(clouds)), atol=1e-5
    )


@pytest.mark.slow
def test_learns_and_resumes_to_the_same_weights(tmp_path: Path) -> None:
    pytest.importorskip("jax")
    clouds, training = _clouds(12), AutoencoderTraining(steps=30, batch=4, keep_every=0.0)
    losses = [terms["chamfer"] for _, terms in autoencoder.train(clouds, tmp_path / "a.npz", training, {})]
    assert np.mean(losses[-5:]) < 0.7 * losses[0]
    for step, _ in autoencoder.train(clouds, tmp_path / "b.npz", training, {}):
        if step == 11:
            break
    first, *_ = autoencoder.train(clouds, tmp_path / "b.npz", training, {})
    assert first[0] in (11, 12)
    whole, resumed = (checkpoint.load(tmp_path / f"{n}.npz", autoencoder.KIND).params for n in "ab")
    np.testing.assert_allclose(whole["encoder"]["0"]["w"], resumed["encoder"]["0"]["w"], atol=1e-6)


def test_other_training_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("jax")
    clouds = _clouds(4)
    list(autoencoder.train(clouds, tmp_path / "a.npz", AutoencoderTraining(steps=1, batch=2), {"set": "one"}))
    with pytest.raises(InputError, match="trained with other set"):
        next(autoencoder.train(clouds, tmp_path / "a.npz", AutoencoderTraining(steps=1, batch=2), {"set": "other"}))
