"""Annotation of raw parts: frames at the centre of mass, shape classes, contacts, connection points, grasps."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from roboassembly.errors import FurnitureError
from roboassembly.furniture.contacts import Contact, find_contacts
from roboassembly.furniture.grasps import find_grasps
from roboassembly.furniture.model import (
    MAX_POINTS,
    SAME_POINT,
    Connection,
    ConnectionPoint,
    Furniture,
    GraspRegion,
    Part,
    Provenance,
    RawPart,
    ShapeClass,
    check_part_count,
)
from roboassembly.furniture.symmetry import rotations_onto, symmetries
from roboassembly.geometry.mating import mated_frame
from roboassembly.geometry.meshes import Mesh, nearest_points
from roboassembly.geometry.poses import SE3

_SAME_DIRECTION = 0.3
"""Largest angle between the normals of corresponding contacts [rad]."""
_CONSISTENT = 1e-4
"""Largest difference at which the frames that both ends of a connection inherit count as equal [m, rad]."""


_ROUNDING = 2e-6
"""Largest difference of coordinates due to rounding to 32-bit floats [m]."""
_HAND = 0.25
"""Distance beyond a part's box that an approaching hand may occupy [m]."""
_LIKES = 4
"""Number of parts of one shape whose surroundings the search for grasps takes into account."""
_MIN_GAP_SHARE = 0.5
"""Share of the distance to a neighbour that has to remain when a part takes the mesh of its class."""


def annotate(name: str, raw: Sequence[RawPart], provenance: Provenance, *, with_grasps: bool = True) -> Furniture:
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
    contacts, notes = _bounded_contacts(find_contacts([p.mesh for p in raw], names), names)
    classes, rotations = _classify(centered)
    rotations = _turn_to_match_points(classes, rotations, centers, contacts)
    slots = tuple(SE3(r, c) for r, c in zip(rotations, centers, strict=True))
    meshes = _part_meshes([p.mesh for p in raw], centered, classes, slots, contacts)
    points, connections = _connection_points(contacts, slots, classes)
    parts = tuple(
        Part(part.name, mesh, tuple(own), part.label) for part, mesh, own in zip(raw, meshes, points, strict=True)
    )
    provenance = replace(provenance, notes=(*provenance.notes, *notes))
    furniture = Furniture(name, parts, slots, connections, classes, provenance)
    return add_grasps(furniture) if with_grasps else furniture


def add_grasps(furniture: Furniture) -> Furniture:
    """Return the furniture with newly computed grasps in place of those it has."""
    meshes = [part.mesh for part in furniture.parts]
    grasps: dict[int, tuple[GraspRegion, ...]] = {}
    for c in furniture.classes:
        around = [_around(member, meshes, furniture.assembled) for member in c.members[:_LIKES]]
        regions = find_grasps(meshes[c.members[0]], [m for m in around if m is not None])
        grasps.update(dict.fromkeys(c.members, regions))
    return replace(furniture, parts=tuple(replace(p, grasps=grasps[i]) for i, p in enumerate(furniture.parts)))


def _around(part: int, meshes: Sequence[Mesh], slots: Sequence[SE3]) -> Mesh | None:
    """Return what a hand at a part could touch in the assembled furniture, in the part's frame; None if nothing."""
    low, high = meshes[part].bounds
    near = []
    for other, (mesh, slot) in enumerate(zip(meshes, slots, strict=True)):
        moved = mesh.transformed(slots[part].actInv(slot))
        if other != part and (moved.bounds[0] < high + _HAND).all() and (moved.bounds[1] > low - _HAND).all():
            near.append(moved)
    if not near:
        return None
    starts = np.cumsum([0, *(len(m.vertices) for m in near[:-1])])
    faces = [m.faces + start for m, start in zip(near, starts, strict=True)]
    return Mesh(np.concatenate([m.vertices for m in near]), np.concatenate(faces))


