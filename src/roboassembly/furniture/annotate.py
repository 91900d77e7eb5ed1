"""Annotation of raw parts: frames at the centre of mass, shape classes, contacts, connection points, grasps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from roboassembly.errors import FurnitureError
from roboassembly.furniture.connection_points import Spot, connection_points, spot_of_contact
from roboassembly.furniture.contacts import Contact, find_contacts
from roboassembly.furniture.exchange import interchangeable
from roboassembly.furniture.grasps import candidate_grasps, find_grasps
from roboassembly.furniture.model import (
    MOST_PARTS,
    PAPER_PARTS,
    PAPER_POINTS,
    Furniture,
    GraspRegion,
    Part,
    Provenance,
    RawPart,
    ShapeClass,
    check_part_count,
)
from roboassembly.furniture.symmetry import TOLERANCE, rotations_onto, symmetries
from roboassembly.geometry.meshes import Mesh, all_within, nearest_points
from roboassembly.geometry.poses import SE3, storable

_ROUNDING = 2e-6
"""Largest difference of coordinates due to rounding to 32-bit floats [m]."""
_EQUAL = 2.0 * TOLERANCE
"""Largest distance of the corners of one mesh from another below which both have the same grasps [m]."""
_HAND = 0.25
"""Distance beyond a part's box that an approaching hand may occupy [m]."""
_LIKES = 4
"""Number of parts of one shape whose surroundings the search for grasps takes into account."""
_MIN_GAP_SHARE = 0.5
"""Share of the distance to a neighbour that has to remain when a part takes the mesh of its class."""


def annotate(
    name: str,
    raw: Sequence[RawPart],
    provenance: Provenance,
    *,
    with_grasps: bool = True,
    with_near_shapes: bool = False,
    most_points: int | None = None,
) -> Furniture:
    """Annotate parts given at their places in the assembled furniture.

    Contacts follow the paper: parts nearer than 5 mm are connected, and each connection has a point on either part,
    at the centre of the contact patch, with normal and tangent. Mating the two frames (origins at the stored gap
    along the normal, normals opposed, tangents equal) gives the assembled relative pose.

    Parts of one shape get frames in which their meshes coincide, and the same points: tangents are copied from
    member to member wherever the furniture allows it, so that four equal legs fit each other's slots. They also get
    the same grasps.

    Args:
        name: name of the furniture.
        raw: the parts.
        provenance: origin of the parts.
        with_grasps: whether to find grasps, which takes most of the time; only the object-centric setting does
            without them.
        with_near_shapes: whether parts of nearly one shape are interchangeable, too, if the finished furniture allows
            it (`exchange`): for real parts, equal but for marks and millimetres.
        most_points: number of points of a part above which its smallest contacts are left out, as long as all parts
            stay connected. By default that of the paper for furniture with as many parts as there at most, and no limit
            for others.

    Raises:
        FurnitureError: part count, repeated names, parts that penetrate, parts that do not touch.
    """
    check_part_count(len(raw), name)
    names = [part.name for part in raw]
    repeated = sorted({n for n in names if names.count(n) > 1})
    if repeated:
        raise FurnitureError(f"{name}: part name '{repeated[0]}' is used twice; names must be unique")
    centers = [part.mesh.center_of_mass for part in raw]
    centered = [part.mesh.transformed(SE3(np.eye(3), -c)) for part, c in zip(raw, centers, strict=True)]
    if most_points is None:
        most_points = PAPER_POINTS if len(raw) <= PAPER_PARTS else MOST_PARTS
    contacts, notes = _bounded_contacts(find_contacts([p.mesh for p in raw], names), names, most_points)
    classes, rotations = _classify(centered)
    rotations = _turn_to_match_points(classes, rotations, centers, contacts)
    slots = tuple(storable(SE3(r, c)) for r, c in zip(rotations, centers, strict=True))
    meshes = _part_meshes([p.mesh for p in raw], centered, classes, slots, contacts)
    if with_near_shapes:
        exchange = interchangeable(classes, slots, meshes, contacts)
        classes, meshes = exchange.classes, exchange.meshes
        slots = tuple(storable(slot) for slot in exchange.slots)
    points, connections = connection_points(contacts, slots, classes, most_points)
    parts = tuple(
        Part(part.name, mesh, tuple(own), part.label) for part, mesh, own in zip(raw, meshes, points, strict=True)
    )
    provenance = replace(provenance, notes=(*provenance.notes, *notes))
    furniture = Furniture(name, parts, slots, connections, classes, provenance)
    return add_grasps(furniture) if with_grasps else furniture


