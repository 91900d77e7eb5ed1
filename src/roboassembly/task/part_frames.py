"""Frames in which an episode describes the parts: parallel to the furniture's, or each part's own.

In the paper every part's frame is parallel to the frame of the assembled furniture. This tells a policy how each part
stands in the finished piece. A part out of a box has no such frame: with `own` frames, a part is described along its
principal axes, in an order and with signs that are drawn for each episode.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from trimesh import bounds

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import BOX_ROTATIONS
from roboassembly.task.rules.connections import UP_AXES

FramesName = Literal["aligned", "own"]
_SAME_MOMENT = 0.02
"""Relative difference of two moments of inertia up to which their axes are not determined by the inertia."""


@dataclass(frozen=True, eq=False)
class PartFrames:
    """Frames in which an episode describes the P parts of a piece of furniture."""

    name: FramesName
    """`aligned`: the frames of `Furniture`; `own`: the principal axes of each part."""
    part_from_own: Float[np.ndarray, "P 3 3"]
    """Rotation from the frame in which each part is described to its frame in `Furniture`; parts of one class share
    it."""

    @staticmethod
    def aligned(furniture: Furniture) -> PartFrames:
        """Return the frames of the furniture itself."""
        return PartFrames("aligned", np.tile(np.eye(3), (len(furniture.parts), 1, 1)))

    @staticmethod
    def own(furniture: Furniture, rng: np.random.Generator) -> PartFrames:
        """Return the principal axes of each class, turned by one of the 24 rotations of a box.

        Args:
            furniture: the piece.
            rng: draws a rotation for each class.
        """
        turns = BOX_ROTATIONS[rng.integers(len(BOX_ROTATIONS), size=len(furniture.classes))]
        return PartFrames("own", principal_frames(furniture) @ turns[np.array(furniture.class_of)])

    @staticmethod
    def draw(name: FramesName, furniture: Furniture, rng: np.random.Generator) -> PartFrames:
        """Return the frames of an episode; `aligned` frames draw nothing."""
        return PartFrames.own(furniture, rng) if name == "own" else PartFrames.aligned(furniture)

    def up_axis(self, part: int, w: int) -> Float[np.ndarray, "3"]:
        """Return the axis that `w` names, in the frame that the part has in `Furniture`; own frames only."""
        return self.part_from_own[part] @ UP_AXES[w]


def principal_frames(furniture: Furniture) -> Float[np.ndarray, "P 3 3"]:
    """Return `part_from_principal` of each part: its principal axes; parts of one class share them."""
    of_class = [principal_axes(furniture.parts[c.members[0]].mesh) for c in furniture.classes]
    return np.array([of_class[c] for c in furniture.class_of])


def principal_axes(mesh: Mesh) -> Float[np.ndarray, "3 3"]:
    """Return a right-handed rotation whose columns are the principal axes of inertia, the longest extent first.

    Where inertias are equal, the inertia leaves axes open, as those of a square leg. Then the smallest rectangle or box
    around the part decides.
    """
    inertias, axes = np.linalg.eigh(mesh.inertia)
    same = np.diff(inertias) <= _SAME_MOMENT * inertias[-1]
    if same.all():
        axes = bounds.oriented_bounds(mesh.hull)[0][:3, :3].T
    elif same.any():
        first = int(np.argmax(same))
        plane = axes[:, first : first + 2]
        rectangle = bounds.oriented_bounds_2D(mesh.hull_vertices @ plane)[0][:2, :2]
        axes = axes.copy()
        axes[:, first : first + 2] = plane @ rectangle.T
    if np.linalg.det(axes) < 0.0:
        axes = axes * np.array([1.0, 1.0, -1.0])
    return axes
