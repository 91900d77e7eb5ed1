"""The paper's part encoder: a PointNet auto-encoder of part clouds, trained with the Chamfer distance.

Each point goes through the same small network, and the largest value of each channel over all points is kept (Qi et
al. 2017, "PointNet"). A decoder reconstructs the cloud from these values. The loss is the Chamfer distance (Fan et al.
2017, "A Point Set Generation Network"). After training the encoder is frozen and extracts features of parts.

Parts measure a centimetre to a metre. Clouds are therefore centred and scaled to unit radius first, so that small
parts are reconstructed as well as large ones; centre and radius are appended to the feature.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from roboassembly.learning.fit import Batch, Fit, FitConfig
from roboassembly.learning.layers import Array, Params, init_mlp, mlp

KIND = "autoencoder"
"""Kind of the checkpoints."""
CODE = 44
"""Size of the code."""
CLOUD_POINTS = 512
"""Points of a part's cloud."""
FEATURE = CODE + 4
"""Size of a part's feature: the code, the cloud's centre and its radius [m]."""
_DECODED_POINTS = 128


def init(rng: np.random.Generator) -> Params:
    """Return fresh weights."""
    return {
        "encoder": init_mlp(rng, 3, 64, 128, CODE),
        "decoder": init_mlp(rng, CODE, 128, 256, 3 * _DECODED_POINTS),
    }


def normalized(clouds: Array) -> tuple[Array, Array, Array]:
    """Return clouds (b, n, 3) centred and scaled to unit radius, their centres (b, 3) and radii (b, 1)."""
    xp = clouds.__array_namespace__()
    center = xp.mean(clouds, axis=1)
    offset = clouds - center[:, None]
    radius = xp.sqrt(xp.max(xp.sum(offset * offset, axis=2), axis=1))[:, None]
    return offset / xp.maximum(radius[:, None], 1e-6), center, radius


def encode(p: Params, clouds: Array) -> Array:
    """Return features (b, 48) of clouds (b, n, 3) in metres; the order of the points does not matter."""
    xp = clouds.__array_namespace__()
    unit, center, radius = normalized(clouds)
    return xp.concatenate([_code(p, unit), center, radius], axis=1)


def _code(p: Params, unit: Array) -> Array:
    return unit.__array_namespace__().max(mlp(p["encoder"], unit), axis=1)


def reconstruct(p: Params, unit: Array) -> Array:
    """Return clouds (b, 128, 3) decoded from the codes of clouds (b, n, 3) of unit radius."""
    xp = unit.__array_namespace__()
    return xp.reshape(mlp(p["decoder"], _code(p, unit)), (unit.shape[0], _DECODED_POINTS, 3))


def chamfer(a: Array, b: Array) -> Array:
    """Return the (batch,) Chamfer distances of clouds (batch, n, 3) and (batch, m, 3).

    The mean squared distance of each point of `a` to the nearest of `b`, plus the same from `b` to `a`.
    """
    xp = a.__array_namespace__()
    # |a - b|^2 by products: a tenth of the memory that differences would take.
    squares = xp.sum(a * a, axis=2)[:, :, None] + xp.sum(b * b, axis=2)[:, None]
    distance = xp.maximum(squares - 2.0 * a @ xp.swapaxes(b, 1, 2), 0.0)
    return xp.mean(xp.min(distance, axis=2), axis=1) + xp.mean(xp.min(distance, axis=1), axis=1)


@dataclass(frozen=True)
class AutoencoderTraining(FitConfig):
    """Settings of the auto-encoder's training."""

    steps: int = 4_000
    """Number of gradient steps."""


def train(
    clouds: Float[np.ndarray, "c n 3"], path: Path, training: AutoencoderTraining, notes: dict[str, Any]
) -> Iterator[tuple[int, dict[str, float]]]:
    """Train until `training.steps`, from the checkpoint at `path` if there is one; yields step and loss.

    Args:
        clouds: clouds of parts [m]. Each step takes some of them, half of the points to encode, all to compare with.
        path: file of the checkpoint.
        training: settings of the training.
        notes: origin of the clouds, kept in the checkpoint.

    Raises:
        InputError: the checkpoint at `path` is of other training.
    """
    import jax
    import optax

    optimiser = optax.adam(optax.cosine_decay_schedule(training.learning_rate, training.steps))

    def loss(p: Params, half: Array, whole: Array) -> Array:
        return chamfer(reconstruct(p, half), whole).mean()

    @jax.jit
    def step(p: Any, opt_state: Any, half: Array, whole: Array) -> tuple[Any, Any, Array]:
        value, gradient = jax.value_and_grad(loss)(p, half, whole)
        change, opt_state = optimiser.update(gradient, opt_state, p)
        return optax.apply_updates(p, change), opt_state, value

    def update(p: Params, opt_state: Any, batch: Batch) -> tuple[Params, Any, dict[str, Array]]:
        p, opt_state, value = step(p, opt_state, batch["half"], batch["whole"])
        return p, opt_state, {"chamfer": value}

    def batches(first: int) -> Iterator[Batch]:
        unit = np.asarray(normalized(clouds.astype(np.float32))[0])
        for number in range(first, training.steps):
            rng = np.random.default_rng([training.seed, number])
            chosen = unit[rng.integers(len(unit), size=training.batch)]
            points = rng.permutation(chosen.shape[1])
            yield {"half": chosen[:, points[: len(points) // 2]], "whole": chosen}

    def init_params() -> Params:
        return init(np.random.default_rng(training.seed))

    yield from Fit(path, KIND, training, notes).run(init_params, optimiser.init, update, batches)
