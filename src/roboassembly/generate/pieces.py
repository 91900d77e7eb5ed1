"""Parts before they become meshes: a solid, and where it goes. Equal parts share one solid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from roboassembly.furniture.model import RawPart
from roboassembly.generate.solids import Solid, triangles
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, transform_points

Kind = Literal["chair", "table", "shelf", "practice"]
"""What a family makes."""

HERE = SE3.Identity()
"""Pose of a solid that was cut where it belongs."""


@dataclass(frozen=True, eq=False)
class Piece:
    """One part: pieces that are interchangeable hold the same `solid` object and differ in `pose` alone."""

    name: str
    label: str
    """PartNet's word for it."""
    solid: Solid
    pose: SE3 = HERE
    """`furniture_from_solid`."""


Build = Callable[[np.random.Generator | None], Sequence[Piece]]
"""Makes pieces in a frame with the floor at z = 0; without a generator, the catalogue model."""


@dataclass(frozen=True)
class Family:
    """A structure of furniture: every seed is a size and style of it; seed 0 is the catalogue model."""

    name: str
    description: str
    build: Build
    kind: Kind = "chair"


def move(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> SE3:
    """A translation, metres."""
    return SE3(np.eye(3), np.array([x, y, z], dtype=float))


def as_parts(pieces: Sequence[Piece]) -> tuple[RawPart, ...]:
    """Mesh every distinct solid once, put the pieces where they go, feet at z = 0, centred in x and y."""
    meshes = {id(p.solid): triangles(p.solid) for p in pieces}
    vertices = [transform_points(p.pose, meshes[id(p.solid)][0]) for p in pieces]
    everything = np.concatenate(vertices)
    low, high = everything.min(axis=0), everything.max(axis=0)
    shift = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return tuple(
        RawPart(p.name, Mesh(v - shift, meshes[id(p.solid)][1]), p.label) for p, v in zip(pieces, vertices, strict=True)
    )
