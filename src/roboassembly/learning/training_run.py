"""A training run's checkpoint: kept every minute, so that a run that is killed loses no more."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

from roboassembly.errors import InputError
from roboassembly.learning import checkpoint

EVERY = 1_000
"""Steps after which a checkpoint is kept in any case."""


class Run:
    """The checkpoint of one run.

    Args:
        path: of the file.
        kind: of the network.
        about: configuration and origin; a run goes on only with the same.
        steps: at which it ends.
        keep_every: seconds between checkpoints.
    """

    def __init__(self, path: Path, kind: str, about: dict[str, Any], steps: int, keep_every: float) -> None:
        self.path, self.kind, self.about = path, kind, about
        self.steps, self.keep_every = steps, keep_every
        self._kept = time.monotonic()

    def resume(self, params: Any, moments: Any) -> tuple[int, Any, Any]:
        """Step, weights and optimiser's state to go on with; 0 and what is given if there is no checkpoint.

        Raises:
            InputError: the file is broken, or of another run.
        """
        if not self.path.exists():
            return 0, params, moments
        kept = checkpoint.load(self.path, self.kind)
        differing = [k for k in self.about if kept.config.get(k) != self.about[k]]
        if differing:
            raise InputError(
                f"'{self.path}' was trained with other {', '.join(differing)}; name another file, or remove it"
            )
        try:
            leaves = [kept.extra[f"optimiser{i}"] for i in range(len(jax.tree.leaves(moments)))]
            step = int(kept.extra["step"])
        except KeyError:
            raise InputError(f"'{self.path}' is finished and cannot be trained on; name another file") from None
        return step, kept.params, jax.tree.unflatten(jax.tree.structure(moments), leaves)

    def keep(self, step: int, params: Any, moments: Any) -> None:
        """Write the checkpoint if it is time, if the step is a round one, or the last."""
        if time.monotonic() - self._kept <= self.keep_every and step % EVERY and step != self.steps:
            return
        leaves = {f"optimiser{i}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(moments))}
        arrays = jax.tree.map(np.asarray, params)
        extra = {**leaves, "step": np.array(step)}
        checkpoint.save(self.path, checkpoint.Checkpoint(self.kind, arrays, self.about, extra))
        self._kept = time.monotonic()
