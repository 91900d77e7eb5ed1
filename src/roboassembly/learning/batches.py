"""States of different sizes in one batch: padded to the next of a few sizes, so that few shapes are compiled."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roboassembly.learning.relational.tokens import Tokens

SIZES = (16, 32, 48, 64, 96, 128, 160, 200)
"""Tokens; 200 is 20 parts of 10 points."""
PADDED = ("patch", "own", "frame", "position", "extent", "meet", "beside", "loops", "bridges", "hold", "room")
"""The last two only where hands are asked for."""
_PAIRS = ("meet", "beside", "loops", "bridges", "room")


def size_for(n: int) -> int:
    """The least size that holds `n` tokens."""
    return next(size for size in SIZES if size >= n)


def pad(states: Sequence[Tokens], size: int) -> dict[str, np.ndarray]:
    """Arrays of `size` tokens a state; `group` is -1 where there is none."""
    batch = {"group": np.full((len(states), size), -1, np.int32)}
    names = [name for name in PADDED if getattr(states[0], name) is not None]
    for name in names:
        like = getattr(states[0], name)
        across = 2 if name in _PAIRS else 1
        batch[name] = np.zeros((len(states), *[size] * across, *like.shape[across:]), like.dtype)
    for row, state in enumerate(states):
        n = len(state.group)
        batch["group"][row, :n] = state.group
        for name in names:
            value = getattr(state, name)
            batch[name][(row, *[slice(n)] * (2 if name in _PAIRS else 1))] = value
    return batch
