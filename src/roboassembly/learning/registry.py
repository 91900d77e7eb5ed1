"""Policies by name, from a checkpoint, or from a Python file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from roboassembly.errors import InputError
from roboassembly.learning import policy_file
from roboassembly.learning.checkpoint import Checkpoint
from roboassembly.learning.policy import RANDOM, Policy, RandomPolicy
from roboassembly.learning.policy_weights import load_weights

PolicyFactory = Callable[[int], Policy]
"""Makes a policy for the episode with a seed."""


def load_policy(name: str, seed: int = 0) -> Policy:
    """Load a policy for one episode.

    Args:
        name: `random`, `relational`, `paper`, the path of a checkpoint, or of a Python file, which is executed.
        seed: seed of the episode.

    Raises:
        UnknownNameError: no such policy.
        InputError: the file is missing, broken, of another network, or makes no policy.
    """
    return policy_factory(name)(seed)


def policy_factory(name: str) -> PolicyFactory:
    """Return a function that makes a policy for each episode.

    Policies that may draw random numbers are made anew for each episode, so that none knows of an earlier one; all
    others are made once. Files are read, and Python files executed, once.

    Args:
        name: see `load_policy`.

    Raises:
        UnknownNameError: no such policy.
        InputError: the file is missing, broken, or of another network.
    """
    if name == RANDOM:
        return lambda seed: RandomPolicy(np.random.default_rng([seed, 1]))
    if Path(name).suffix == policy_file.SUFFIX:
        return policy_file.load(Path(name))
    policy = _from_checkpoint(load_weights(name), name)
    return lambda seed: policy


def _from_checkpoint(loaded: Checkpoint, where: str) -> Policy:
    # Only the network that is needed is imported.
    match loaded.kind:
        case "relational":
            from roboassembly.learning.relational.policy import RelationalPolicy

            return RelationalPolicy.from_checkpoint(loaded, where)
        case "paper":
            from roboassembly.learning.paper.network import PaperPolicy

            return PaperPolicy.from_checkpoint(loaded, where)
        case _:
            raise InputError(
                f"'{where}' holds a '{loaded.kind}' network, which is no policy; expected 'relational' or 'paper'"
            )
