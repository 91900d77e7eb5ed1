"""Model of a piece of furniture: parts, assembled poses, connections and shape classes."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float

from roboassembly.errors import FurnitureError
from roboassembly.geometry.mating import mating_pose
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3

if TYPE_CHECKING:
    from roboassembly.geometry.units import Unit

MIN_PARTS = 2
PAPER_PARTS, PAPER_POINTS = 20, 10
"""Largest numbers of parts, and of connection points of a part, in the paper: sizes to which observations and action
spaces are padded by default."""
MOST_PARTS = 1000
"""Largest number of parts that is read from files."""
CONTACT_DISTANCE = 0.005
"""Distance below which parts are connected, 5 mm in the paper [m]."""
GRASP_REGIONS = 2
"""Grasp regions per part, as in the paper."""
ROUNDED_CENTER = 1e-5
"""Distance of a part's centre of mass from its frame that counts as rounding [m]."""
SAME_POINT = 0.01
"""Distance on the shape below which contacts of parts of one shape share a connection point [m]."""

FastenerKind = Literal["dowel", "screw", "cam"]
"""Kinds of fasteners."""
NEAR = 0.003
"""Largest distance between the surfaces of parts of one class, which in imported furniture may differ by marks [m]."""


@dataclass(frozen=True)
class RawPart:
    """Part from a generator or importer, without annotations."""

    name: str
    mesh: Mesh
    """Mesh at its place in the assembled furniture, in the furniture's frame (z up) [m]."""
    label: str = ""
    """Path in PartNet's hierarchy (`chair_base/regular_leg_base/leg`), if known."""


@dataclass(frozen=True, eq=False)
class RawFastener:
    """Fastener from a generator or importer."""

    name: str
    kind: FastenerKind
    mesh: Mesh
    """Mesh at its place in the assembled furniture, in the furniture's frame (z up) [m]."""


@dataclass(frozen=True, eq=False)
class ConnectionPoint:
    """Point at which a part meets another, in the part's frame; nine numbers in the paper besides the gap."""

    position: Float[np.ndarray, "3"]
    """Centre of the contact patch, on this part's side of the gap [m]."""
    normal: Float[np.ndarray, "3"]
    """Unit vector out of the part, toward its mate."""
    tangent: Float[np.ndarray, "3"]
    """Unit vector orthogonal to the normal."""
    gap: float
    """Distance from this point to its mate along the normal in the assembled furniture [m]."""

    @cached_property
    def frame(self) -> SE3:
        """`part_from_point`: z along the normal, x along the tangent."""
        y = np.cross(self.normal, self.tangent)
        return SE3(np.column_stack([self.tangent, y, self.normal]), self.position)


def mate(point_v: ConnectionPoint, point_u: ConnectionPoint) -> SE3:
    """Return the `v_from_u` at which `point_u` meets `point_v`.

    Normals are opposed, tangents equal, and the origins lie the mean of the stored gaps apart along the normal.
    """
    return mating_pose(point_v.frame, point_u.frame, 0.5 * (point_v.gap + point_u.gap))


@dataclass(frozen=True, eq=False)
class GraspRegion:
    """Place where a parallel jaw can hold the part, with four approach directions, in the part's frame."""

    position: Float[np.ndarray, "3"]
    """Midpoint between the fingers [m]."""
    closing: Float[np.ndarray, "3"]
    """Unit vector along which the fingers close."""
    approaches: Float[np.ndarray, "4 3"]
    """Unit vectors along which the hand may approach, each orthogonal to `closing`."""
    width: float
    """Distance between the pads just before they touch, with 0.2 mm or a little more on either side [m]."""


@dataclass(frozen=True)
class Part:
    """Rigid mesh in a frame at its own centre of mass, with its annotations.

    The frame of a part that is interchangeable with others of nearly its shape lies where they fall on each other, up
    to some millimetres off.
    """

    name: str
    mesh: Mesh
    points: tuple[ConnectionPoint, ...]
    label: str = ""
    """Path in PartNet's hierarchy, as `RawPart.label`."""
    grasps: tuple[GraspRegion, ...] = ()

    @cached_property
    def center_of_mass(self) -> Float[np.ndarray, "3"]:
        """Centre of mass in the part's frame: exactly 0 if the frame lies there up to rounding [m]."""
        center = self.mesh.center_of_mass
        return center if np.abs(center).max() > ROUNDED_CENTER else np.zeros(3)


