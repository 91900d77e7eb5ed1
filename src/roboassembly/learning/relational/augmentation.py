"""Augmentation of tokens: the tokens of turned or mirrored furniture, without its clouds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roboassembly.learning.augmentation import FrameChange
from roboassembly.learning.relational.clearance import MIRROR_SIGNS
from roboassembly.learning.relational.group_geometry import PATCH_STEPS
from roboassembly.learning.relational.tokens import Tokens


def augment_tokens(tokens: Tokens, change: FrameChange) -> Tokens:
    """Return the tokens of the changed furniture, as its clouds would give them.

    Raises:
        ValueError: the change scales; scaled tokens need the clouds.
    """
    if change.scale != 1.0:
        raise ValueError(f"a change of scale ({change.scale}) needs the clouds")
    m = change.matrix
    side = np.diag(change.side)
    features = tokens.features.copy()
    features[:, 2:5] = tokens.features[:, 2:5] * side
    features[:, 5:8] = tokens.features[:, 5:8] @ np.abs(m).T
    for first in (8, 11, 14):
        features[:, first : first + 3] = tokens.features[:, first : first + 3] @ m.T
    patch, grasps = tokens.patch, tokens.grasps
    if change.mirrored:
        patch = patch.reshape(len(patch), len(PATCH_STEPS), 5, 5, 5)[:, :, :, ::-1].reshape(patch.shape)
        grasps = None if grasps is None else grasps * MIRROR_SIGNS
    low, high = tokens.bounds[..., :3], tokens.bounds[..., 3:]
    ahead, back = np.maximum(m, 0.0).T, np.maximum(-m, 0.0).T
    bounds = np.concatenate([low @ ahead - high @ back, high @ ahead - low @ back], axis=-1)
    return replace(
        tokens,
        features=features,
        patch=patch,
        frame=(m @ tokens.frame * side).astype(np.float32),
        position=(tokens.position @ m.T).astype(np.float32),
        extent=(tokens.extent @ np.abs(m).T).astype(np.float32),
        bounds=bounds.astype(tokens.bounds.dtype),
        grasps=grasps,
    )
