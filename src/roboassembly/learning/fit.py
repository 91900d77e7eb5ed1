"""The supervised training loop that all networks but the experts share.

A run may be killed at any moment: the checkpoint is written every minute, and a run that continues from it ends with
the weights of a run that was never stopped, because the batch of each step follows from the step's number.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from roboassembly.errors import InputError
from roboassembly.learning import checkpoint
from roboassembly.learning.layers import Array, Params
from roboassembly.parallel.processes import prefetch

if TYPE_CHECKING:
    import optax

KEEP_STEPS = 1_000
"""The checkpoint is written at each multiple of so many steps, too."""
Batch = Mapping[str, Array]
"""Arrays of a batch by name."""


@dataclass(frozen=True)
class FitConfig:
    """Settings that every supervised training has."""

    steps: int = 20_000
    """Number of gradient steps."""
    learning_rate: float = 1e-3
    """Largest learning rate."""
    batch: int = 32
    """Samples in a batch."""
    seed: int = 0
    """Random seed of the weights and of the order of samples."""
    keep_every: float = 60.0
    """Time between checkpoints [s]."""


@dataclass(frozen=True)
class AdamWConfig(FitConfig):
    """Settings of a training with AdamW, warm-up and cosine decay."""

    warmup: int = 200
    """Steps in which the learning rate rises; at most a tenth of all."""
    weight_decay: float = 1e-3
    """Decoupled weight decay."""
    clip: float = 1.0
    """Largest norm of the gradient."""

    def optimiser(self) -> optax.GradientTransformation:
        """Return the optimiser: AdamW (Loshchilov and Hutter 2019) with clipped gradients."""
        import optax

        schedule = optax.warmup_cosine_decay_schedule(
            0.0, self.learning_rate, min(self.warmup, self.steps // 10), self.steps, 0.02 * self.learning_rate
        )
        return optax.chain(optax.clip_by_global_norm(self.clip), optax.adamw(schedule, weight_decay=self.weight_decay))


@dataclass(frozen=True, eq=False)
class Fit:
    """One supervised training run.

    Args:
        path: file of the checkpoint.
        kind: kind of network, kept in the checkpoint.
        training: settings of the training.
        notes: configuration and origin of the samples; a run continues only with the same.
    """

    path: Path
    kind: str
    training: FitConfig
    notes: dict[str, Any]

    def run(
        self,
        init_params: Callable[[], Params],
        init_opt_state: Callable[[Params], Any],
        update: Callable[[Params, Any, Batch], tuple[Params, Any, Mapping[str, Array]]],
        batches: Callable[[int], Iterator[Batch]],
    ) -> Iterator[tuple[int, dict[str, float]]]:
        """Train, from the checkpoint if there is one; yields each step's number and its losses.

        The checkpoint is up to date when a multiple of `KEEP_STEPS` or the last step is yielded.

        Args:
            init_params: makes fresh parameters, those that are not trained included.
            init_opt_state: makes the fresh state of the optimiser of some parameters.
            update: makes parameters, optimiser state and losses from parameters, optimiser state and a batch.
            batches: makes the batches of all steps after the first so many.

        Raises:
            InputError: the checkpoint is broken, of another run, or cannot be continued.
        """
        import jax

        config = {"training": asdict(self.training), **self.notes}
        step, params, opt_state, worked = 0, None, None, 0.0
        if self.path.exists():
            kept = checkpoint.load(self.path, self.kind)
            differing = [name for name in config if kept.config.get(name) != config[name]]
            if differing:
                raise InputError(
                    f"'{self.path}' was trained with other {', '.join(differing)}; name another file, or remove it"
                )
            params = kept.params
            structure = jax.tree.structure(init_opt_state(params))
            try:
                leaves = [kept.extra[f"optimiser{i}"] for i in range(structure.num_leaves)]
                step = int(kept.extra["step"])
                worked = float(kept.extra.get("seconds", 0.0))
            except KeyError:
                raise InputError(f"'{self.path}' is finished and cannot be trained on; name another file") from None
            opt_state = jax.tree.unflatten(structure, leaves)
        if params is None:
            params = init_params()
            opt_state = init_opt_state(params)
        begun = kept_at = time.monotonic()
        for batch in prefetch(batches(step)):
            params, opt_state, losses = update(params, opt_state, batch)
            step += 1
            due = time.monotonic() - kept_at > self.training.keep_every
            if due or step % KEEP_STEPS == 0 or step == self.training.steps:
                extra = {f"optimiser{i}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(opt_state))}
                extra["step"] = np.array(step)
                extra["seconds"] = np.array(worked + time.monotonic() - begun)
                arrays = jax.tree.map(np.asarray, params)
                checkpoint.save(self.path, checkpoint.Checkpoint(self.kind, arrays, config, extra))
                kept_at = time.monotonic()
            yield step, {name: float(value) for name, value in losses.items()}


def is_trained(path: Path, kind: str, steps: int) -> bool:
    """Return whether the checkpoint at `path` exists and has had so many steps.

    Raises:
        InputError: the file is broken, or of another kind of network.
    """
    return path.is_file() and int(checkpoint.load(path, kind).extra["step"]) >= steps
