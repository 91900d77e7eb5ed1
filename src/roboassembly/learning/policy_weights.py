"""Checkpoints of policies by name or path. Loads arrays only; `registry` makes policies of them."""

from __future__ import annotations

import hashlib
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from roboassembly.errors import InputError, UnknownNameError
from roboassembly.learning import checkpoint, policy_file
from roboassembly.learning.checkpoint import Checkpoint
from roboassembly.learning.policy import MAKER, RANDOM

SHIPPED = ("relational", "paper")
"""Names of the policies whose checkpoints belong into the package, as `weights/NAME.npz`."""
NAMES = (RANDOM, *SHIPPED)
"""Names of all policies."""
FILES = ("PATH.npz", f"PATH{policy_file.SUFFIX}")
"""Patterns of the paths that stand for a policy, for messages."""
MAX_BYTES = 2**28
"""Largest unpacked size of a policy's arrays; the largest network of this program takes 17 MB."""
_REMEDY = (
    f"name a checkpoint (.npz) that `roboassembly train` wrote, or a Python file ({policy_file.SUFFIX}) that defines "
    f"{MAKER}(seed)"
)


def load_weights(name: str) -> Checkpoint:
    """Load the checkpoint of a policy.

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


def weights_hash(name: str) -> str:
    """Return a hash of the checkpoint of a policy, by name or path; empty if there is none."""
    place = _shipped(name) if name in SHIPPED else Path(name)
    return hashlib.sha256(place.read_bytes()).hexdigest()[:16] if place.is_file() else ""


def _shipped(name: str) -> Traversable:
    return resources.files("roboassembly.learning") / "weights" / f"{name}.npz"
