"""Policies by name, from a checkpoint, or from a Python file of one's own."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

import numpy as np

from roboassembly.errors import InputError, UnknownNameError
from roboassembly.learning import checkpoint, policy_file
from roboassembly.learning.checkpoint import Checkpoint
from roboassembly.learning.policy import MAKER, RANDOM, Policy, RandomPolicy
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.policy import RelationalPolicy

SHIPPED = ("relational", "paper")
"""Policies whose checkpoints belong into the package, as `weights/NAME.npz`."""
NAMES = (RANDOM, *SHIPPED)
FILES = ("PATH.npz", f"PATH{policy_file.SUFFIX}")
"""What else names one, for messages."""
MAX_BYTES = 2**28
"""A policy's arrays together. The largest network of this program takes 17 MB."""
_REMEDY = (
    f"name a checkpoint (.npz) that `roboassembly train` wrote, or a Python file ({policy_file.SUFFIX}) that defines "
    f"{MAKER}(seed)"
)
Maker = Callable[[int], Policy]
"""Makes a policy for an episode with a seed."""


def load_policy(name: str, seed: int = 0) -> Policy:
    """A policy by name or from a file, for one episode.

    Args:
        name: `random`, `relational`, `paper`, the path of a checkpoint, or of a Python file, which is executed.
        seed: of the episode.

    Raises:
        UnknownNameError: no such policy.
        InputError: the file is missing, broken, of another network, or makes no policy.
    """
    return maker_of(name)(seed)


def maker_of(name: str) -> Maker:
    """What makes a policy for each episode: the same every time, but of policies that may draw one that knows nothing
    of what it has played before. Files are read, and those in Python executed, once.

    Args:
        name: as of `load_policy`.

    Raises:
        UnknownNameError: no such policy.
        InputError: the file is missing, broken, or of another network.
    """
    if name == RANDOM:
        return lambda seed: RandomPolicy(np.random.default_rng([seed, 1]))
    if Path(name).suffix == policy_file.SUFFIX:
        return policy_file.load(Path(name))
    policy = _kept(name)
    return lambda seed: policy


def _kept(name: str) -> Policy:
    """A policy that draws nothing."""
    return _of_checkpoint(checkpoint_of(name), name)


def checkpoint_of(name: str) -> Checkpoint:
    """What a policy's checkpoint holds.

    Args:
        name: `relational`, `paper`, or the path of a checkpoint.

    Raises:
        UnknownNameError: no such policy.
        InputError: the file is missing or broken.
    """
    if name in SHIPPED:
        place = _shipped(name)
        if not place.is_file():
            raise InputError(
                f"this installation has no weights for the policy '{name}'; train it (roboassembly train) and give "
                "the checkpoint's path"
            )
        with resources.as_file(place) as path:
            return checkpoint.load(path)
    path = Path(name)
    if not (path.exists() or path.suffix == ".npz" or "/" in name):
        raise UnknownNameError("policy", name, [*NAMES, *FILES])
    return checkpoint.load(path, remedy=_REMEDY, largest=MAX_BYTES)


def _shipped(name: str) -> Traversable:
    return resources.files("roboassembly.learning") / "weights" / f"{name}.npz"


def weights_hash(name: str) -> str:
    """Of a policy's checkpoint, by name or path; empty if there is none."""
    place = _shipped(name) if name in SHIPPED else Path(name)
    return hashlib.sha256(place.read_bytes()).hexdigest()[:16] if place.is_file() else ""


def _of_checkpoint(loaded: Checkpoint, where: str) -> Policy:
    if loaded.kind == relational.KIND:
        return RelationalPolicy.from_checkpoint(loaded, where)
    if loaded.kind == "paper":
        from roboassembly.learning.paper import autoencoder
        from roboassembly.learning.paper import network as paper

        config = checkpoint.network_config(paper.PaperConfig(), loaded.config.get("network"), where)
        rng, zeros = np.random.default_rng(0), np.zeros(paper.size(config.hands), np.float32)
        network = paper.init(rng, config)
        inputs = {"mean": zeros, "scale": zeros}
        wanted = {"network": network, "inputs": inputs, "encoder": autoencoder.init(rng)}
        checkpoint.check_arrays(loaded.params, wanted, where)
        return paper.PaperPolicy.from_checkpoint(loaded)
    raise InputError(f"'{where}' holds a '{loaded.kind}' network, which is no policy; '{relational.KIND}' would do")