@dataclass(frozen=True)
class Connection:
    """Pair of connection points that touch in the assembled furniture, as indices of parts and of their points."""

    part_a: int
    point_a: int
    part_b: int
    point_b: int


@dataclass(frozen=True, eq=False)
class ShapeClass:
    """Parts of one shape up to a proper rigid motion: each of them fits each of their slots.

    The members' frames are chosen so that their meshes coincide; only their slots differ. Members of imported furniture
    may differ by marks and millimetres, which leave the finished furniture sound in whatever slots they are
    (`exchange`); each then has its own mesh.
    """

    members: tuple[int, ...]
    """Part indices, ascending."""
    symmetries: Float[np.ndarray, "s 3 3"]
    """Rotations about the origin of the part's frame that map the shape to itself, the identity first; nearly, if the
    finished furniture allows it."""


@dataclass(frozen=True)
class Provenance:
    """Origin of the furniture."""

    source: str
    """`generated`, `ikea-manual`, `folder`, ..."""
    identifier: str = ""
    """Name or seed within the source."""
    licence: str = ""
    scale: float = 1.0
    """Metres per unit of the source's own files."""
    notes: tuple[str, ...] = ()
    """Actions of repair, one line each."""


@dataclass(frozen=True, eq=False)
class Site:
    """Connection site that the source's files mark, independent of the connection points found by contact."""

    name: str
    part: int
    """Index of its part."""
    frame: SE3
    """Frame `part_from_site`; `furniture_from_site` in a `RawFurniture`."""
    mate: int | None
    """Index, among the furniture's sites, of the site that it meets in the assembled furniture; None if none does.

    The origins of mates lie within 1 mm (in the source's own scale), their z axes within 5°; each is the other's mate.
    """


@dataclass(frozen=True, eq=False)
class Fastener:
    """Small part of kind `fastener` that holds ordinary parts together: a dowel, a screw or a cam lock.

    Fasteners are no parts of the task: states, actions and observations know nothing of them. Equal ones have the same
    mesh.
    """

    name: str
    kind: FastenerKind
    mesh: Mesh
    """Mesh in the fastener's own frame: origin at its centre of mass, z along its axis, the way in [m]."""
    place: SE3
    """`furniture_from_fastener` in the assembled furniture."""
    joins: tuple[int, ...]
    """Slots of the parts that it joins, ascending."""

    @property
    def axis(self) -> Float[np.ndarray, "3"]:
        """Unit vector along which it goes in, furniture frame."""
        return self.place.rotation[:, 2]


@dataclass(frozen=True)
class RawFurniture:
    """Result of an importer: parts as the source's files have them, and their origin."""

    parts: tuple[RawPart, ...]
    provenance: Provenance
    sites: tuple[Site, ...] = ()
    unit: Unit | None = None
    """Guess of the unit of length, if neither the files nor the caller gave it."""
    remarks: tuple[str, ...] = ()
    """Remarks for the user on the files, one line each."""
    fasteners: tuple[RawFastener, ...] = ()
    """Fasteners, which are not among the parts."""
    drawn: bool = False
    """Whether the parts are drawn for their looks only: they run into each other where there is no joint."""

    @property
    def size(self) -> tuple[float, float, float]:
        """Extents of the whole piece along x, y and z (up) [m]."""
        corners = np.concatenate([part.mesh.bounds for part in self.parts])
        x, y, z = np.ptp(corners, axis=0).tolist()
        return x, y, z


