"""What a piece of furniture is: parts, where they go, what touches what, and which parts are alike."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from roboassembly.errors import FurnitureError
from roboassembly.geometry.mating import mating_pose
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3

if TYPE_CHECKING:
    from roboassembly.geometry.units import Unit

MIN_PARTS = 2
MAX_PARTS = 20
"""The paper's bound, and the padding of the observation and of the action space."""
MAX_POINTS = 10
"""Connection points a part, likewise."""
CONTACT_DISTANCE = 0.005
"""Parts nearer than this, in metres, are connected (the paper's 5 mm)."""
GRASP_REGIONS = 2
"""A part, as in the paper."""
SAME_POINT = 0.01
"""Metres: contacts of like parts that fall this near to each other on their shape get one and the same point."""


@dataclass(frozen=True)
class RawPart:
    """A part as a generator or importer makes it: nothing annotated yet."""

    name: str
    mesh: Mesh
    """In the furniture's frame (metres, z up), at its place in the assembled furniture."""
    label: str = ""
    """What it is in PartNet's vocabulary (`leg`, `seat_surface_bar`, ...), where known."""


@dataclass(frozen=True, eq=False)
class ConnectionPoint:
    """Where a part meets another, in the part's frame. Position, normal and tangent are the paper's nine numbers."""

    position: Float[np.ndarray, "3"]
    """Metres; the centre of the contact patch, on this part's side of the gap."""
    normal: Float[np.ndarray, "3"]
    """Unit vector out of the part, toward its mate."""
    tangent: Float[np.ndarray, "3"]
    """Unit vector orthogonal to the normal."""
    gap: float
    """Metres between this point and its mate along the normal in the assembled furniture."""

    @cached_property
    def frame(self) -> SE3:
        """`part_from_point`: z along the normal, x along the tangent."""
        y = np.cross(self.normal, self.tangent)
        return SE3(np.column_stack([self.tangent, y, self.normal]), self.position)


def mate(point_v: ConnectionPoint, point_u: ConnectionPoint) -> SE3:
    """`v_from_u` that lays the frame of `point_u` onto that of `point_v`.

    Normals opposed, tangents equal, origins apart by the stored gap along the normal (the mean of the two).
    """
    return mating_pose(point_v.frame, point_u.frame, 0.5 * (point_v.gap + point_u.gap))


@dataclass(frozen=True, eq=False)
class GraspRegion:
    """A place where a parallel jaw can hold the part, in the part's frame, and four ways to come to it."""

    position: Float[np.ndarray, "3"]
    """Metres; midpoint between the fingers."""
    closing: Float[np.ndarray, "3"]
    """Unit vector along which the fingers close."""
    approaches: Float[np.ndarray, "4 3"]
    """Unit vectors along which the hand may come, each orthogonal to `closing`."""
    width: float
    """Metres between the pads when they are about to touch, 0.2 mm or a little more on either side."""


@dataclass(frozen=True)
class Part:
    """One rigid mesh, in a frame at its own centre of mass."""

    name: str
    mesh: Mesh
    points: tuple[ConnectionPoint, ...]
    label: str = ""
    grasps: tuple[GraspRegion, ...] = ()


@dataclass(frozen=True)
class Connection:
    """Two connection points that touch in the assembled furniture (indices into parts and their points)."""

    part_a: int
    point_a: int
    part_b: int
    point_b: int


@dataclass(frozen=True, eq=False)
class ShapeClass:
    """Parts of the same shape, up to a proper rigid motion: any of them may take any of their slots.

    The members' frames are laid so that their meshes coincide: all that differs is where their slots are.
    """

    members: tuple[int, ...]
    """Part indices, ascending."""
    symmetries: Float[np.ndarray, "s 3 3"]
    """Rotations about the centre of mass that map the shape to itself; the identity first."""


@dataclass(frozen=True)
class Provenance:
    """Where the furniture comes from."""

    source: str
    """`generated`, `ikea-manual`, `folder`, ..."""
    identifier: str = ""
    """Name or seed within the source."""
    licence: str = ""
    scale: float = 1.0
    """Metres per unit of the source's own files."""
    notes: tuple[str, ...] = ()
    """What repair did, one line each."""


@dataclass(frozen=True, eq=False)
class Site:
    """A connection site that the source's own files mark, whatever the contacts' own points are."""

    name: str
    part: int
    """Index of its part."""
    frame: SE3
    """`part_from_site`; a raw furniture's is `furniture_from_site`."""
    mate: int | None
    """Index, among the furniture's sites, of the one that it meets in the assembled furniture: their origins lie within
    1 mm (in the source's own scale), their z axes within 5°, and each is the other's mate. None if none does."""


@dataclass(frozen=True)
class RawFurniture:
    """What an importer reads: parts as they are in the source's files, and where they come from."""

    parts: tuple[RawPart, ...]
    provenance: Provenance
    sites: tuple[Site, ...] = ()
    unit: Unit | None = None
    """How the size was found, where the files do not say it and nobody did."""
    remarks: tuple[str, ...] = ()
    """What a person should know of the reading, one line each."""

    @property
    def size(self) -> tuple[float, float, float]:
        """Metres along x, y and z (up) of the whole piece."""
        corners = np.concatenate([part.mesh.bounds for part in self.parts])
        x, y, z = np.ptp(corners, axis=0).tolist()
        return x, y, z


