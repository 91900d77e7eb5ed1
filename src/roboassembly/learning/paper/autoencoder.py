"""What a part looks like, in a few numbers: a PointNet auto-encoder, as the paper's.

Each point goes through the same small network, the largest value of each channel over all points is kept (Qi et al.
2017, "PointNet"), and a second network draws the cloud again from that. The loss is the Chamfer distance (Fan et al.
2017, "A Point Set Generation Network"). Afterwards the encoder is fixed and serves as the extractor of features.

Parts measure a centimetre to a metre. So that small ones are drawn as well as large ones, clouds are centred and scaled
to unit radius first; centre and radius are appended to the feature.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from roboassembly.learning.layers import Array, Params, init_mlp, mlp

KIND = "autoencoder"
"""Of checkpoints."""
CODE = 44
CLOUD_POINTS = 512
"""A part, as it is encoded."""
FEATURE = CODE + 4
"""Numbers that describe a part: the code, the cloud's centre and its radius (both in metres)."""
_DRAWN = 128
"""Points that the decoder draws."""


def init(rng: np.random.Generator) -> Params:
    """Fresh weights."""
    return {"point": init_mlp(rng, 3, 64, 128, CODE), "draw": init_mlp(rng, CODE, 128, 256, 3 * _DRAWN)}


def normalized(clouds: Array) -> tuple[Array, Array, Array]:
    """Clouds (b, n, 3) centred and scaled to unit radius, their centres (b, 3) and radii (b, 1)."""
    xp = clouds.__array_namespace__()
    center = xp.mean(clouds, axis=1)
    apart = clouds - center[:, None]
    radius = xp.sqrt(xp.max(xp.sum(apart * apart, axis=2), axis=1))[:, None]
    return apart / xp.maximum(radius[:, None], 1e-6), center, radius


def encode(p: Params, clouds: Array) -> Array:
    """Features (b, 48) of clouds (b, n, 3) in metres; the order of the points does not matter."""
    xp = clouds.__array_namespace__()
    unit, center, radius = normalized(clouds)
    return xp.concatenate([_code(p, unit), center, radius], axis=1)


def _code(p: Params, unit: Array) -> Array:
    return unit.__array_namespace__().max(mlp(p["point"], unit), axis=1)


def reconstruct(p: Params, unit: Array) -> Array:
    """Clouds (b, 128, 3) drawn from the codes of clouds (b, n, 3) of unit radius."""
    xp = unit.__array_namespace__()
    return xp.reshape(mlp(p["draw"], _code(p, unit)), (unit.shape[0], _DRAWN, 3))


def chamfer(a: Array, b: Array) -> Array:
    """(batch,) Chamfer distance of clouds (batch, n, 3) and (batch, m, 3).

    Mean squared distance of each point of `a` to the nearest of `b`, plus the same from `b` to `a`.
    """
    xp = a.__array_namespace__()
    # |a - b|^2 told by products: a tenth of the memory that differences would take.
    squares = xp.sum(a * a, axis=2)[:, :, None] + xp.sum(b * b, axis=2)[:, None]
    apart = xp.maximum(squares - 2.0 * a @ xp.swapaxes(b, 1, 2), 0.0)
    return xp.mean(xp.min(apart, axis=2), axis=1) + xp.mean(xp.min(apart, axis=1), axis=1)


@dataclass(frozen=True)
class Training:
    """How to train."""

    steps: int = 4_000
    learning_rate: float = 1e-3
    batch: int = 32
    seed: int = 0
    keep_every: float = 60.0
    """Seconds between checkpoints."""


def train(
    clouds: Float[np.ndarray, "c n 3"], path: Path, training: Training, notes: dict[str, Any]
) -> Iterator[tuple[int, dict[str, float]]]:
    """Train until `training.steps`, from the checkpoint at `path` if there is one; yields step and loss.

    Args:
        clouds: of parts, metres. Each step takes some of them, half of the points to encode, all to compare with.
        path: of the checkpoint, written every `training.keep_every` seconds and at the end.
        training: how.
        notes: kept in the checkpoint: what it was trained on.

    Raises:
        InputError: the checkpoint at `path` is of other training.
    """
    import jax
    import optax

    from roboassembly.learning.training_run import Run

    about = {"training": asdict(training), **notes}
    optimiser = optax.adam(optax.cosine_decay_schedule(training.learning_rate, training.steps))
    run = Run(path, KIND, about, training.steps, training.keep_every)
    fresh = init(np.random.default_rng(training.seed))
    step, params, state = run.resume(fresh, optimiser.init(fresh))  # pyright: ignore[reportArgumentType]

    def loss(p: Params, seen: Array, whole: Array) -> Array:
        return chamfer(reconstruct(p, seen), whole).mean()

    @jax.jit
    def update(p: Any, s: Any, seen: Array, whole: Array) -> tuple[Any, Any, Array]:
        value, gradient = jax.value_and_grad(loss)(p, seen, whole)
        change, s = optimiser.update(gradient, s, p)
        return optax.apply_updates(p, change), s, value

    unit = np.asarray(normalized(clouds.astype(np.float32))[0])
    while step < training.steps:
        rng = np.random.default_rng([training.seed, step])
        chosen = unit[rng.integers(len(unit), size=training.batch)]
        points = rng.permutation(chosen.shape[1])
        params, state, value = update(params, state, chosen[:, points[: len(points) // 2]], chosen)
        step += 1
        run.keep(step, params, state)
        yield step, {"chamfer": float(value)}