def add_grasps(furniture: Furniture) -> Furniture:
    """Return the furniture with newly computed grasps in place of those it has."""
    grasps: dict[int, tuple[GraspRegion, ...]] = {}
    for equal in parts_held_alike(furniture):
        grasps.update(
            dict.fromkeys(equal, find_grasps(furniture.parts[equal[0]].mesh, _surroundings(furniture, equal)))
        )
    return with_grasps(furniture, grasps)


def add_candidate_grasps(furniture: Furniture, most: int) -> Furniture:
    """Return the furniture with up to `most` grasp regions on each part, those that it has first.

    Robots and observations expect no more than `GRASP_REGIONS`, so a caller must choose among them.
    """
    grasps: dict[int, tuple[GraspRegion, ...]] = {}
    for equal in parts_held_alike(furniture):
        part = furniture.parts[equal[0]]
        found = candidate_grasps(part.mesh, _surroundings(furniture, equal), part.grasps, most)
        grasps.update(dict.fromkeys(equal, tuple(found)))
    return with_grasps(furniture, grasps)


def with_grasps(furniture: Furniture, grasps: Mapping[int, tuple[GraspRegion, ...]]) -> Furniture:
    """Return the furniture with the given grasps of some parts in place of theirs."""
    parts = (replace(p, grasps=grasps.get(i, p.grasps)) for i, p in enumerate(furniture.parts))
    return replace(furniture, parts=tuple(parts))


def parts_held_alike(furniture: Furniture) -> list[list[int]]:
    """Return the parts in lists of equal ones, which have the same grasps."""
    meshes = [part.mesh for part in furniture.parts]
    out: list[list[int]] = []
    for c in furniture.classes:
        left = list(c.members)
        while left:
            out.append([p for p in left if _is_equal(meshes[left[0]], meshes[p])])
            left = [p for p in left if p not in out[-1]]
    return out


def _surroundings(furniture: Furniture, equal: Sequence[int]) -> list[Mesh]:
    """Return what hands at some of the equal parts could touch; see `_around`."""
    meshes = [part.mesh for part in furniture.parts]
    around = (_around(member, meshes, furniture.assembled) for member in equal[:_LIKES])
    return [mesh for mesh in around if mesh is not None]


def _is_equal(first: Mesh, mesh: Mesh) -> bool:
    """Return whether two parts of one class are equal, and not only nearly."""
    return mesh is first or (
        all_within(first.bvh, mesh.vertices, _EQUAL) and all_within(mesh.bvh, first.vertices, _EQUAL)
    )


def _around(part: int, meshes: Sequence[Mesh], slots: Sequence[SE3]) -> Mesh | None:
    """Return what a hand at a part could touch in the assembled furniture, in the part's frame; None if nothing."""
    low, high = meshes[part].bounds
    near: list[Mesh] = []
    for other, (mesh, slot) in enumerate(zip(meshes, slots, strict=True)):
        moved = mesh.transformed(slots[part].actInv(slot))
        if other != part and (moved.bounds[0] < high + _HAND).all() and (moved.bounds[1] > low - _HAND).all():
            near.append(moved)
    if not near:
        return None
    starts = np.cumsum([0, *(len(m.vertices) for m in near[:-1])])
    faces = [m.faces + start for m, start in zip(near, starts, strict=True)]
    return Mesh(np.concatenate([m.vertices for m in near]), np.concatenate(faces))


def _bounded_contacts(
    contacts: tuple[Contact, ...], names: Sequence[str], most_points: int
) -> tuple[list[Contact], list[str]]:
    """Drop the smallest patches of parts with more than `most_points` points, as long as all parts stay connected."""
    kept = list(contacts)
    notes: list[str] = []
    for contact in sorted(contacts, key=lambda c: c.area):
        crowded = [p for p in (contact.a, contact.b) if sum(p in (c.a, c.b) for c in kept) > most_points]
        if not crowded:
            continue
        rest = [c for c in kept if c is not contact]
        if _reaches(contact.a, contact.b, rest):
            kept = rest
            notes.append(
                f"contact of '{names[contact.a]}' and '{names[contact.b]}' left out: more than {most_points} points"
            )
    return kept, notes


