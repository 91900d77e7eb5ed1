"""Augmentation of tokens: turned and mirrored furniture, without its clouds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roboassembly.learning.augmentation import FrameChange
from roboassembly.learning.relational.clearance import MIRRORED
from roboassembly.learning.relational.tokens import GRID_STEPS, Tokens


def seen(tokens: Tokens, change: FrameChange) -> Tokens:
    """The same tokens of furniture so changed, as `augmented` and `tokens_in` would give them; the size stays.

    Raises:
        ValueError: the change is of size.
    """
    if change.scale != 1.0:
        raise ValueError(f"a change of size ({change.scale}) needs the clouds")
    m = change.matrix
    side = np.diag(change.side)
    own = tokens.own.copy()
    own[:, 2:5] = tokens.own[:, 2:5] * side
    own[:, 5:8] = tokens.own[:, 5:8] @ np.abs(m).T
    for first in (8, 11, 14):
        own[:, first : first + 3] = tokens.own[:, first : first + 3] @ m.T
    patch = tokens.patch
    if change.mirrored:
        patch = patch.reshape(len(patch), len(GRID_STEPS), 5, 5, 5)[:, :, :, ::-1].reshape(patch.shape)
    hold = tokens.hold
    if hold is not None and change.mirrored:
        hold = hold * MIRRORED
    low, high = tokens.beside[..., :3], tokens.beside[..., 3:]
    ahead, back = np.maximum(m, 0.0).T, np.maximum(-m, 0.0).T
    beside = np.concatenate([low @ ahead - high @ back, high @ ahead - low @ back], axis=-1)
    return replace(
        tokens,
        own=own,
        patch=patch,
        frame=(m @ tokens.frame * side).astype(np.float32),
        position=(tokens.position @ m.T).astype(np.float32),
        extent=(tokens.extent @ np.abs(m).T).astype(np.float32),
        beside=beside.astype(tokens.beside.dtype),
        hold=hold,
    )