def _bounded_contacts(contacts: tuple[Contact, ...], names: Sequence[str]) -> tuple[list[Contact], list[str]]:
    """Drop the smallest patches of parts with more than `MAX_POINTS` points, as long as all parts stay connected."""
    kept, notes = list(contacts), []
    for contact in sorted(contacts, key=lambda c: c.area):
        crowded = [p for p in (contact.a, contact.b) if sum(p in (c.a, c.b) for c in kept) > MAX_POINTS]
        if not crowded:
            continue
        rest = [c for c in kept if c is not contact]
        if _reaches(contact.a, contact.b, rest):
            kept = rest
            notes.append(
                f"contact of '{names[contact.a]}' and '{names[contact.b]}' left out: more than {MAX_POINTS} points"
            )
    for p, part in enumerate(names):
        count = sum(p in (c.a, c.b) for c in kept)
        if count > MAX_POINTS:
            raise FurnitureError(f"part '{part}' touches {count} others that nothing else holds; at most {MAX_POINTS}")
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


@dataclass(frozen=True, eq=False)
class _Spot:
    """Position and normal of a contact in its part's frame."""

    position: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]

    def onto(self, other: _Spot, rotations: Float[np.ndarray, "s 3 3"]) -> Float[np.ndarray, "m 3 3"]:
        """Return the rotations that map this spot to the other one; only those about as near as the nearest."""
        distance = np.linalg.norm(rotations @ self.position - other.position, axis=1)
        turned = np.linalg.norm(rotations @ self.normal - other.normal, axis=1)
        close = (distance < SAME_POINT) & (turned < _SAME_DIRECTION)
        return rotations[close & (distance < distance[close].min() + 1e-4)] if close.any() else rotations[:0]


def _spot(contact: Contact, part: int, slot: SE3) -> _Spot:
    side = 1.0 if part == contact.a else -1.0
    position = contact.center - side * 0.5 * contact.gap * contact.normal
    return _Spot(slot.rotation.T @ (position - slot.translation), side * (slot.rotation.T @ contact.normal))


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

        def spots(part: int, rotation: Float[np.ndarray, "3 3"]) -> list[_Spot]:
            slot = SE3(rotation, centers[part])
            return [_spot(c, part, slot) for c in contacts if part in (c.a, c.b)]

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


@dataclass(eq=False)
class _Orbit:
    """Connection point of a shape up to the shape's symmetries; its frame is set when connections are traversed."""

    spot: _Spot
    """Spot of the contact that introduced it."""
    frame: SE3 | None = None
    """`part_from_point`, as `ConnectionPoint.frame`."""


@dataclass(frozen=True, eq=False)
class _End:
    """One end of a connection."""

    part: int
    spot: _Spot
    orbit: _Orbit
    carriers: Float[np.ndarray, "n 3 3"]
    """Symmetries of the part that map the orbit's spot to this one."""

    def inherited(self, slot: SE3) -> list[SE3]:
        """Return the `furniture_from_point` frames that the orbit offers to this end; none if its frame is not set."""
        if self.orbit.frame is None:
            return []
        return [slot * SE3(turn, np.zeros(3)) * self.orbit.frame for turn in self.carriers]


def _connection_points(
    contacts: Sequence[Contact], slots: Sequence[SE3], classes: Sequence[ShapeClass]
) -> tuple[list[list[ConnectionPoint]], tuple[Connection, ...]]:
    class_of = {member: c for c in classes for member in c.members}
    ends = _ends(contacts, slots, class_of)
    frames: list[SE3] = [SE3.Identity()] * len(contacts)
    for index in _walk(ends, class_of):
        # The end whose class has more members leads: its points have to stay equal over the class.
        lead, other = sorted(ends[index], key=lambda e: -len(class_of[e.part].members))
        sign = 1.0 if lead.part == contacts[index].a else -1.0
        frames[index] = _agree(
            lead.inherited(slots[lead.part]),
            [mated_frame(f, contacts[index].gap) for f in other.inherited(slots[other.part])],
            _own_frame(contacts[index], sign),
        )
        for end, frame in ((lead, frames[index]), (other, mated_frame(frames[index], contacts[index].gap))):
            if end.orbit.frame is None:
                end.orbit.frame = SE3(end.carriers[0].T, np.zeros(3)) * slots[end.part].actInv(frame)
        if lead.part != contacts[index].a:
            frames[index] = mated_frame(frames[index], contacts[index].gap)

    points: list[list[ConnectionPoint]] = [[] for _ in slots]
    connections: list[Connection] = []
    for contact, frame in zip(contacts, frames, strict=True):
        corners = []
        for part, placed in ((contact.a, frame), (contact.b, mated_frame(frame, contact.gap))):
            local = slots[part].actInv(placed)
            corners.extend([part, len(points[part])])
            points[part].append(
                ConnectionPoint(local.translation, local.rotation[:, 2], local.rotation[:, 0], contact.gap)
            )
        connections.append(Connection(*corners))
    _share_points(points, classes)
    return points, tuple(connections)


