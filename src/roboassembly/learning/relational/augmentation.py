"""Augmentation of tokens: the tokens of turned or mirrored furniture, without its clouds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Int

from roboassembly.learning.augmentation import FrameChange, up_axis_permutation
from roboassembly.learning.relational.depth_images import MIRRORED_EXITS
from roboassembly.learning.relational.features import ALIGNED
from roboassembly.learning.relational.group_geometry import PATCH_STEPS
from roboassembly.learning.relational.tokens import Tokens
from roboassembly.task.rules.connections import UP_AXES


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
    aligned = is_aligned(tokens)
    if aligned:
        features[:, 21:24] = tokens.features[:, 21:24] * side
        features[:, 24:27] = tokens.features[:, 24:27] @ np.abs(m).T
        for first in (27, 30, 33):
            features[:, first : first + 3] = tokens.features[:, first : first + 3] @ m.T
    patch, exits = tokens.patch, tokens.exits
    if change.mirrored:
        patch = patch.reshape(len(patch), len(PATCH_STEPS), 5, 5, 5)[:, :, :, ::-1].reshape(patch.shape)
        exits = exits[..., MIRRORED_EXITS]
        features[:, 3] = -tokens.features[:, 3]
        for low in (6, 12):
            features[:, low], features[:, low + 3] = -tokens.features[:, low + 3], -tokens.features[:, low]
    extent, bounds, axes = tokens.extent, tokens.bounds, tokens.axes
    if aligned:
        low, high = bounds[..., :3], bounds[..., 3:]
        ahead, back = np.maximum(m, 0.0).T, np.maximum(-m, 0.0).T
        bounds = np.concatenate([low @ ahead - high @ back, high @ ahead - low @ back], axis=-1)
        extent = (extent @ np.abs(m).T).astype(np.float32)
    else:
        # The axes that `w` names turn with the parts.
        axes = (m @ axes).astype(np.float32)
    return replace(
        tokens,
        features=features,
        patch=patch,
        frame=(m @ tokens.frame * side).astype(np.float32),
        position=(tokens.position @ m.T).astype(np.float32),
        axes=axes,
        extent=extent,
        bounds=bounds.astype(tokens.bounds.dtype),
        exits=exits,
    )


def is_aligned(tokens: Tokens) -> bool:
    """Return whether part frames are aligned."""
    return bool(tokens.features[:, ALIGNED].any())


def permutation_of(tokens: Tokens, change: FrameChange) -> Int[np.ndarray, "6"]:
    """Return the new `w` of each old `w`; own axes turn with the parts."""
    return up_axis_permutation(change) if is_aligned(tokens) else np.arange(len(UP_AXES))
