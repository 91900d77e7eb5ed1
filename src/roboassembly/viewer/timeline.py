"""Timeline of a plan: the pose and the role of every object in each frame of a film.

Poses are `world_from_mesh`, in metres; times are in seconds. A timeline depends on the plan alone.
"""

from __future__ import annotations

import enum
import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3
from roboassembly.rendering.camera import boxes_corners
from roboassembly.rendering.colors import Role


class Phase(enum.StrEnum):
    """Section of a film that a frame belongs to."""

    OVERTURE = "overture"
    PLACING = "placing"
    MOVING = "moving"
    SETTLING = "settling"
    INSERTING = "inserting"
    """Fasteners go in."""
    PAUSE = "pause"
    FINALE = "finale"


@dataclass(frozen=True, eq=False)
class SceneObject:
    """Named mesh that is drawn: a part, a link of a robot, or a post."""

    name: str
    mesh: Mesh
    framed: bool = True
    """Whether the camera keeps the object in the picture."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of a film."""

    poses: tuple[SE3 | None, ...]
    """`world_from_mesh` of every object [m]; None if the object is hidden. Framed objects are never hidden."""
    roles: tuple[Role, ...]
    """Role of every object, which decides its colour."""
    step: int | None
    """Index into the plan's steps; None before the first step, after the last, and while the piece is set upright."""
    phase: Phase
    caption: str
    key: bool = False
    """Whether this frame is the best still picture of its step. If no frame of a step is, the middle one is taken."""


@dataclass(frozen=True, eq=False)
class Timeline:
    """Frames of a film, equally spaced in time; the first is at time zero."""

    name: str
    """Name of the furniture."""
    objects: tuple[SceneObject, ...]
    """Objects in the order of `Frame.poses`: parts first, framed objects before the others."""
    frames: tuple[Frame, ...]
    frames_per_second: float

    @property
    def duration(self) -> float:
        """Length of the film [s], the last frame included."""
        return len(self.frames) / self.frames_per_second

    @cached_property
    def captions(self) -> tuple[tuple[float, str], ...]:
        """`(time [s], caption)` of each change of the caption."""
        out: list[tuple[float, str]] = []
        for index, frame in enumerate(self.frames):
            if not out or out[-1][1] != frame.caption:
                out.append((index / self.frames_per_second, frame.caption))
        return tuple(out)

    @cached_property
    def box_corners(self) -> Float[np.ndarray, "frames objects 8 3"]:
        """World corners [m] of the bounding box of each framed object, in each frame."""
        framed = [item for item in self.objects if item.framed]
        poses = [[pose or SE3.Identity() for pose in frame.poses[: len(framed)]] for frame in self.frames]
        rotations = np.array([[pose.rotation for pose in row] for row in poses])
        translations = np.array([[pose.translation for pose in row] for row in poses])
        local = np.array([list(itertools.product(*item.mesh.bounds.T)) for item in framed])
        return np.einsum("fpij,pcj->fpci", rotations, local) + translations[:, :, None]

    @cached_property
    def extent(self) -> Float[np.ndarray, "n 3"]:
        """World corners [m] of the bounding boxes of framed objects, at all their poses: `box_corners` once each."""
        corners = [np.empty((0, 3))]
        for index, item in enumerate(self.objects):
            # Most objects are at rest in most frames, with the same pose.
            distinct = {id(frame.poses[index]): frame.poses[index] for frame in self.frames} if item.framed else {}
            poses = [pose for pose in distinct.values() if pose is not None]
            local = boxes_corners(item.mesh.bounds[:1], item.mesh.bounds[1:])
            rotations = np.array([pose.rotation for pose in poses]).reshape(-1, 3, 3)
            translations = np.array([pose.translation for pose in poses]).reshape(-1, 1, 3)
            corners.append((np.einsum("nij,cj->nci", rotations, local) + translations).reshape(-1, 3))
        return np.concatenate(corners)


def part_objects(furniture: Furniture) -> tuple[SceneObject, ...]:
    """Return one object for each part."""
    return tuple(SceneObject(f"parts/{i}_{p.name.replace('/', '_')}", p.mesh) for i, p in enumerate(furniture.parts))