def _ends(
    contacts: Sequence[Contact], slots: Sequence[SE3], class_of: dict[int, ShapeClass]
) -> list[tuple[_End, _End]]:
    """Return both ends of every contact, each with its orbit. No two contacts of a part share a place on it."""
    orbits: dict[int, list[_Orbit]] = {}
    occupied: dict[int, list[Float[np.ndarray, "3"]]] = {}

    def end(contact: Contact, part: int) -> _End:
        spot = _spot(contact, part, slots[part])
        shape_class = class_of[part]
        own = orbits.setdefault(shape_class.members[0], [])
        there = occupied.setdefault(part, [])
        for orbit in own:
            carriers = orbit.spot.onto(spot, shape_class.symmetries)
            if len(carriers) and not any(np.linalg.norm(carriers[0] @ orbit.spot.position - t) < 1e-4 for t in there):
                break
        else:
            orbit, carriers = _Orbit(spot), np.eye(3)[None]
            own.append(orbit)
        there.append(carriers[0] @ orbit.spot.position)
        return _End(part, spot, orbit, carriers)

    return [(end(c, c.a), end(c, c.b)) for c in contacts]


def _own_frame(contact: Contact, sign: float) -> SE3:
    """Return the default `furniture_from_point` of a contact, on the side of `a` (sign 1) or `b` (-1)."""
    normal = sign * contact.normal
    axis = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    tangent = axis - (axis @ normal) * normal
    tangent /= np.linalg.norm(tangent)
    position = contact.center - 0.5 * contact.gap * normal
    return SE3(np.column_stack([tangent, np.cross(normal, tangent), normal]), position)


def _walk(ends: Sequence[tuple[_End, _End]], class_of: dict[int, ShapeClass]) -> list[int]:
    """Return the contacts in breadth-first order over the orbits that they join, which avoids conflicting frames."""
    order: list[int] = []
    done: set[int] = set()
    starts = sorted(range(len(ends)), key=lambda i: (-max(len(class_of[e.part].members) for e in ends[i]), i))
    for start in starts:
        queue = deque([start])
        while queue:
            index = queue.popleft()
            if index in done:
                continue
            done.add(index)
            order.append(index)
            here = {id(e.orbit) for e in ends[index]}
            queue.extend(i for i in range(len(ends)) if i not in done and any(id(e.orbit) in here for e in ends[i]))
    return order


def _agree(lead: Sequence[SE3], other: Sequence[SE3], own: SE3) -> SE3:
    """Return the frame of a connection: one that both ends inherit, else one that either does, else its own."""
    for a in lead:
        for b in other:
            if np.abs(a.homogeneous - b.homogeneous).max() < _CONSISTENT:
                return a
    return (*lead, *other, own)[0]


def _share_points(points: list[list[ConnectionPoint]], classes: Sequence[ShapeClass]) -> None:
    """Give every member of a class the points of all members: parts of one shape have equal points, as in the paper."""
    for shape_class in classes:
        everywhere = [p for member in shape_class.members for p in points[member]]
        for member in shape_class.members:
            for point in everywhere:
                spot = _Spot(point.position, point.normal)
                there = any(len(_Spot(p.position, p.normal).onto(spot, shape_class.symmetries)) for p in points[member])
                if not there and len(points[member]) < MAX_POINTS:
                    points[member].append(point)
