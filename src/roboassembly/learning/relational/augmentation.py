"""The same furniture told in another way: facing elsewhere, mirrored or of another size, it is assembled alike."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from roboassembly.learning.relational.clearance import MIRRORED
from roboassembly.learning.relational.tokens import GRID_STEPS, Tokens
from roboassembly.task.rules.connections import UP_AXES

_SCALES = (0.7, 1.4)


@dataclass(frozen=True)
class Change:
    """Of the furniture's frame, which all part frames are parallel to: mirrored first, then turned, and scaled."""

    quarter_turns: int = 0
    """About z, counter-clockwise: the furniture faces another way; up stays up."""
    mirrored: bool = False
    """Along x."""
    scale: float = 1.0

    @staticmethod
    def draw(rng: np.random.Generator) -> Change:
        """Any of them, sizes evenly in their logarithm."""
        scale = float(np.exp(rng.uniform(*np.log(_SCALES))))
        return Change(int(rng.integers(4)), bool(rng.integers(2)), scale)

    @property
    def mirror(self) -> Float[np.ndarray, "3 3"]:
        """Of the world."""
        return np.diag([-1.0 if self.mirrored else 1.0, 1.0, 1.0])

    @property
    def side(self) -> Float[np.ndarray, "3 3"]:
        """Of a connection point's frame, or a hand's, which stays right-handed."""
        return np.diag([1.0, -1.0 if self.mirrored else 1.0, 1.0])

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """`new_from_old` for directions in a part's frame; its determinant is -1 if mirrored."""
        cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[self.quarter_turns % 4]
        turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        return turn @ self.mirror


VIEWS = tuple(Change(turns, mirrored) for mirrored in (False, True) for turns in range(4))
"""All changes that keep the size: what a policy sees may be told in eight ways."""


def seen(tokens: Tokens, change: Change) -> Tokens:
    """The same tokens of furniture so changed, as `changed` and `Course.tokens` would give them; the size stays.

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


def ways_after(change: Change) -> Int[np.ndarray, "6"]:
    """The new `w` of each old one."""
    return np.argmax(UP_AXES @ change.matrix.T @ UP_AXES.T, axis=1)