@dataclass(frozen=True, eq=False)
class Furniture:
    """Piece of furniture: parts, their assembled poses and all annotations.

    The furniture's frame is z up, in metres.

    Raises:
        FurnitureError: fewer than 2 parts or more than 1000, indices or class lists that do not fit the parts, or
            connections that leave the furniture in pieces.
    """

    name: str
    parts: tuple[Part, ...]
    assembled: tuple[SE3, ...]
    """Slots: `furniture_from_part` of each part."""
    connections: tuple[Connection, ...]
    classes: tuple[ShapeClass, ...]
    provenance: Provenance = field(default_factory=lambda: Provenance("unknown"))
    sites: tuple[Site, ...] = ()
    """Connection sites of the source's files; no rule of the task uses them."""
    fasteners: tuple[Fastener, ...] = ()
    """Dowels, screws and cam locks; no rule of the task uses them."""

    def __post_init__(self) -> None:
        n = len(self.parts)
        check_part_count(n, self.name)
        if len(self.assembled) != n:
            raise FurnitureError(f"{self.name}: {n} parts but {len(self.assembled)} assembled poses")
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
        for fastener in self.fasteners:
            if not fastener.joins or not set(fastener.joins) <= set(range(n)):
                raise FurnitureError(
                    f"{self.name}: fastener '{fastener.name}' joins {[*fastener.joins]}; expected parts of 0..{n - 1}"
                )
        members = sorted(m for c in self.classes for m in c.members)
        if members != list(range(n)):
            raise FurnitureError(f"{self.name}: shape classes name parts {members}; expected each of 0..{n - 1} once")
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

    @cached_property
    def most_points(self) -> int:
        """Largest number of connection points of a part."""
        return max(len(part.points) for part in self.parts)

    @cached_property
    def fastener_classes(self) -> tuple[tuple[int, ...], ...]:
        """Indices of equal fasteners, of one kind and one mesh, by the first of them."""
        found: dict[tuple[str, int], list[int]] = {}
        for index, fastener in enumerate(self.fasteners):
            found.setdefault((fastener.kind, id(fastener.mesh)), []).append(index)
        return tuple(map(tuple, found.values()))

    @property
    def padding(self) -> tuple[int, int]:
        """Sizes P and K of observations and masks: those of the paper, or larger ones if the furniture needs them."""
        return max(PAPER_PARTS, len(self.parts)), max(PAPER_POINTS, self.most_points)

    @property
    def unholdable(self) -> tuple[str, ...]:
        """Names of parts with fewer than two grasp regions, which the full setting does not admit."""
        return tuple(part.name for part in self.parts if len(part.grasps) < GRASP_REGIONS)

    @cached_property
    def lowest(self) -> float:
        """Height of the assembled furniture's lowest point in its own frame [m]."""
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

    def joints_between(
        self, first: Collection[int], second: Collection[int]
    ) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
        """Yield the `(part, point)` ends of each connection of two sets of slots, that of the first set first."""
        for c in self.connections:
            a, b = (c.part_a, c.point_a), (c.part_b, c.point_b)
            if c.part_a in first and c.part_b in second:
                yield a, b
            elif c.part_b in first and c.part_a in second:
                yield b, a

    @cached_property
    def mate_of(self) -> dict[tuple[int, int], tuple[int, int]]:
        """Map from each connected `(part, point)` to the `(part, point)` that it touches."""
        out: dict[tuple[int, int], tuple[int, int]] = {}
        for c in self.connections:
            out[c.part_a, c.point_a] = (c.part_b, c.point_b)
            out[c.part_b, c.point_b] = (c.part_a, c.point_a)
        return out

    def connected_components(self, among: range | frozenset[int]) -> list[frozenset[int]]:
        """Split `among` into sets of parts that connections hold together, by lowest part index."""
        left = set(among)
        out: list[frozenset[int]] = []
        while left:
            stack = [min(left)]
            island: set[int] = set()
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
    """Raise `FurnitureError` unless `count` is between `least` and `MOST_PARTS`."""
    if count > MOST_PARTS:
        raise FurnitureError(
            f"{name}: {count} parts; furniture has {MIN_PARTS} to {MOST_PARTS}: join those that need no assembly "
            f"(glued or screwed ones, hinges, screws) into one mesh, or leave some out"
        )
    if count < least:
        raise FurnitureError(f"{name}: {count} part{'s' if count != 1 else ''}; furniture has {MIN_PARTS} or more")