def _reaches(start: int, goal: int, contacts: Sequence[Contact]) -> bool:
    seen, stack = {start}, [start]
    while stack:
        here = stack.pop()
        for c in contacts:
            if here in (c.a, c.b):
                other = c.b if here == c.a else c.a
                if other not in seen:
                    seen.add(other)
                    stack.append(other)
    return goal in seen


def _classify(centered: Sequence[Mesh]) -> tuple[tuple[ShapeClass, ...], list[Float[np.ndarray, "3 3"]]]:
    """Return the shape classes, and per part the rotation that maps its class's first member onto it."""
    members: list[list[int]] = []
    rotations: list[Float[np.ndarray, "3 3"]] = []
    for p, mesh in enumerate(centered):
        for group in members:
            onto = rotations_onto(centered[group[0]], mesh)
            if len(onto):
                group.append(p)
                rotations.append(np.eye(3) if np.allclose(onto[0], np.eye(3), atol=1e-7) else onto[0])
                break
        else:
            members.append([p])
            rotations.append(np.eye(3))
    return tuple(ShapeClass(tuple(group), symmetries(centered[group[0]])) for group in members), rotations


def _turn_to_match_points(
    classes: Sequence[ShapeClass],
    rotations: list[Float[np.ndarray, "3 3"]],
    centers: Sequence[Float[np.ndarray, "3"]],
    contacts: Sequence[Contact],
) -> list[Float[np.ndarray, "3 3"]]:
    """Turn each part by a symmetry of its shape so that its points fall on those of its class's first member."""
    out = list(rotations)
    for shape_class in classes:
        first = shape_class.members[0]

        def spots(part: int, rotation: Float[np.ndarray, "3 3"]) -> list[Spot]:
            slot = SE3(rotation, centers[part])
            return [spot_of_contact(c, part, slot) for c in contacts if part in (c.a, c.b)]

        reference = spots(first, rotations[first])
        for member in shape_class.members[1:]:
            matches = [
                sum(
                    any(len(spot.onto(r, np.eye(3)[None])) for r in reference)
                    for spot in spots(member, rotations[member] @ turn)
                )
                for turn in shape_class.symmetries
            ]
            out[member] = rotations[member] @ shape_class.symmetries[int(np.argmax(matches))]
    return out


def _part_meshes(
    raw: Sequence[Mesh], centered: Sequence[Mesh], classes: Sequence[ShapeClass], slots: Sequence[SE3],
    contacts: Sequence[Contact],
) -> list[Mesh]:  # fmt: skip
    """Return the meshes in their parts' frames. A class shares its first mesh wherever neighbours leave room for it."""
    meshes = list(centered)
    for shape_class in classes:
        first = centered[shape_class.members[0]]
        for member in shape_class.members[1:]:
            own = centered[member].transformed(SE3(slots[member].rotation.T, np.zeros(3)))
            meshes[member] = first if _same(own, first) or _has_room(member, first, raw, slots, contacts) else own
    return meshes


def _same(a: Mesh, b: Mesh) -> bool:
    """Return whether two meshes are equal up to rounding to 32-bit floats."""
    if a.vertices.shape != b.vertices.shape or not np.array_equal(a.faces, b.faces):
        return False
    return bool(np.abs(a.vertices - b.vertices).max() < _ROUNDING)


def _has_room(member: int, mesh: Mesh, raw: Sequence[Mesh], slots: Sequence[SE3], contacts: Sequence[Contact]) -> bool:
    """Return whether a mesh in a member's slot keeps enough distance from all parts that the member touches."""
    placed = mesh.transformed(slots[member])
    for contact in contacts:
        if member in (contact.a, contact.b):
            other = raw[contact.b if member == contact.a else contact.a]
            if nearest_points(placed, other).distance < _MIN_GAP_SHARE * nearest_points(raw[member], other).distance:
                return False
    return True
