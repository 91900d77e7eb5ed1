"""States of different sizes in one batch, padded to the same number of tokens."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roboassembly.learning.relational.tokens import Tokens

PADDED = ("patch", "own", "frame", "position", "extent", "meet", "beside", "loops", "bridges", "hold", "room")
"""Names of the padded arrays; the last two are there with robots only."""
_PAIRS = ("meet", "beside", "loops", "bridges", "room")
"""Names of those with a row and a column of tokens."""


def pad(states: Sequence[Tokens], size: int) -> dict[str, np.ndarray]:
    """Return arrays of `size` tokens a state; `group` is -1 where there is no token."""
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