@dataclass(frozen=True, eq=False)
class Furniture:
    """Parts, their assembled poses, and everything known about how they fit.

    The furniture's frame is z up, in metres.

    Raises:
        FurnitureError: fewer than 2 or more than 20 parts, more than 10 points on a part, indices or class lists
            that do not fit the parts, or connections that leave the furniture in pieces.
    """

    name: str
    parts: tuple[Part, ...]
    assembled: tuple[SE3, ...]
    """`furniture_from_part` for each part: the slots."""
    connections: tuple[Connection, ...]
    classes: tuple[ShapeClass, ...]
    provenance: Provenance = field(default_factory=lambda: Provenance("unknown"))
    sites: tuple[Site, ...] = ()
    """Connection sites of the source's files; no rule of the task looks at them."""

    def __post_init__(self) -> None:
        n = len(self.parts)
        check_part_count(n, self.name)
        if len(self.assembled) != n:
            raise FurnitureError(f"{self.name}: {n} parts but {len(self.assembled)} assembled poses")
        for part in self.parts:
            if len(part.points) > MAX_POINTS:
                raise FurnitureError(
                    f"{self.name}: part '{part.name}' has {len(part.points)} connection points; at most {MAX_POINTS}"
                )
        seen: set[tuple[int, int]] = set()
        for c in self.connections:
            for p, k in ((c.part_a, c.point_a), (c.part_b, c.point_b)):
                if not (0 <= p < n and 0 <= k < len(self.parts[p].points)):
                    raise FurnitureError(f"{self.name}: connection refers to point {k} of part {p}, which is not there")
                if (p, k) in seen:
                    raise FurnitureError(f"{self.name}: point {k} of part '{self.parts[p].name}' is connected twice")
                seen.add((p, k))
        for index, site in enumerate(self.sites):
            if not 0 <= site.part < n or not (site.mate is None or 0 <= site.mate < len(self.sites)):
                raise FurnitureError(f"{self.name}: site '{site.name}' refers to a part or a site that is not there")
            if site.mate is not None and self.sites[site.mate].mate != index:
                raise FurnitureError(
                    f"{self.name}: site '{site.name}' has '{self.sites[site.mate].name}' as its mate, which has another"
                )
        members = sorted(m for c in self.classes for m in c.members)
        if members != list(range(n)):
            raise FurnitureError(f"{self.name}: shape classes name parts {members}; each of 0..{n - 1} once would do")
        islands = self.connected_components(range(n))
        if len(islands) > 1:
            loose = min(islands, key=len)
            names = ", ".join(self.parts[p].name for p in sorted(loose))
            raise FurnitureError(
                f"{self.name}: parts do not touch the rest within {CONTACT_DISTANCE * 1e3:g} mm: {names}"
            )

    @cached_property
    def class_of(self) -> tuple[int, ...]:
        """Index of each part's shape class."""
        out = [0] * len(self.parts)
        for index, shape_class in enumerate(self.classes):
            for member in shape_class.members:
                out[member] = index
        return tuple(out)

    @property
    def unholdable(self) -> tuple[str, ...]:
        """Names of the parts that no hand can hold in two regions: they rule the furniture out of the full setting."""
        return tuple(part.name for part in self.parts if len(part.grasps) < GRASP_REGIONS)

    @cached_property
    def lowest(self) -> float:
        """Height of the assembled furniture's lowest point in its own frame, metres."""
        return min(
            float((part.mesh.hull_vertices @ slot.rotation[2]).min() + slot.translation[2])
            for part, slot in zip(self.parts, self.assembled, strict=True)
        )

    @cached_property
    def neighbours(self) -> tuple[frozenset[int], ...]:
        """Parts that each part is connected to."""
        out: list[set[int]] = [set() for _ in self.parts]
        for c in self.connections:
            out[c.part_a].add(c.part_b)
            out[c.part_b].add(c.part_a)
        return tuple(frozenset(s) for s in out)

    @cached_property
    def mate_of(self) -> dict[tuple[int, int], tuple[int, int]]:
        """`(part, point)` to the `(part, point)` that it touches."""
        out: dict[tuple[int, int], tuple[int, int]] = {}
        for c in self.connections:
            out[c.part_a, c.point_a] = (c.part_b, c.point_b)
            out[c.part_b, c.point_b] = (c.part_a, c.point_a)
        return out

    def connected_components(self, among: range | frozenset[int]) -> list[frozenset[int]]:
        """Split `among` into sets of parts that connections hold together, by lowest part index."""
        left, out = set(among), []
        while left:
            stack, island = [min(left)], set()
            while stack:
                p = stack.pop()
                if p in island:
                    continue
                island.add(p)
                stack.extend((self.neighbours[p] & left) - island)
            left -= island
            out.append(frozenset(island))
        return out


def check_part_count(count: int, name: str, least: int = MIN_PARTS) -> None:
    """Raise `FurnitureError` unless `count` is between `least` and 20."""
    if count > MAX_PARTS:
        raise FurnitureError(
            f"{name}: {count} parts; furniture has {MIN_PARTS} to {MAX_PARTS}: join those that need no assembly (glued "
            f"or screwed ones, hinges, screws) into one mesh, or leave some out"
        )
    if count < least:
        raise FurnitureError(
            f"{name}: {count} part{'s' if count != 1 else ''}; furniture has {MIN_PARTS} to {MAX_PARTS}"
        )
