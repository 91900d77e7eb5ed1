"""Converts a relational policy that does not know `joint_fit` to the inputs of its successor: same function.

python tools/widen_weights.py OLD.npz NEW.npz

New inputs get weights of 0, so that training can start from the old policy.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from roboassembly.learning import checkpoint
from roboassembly.learning.relational import network

PAIR, PAIRS = [*range(63), *range(141, 153)], 153
"""New place of each old pair feature, and their new number."""


def widen(old: Path, new: Path) -> None:
    """Convert a file."""
    loaded = checkpoint.load(old, network.KIND)
    for params in (loaded.params, loaded.params.get("full")):
        if params is not None:
            weights = params["pair_features"]["w"]
            if len(weights) != len(PAIR):
                raise SystemExit(f"{old}: {len(weights)} pair features, expected {len(PAIR)}")
            params["pair_features"]["w"] = wide = np.zeros((PAIRS, weights.shape[1]), weights.dtype)
            wide[PAIR] = weights
    config = {**loaded.config, "weights_hash": checkpoint.arrays_hash(loaded.params)}
    checkpoint.save(new, replace(loaded, config=config), half=True)


if __name__ == "__main__":
    widen(Path(sys.argv[1]), Path(sys.argv[2]))
