"""Connection points of parts that touch: their places, their frames, and their order."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.contacts import Contact
from roboassembly.furniture.model import SAME_POINT, Connection, ConnectionPoint, ShapeClass
from roboassembly.geometry.mating import mated_frame
from roboassembly.geometry.poses import SE3

_SAME_DIRECTION = 0.3
"""Largest angle between the normals of corresponding contacts [rad]."""
_CONSISTENT = 1e-4
"""Largest difference at which the frames that both ends of a connection inherit count as equal [m, rad]."""


@dataclass(frozen=True, eq=False)
class Spot:
    """Position and normal of a contact in its part's frame."""

    position: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]

    def onto(self, other: Spot, rotations: Float[np.ndarray, "s 3 3"]) -> Float[np.ndarray, "m 3 3"]:
        """Return the rotations that map this spot to the other one; only those about as near as the nearest."""
        distance = np.linalg.norm(rotations @ self.position - other.position, axis=1)
        turned = np.linalg.norm(rotations @ self.normal - other.normal, axis=1)
        close = (distance < SAME_POINT) & (turned < _SAME_DIRECTION)
        return rotations[close & (distance < distance[close].min() + 1e-4)] if close.any() else rotations[:0]


def spot_of_contact(contact: Contact, part: int, slot: SE3) -> Spot:
    """Return the spot of one end of a contact, for the part in its slot `furniture_from_part`."""
    side = 1.0 if part == contact.a else -1.0
    position = contact.center - side * 0.5 * contact.gap * contact.normal
    return Spot(slot.rotation.T @ (position - slot.translation), side * (slot.rotation.T @ contact.normal))


@dataclass(eq=False)
class _Orbit:
    """Connection point of a shape up to the shape's symmetries; its frame is set when connections are traversed."""

    spot: Spot
    """Spot of the contact that introduced it."""
    frame: SE3 | None = None
    """`part_from_point`, as `ConnectionPoint.frame`."""


@dataclass(frozen=True, eq=False)
class _End:
    """One end of a connection."""

    part: int
    spot: Spot
    orbit: _Orbit
    carriers: Float[np.ndarray, "n 3 3"]
    """Symmetries of the part that map the orbit's spot to this one."""

    def inherited(self, slot: SE3) -> list[SE3]:
        """Return the `furniture_from_point` frames that the orbit offers to this end; none if its frame is not set."""
        if self.orbit.frame is None:
            return []
        return [slot * SE3(turn, np.zeros(3)) * self.orbit.frame for turn in self.carriers]


def connection_points(
    contacts: Sequence[Contact], slots: Sequence[SE3], classes: Sequence[ShapeClass], most_points: int
) -> tuple[list[list[ConnectionPoint]], tuple[Connection, ...]]:
    """Return the connection points of each part, and the connections that join them.

    Each contact has a point on either part. Parts of one class get equal points.

    Args:
        contacts: contacts of the parts in the assembled furniture.
        slots: `furniture_from_part` of each part.
        classes: the shape classes.
        most_points: number of points from which on a part gets no more points of its equals.
    """
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
        numbers: list[int] = []
        for part, placed in ((contact.a, frame), (contact.b, mated_frame(frame, contact.gap))):
            local = slots[part].actInv(placed)
            numbers += [part, len(points[part])]
            points[part].append(
                ConnectionPoint(local.translation, local.rotation[:, 2], local.rotation[:, 0], contact.gap)
            )
        connections.append(Connection(*numbers))
    _share_points(points, classes, most_points)
    return points, _number_points_alike(points, connections, classes)


def _ends(
    contacts: Sequence[Contact], slots: Sequence[SE3], class_of: dict[int, ShapeClass]
) -> list[tuple[_End, _End]]:
    """Return both ends of every contact, each with its orbit. No two contacts of a part share a place on it."""
    orbits: dict[int, list[_Orbit]] = {}
    occupied: dict[int, list[Float[np.ndarray, "3"]]] = {}

    def end(contact: Contact, part: int) -> _End:
        spot = spot_of_contact(contact, part, slots[part])
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


def _share_points(points: list[list[ConnectionPoint]], classes: Sequence[ShapeClass], most: int) -> None:
    """Give every member of a class the points of all members: parts of one shape have equal points, as in the paper.

    No part gets more than `most` points.
    """
    for shape_class in classes:
        everywhere = [p for member in shape_class.members for p in points[member]]
        for member in shape_class.members:
            for point in everywhere:
                there = any(len(_spot_of(p).onto(_spot_of(point), shape_class.symmetries)) for p in points[member])
                if not there and len(points[member]) < most:
                    points[member].append(point)


def _number_points_alike(
    points: list[list[ConnectionPoint]], connections: Sequence[Connection], classes: Sequence[ShapeClass]
) -> tuple[Connection, ...]:
    """Sort the points of each part as those of its class's first member; returns the connections, renumbered.

    The first member's points are in the order of its neighbours' numbers.
    """
    number: dict[tuple[int, int], int] = {}
    for shape_class in classes:
        reference: list[Spot] = []
        for member in shape_class.members:
            place = _places(points[member], reference, shape_class.symmetries)
            order = sorted(range(len(place)), key=place.__getitem__)
            number.update({(member, old): new for new, old in enumerate(order)})
            points[member] = [points[member][old] for old in order]
    return tuple(
        Connection(c.part_a, number[c.part_a, c.point_a], c.part_b, number[c.part_b, c.point_b]) for c in connections
    )


def _places(
    points: Sequence[ConnectionPoint], reference: list[Spot], symmetries: Float[np.ndarray, "s 3 3"]
) -> list[int]:
    """Return the index in `reference` of each point's spot, which gets the spots that it lacks.

    A point takes the spot where it is, else one where a symmetry of the shape takes it.
    """
    place = [-1] * len(points)
    for rotations in (symmetries[:1], symmetries):
        for index, point in enumerate(points):
            if place[index] < 0:
                matching = (
                    i
                    for i, spot in enumerate(reference)
                    if i not in place and len(_spot_of(point).onto(spot, rotations))
                )
                place[index] = next(matching, -1)
    for index, point in enumerate(points):
        if place[index] < 0:
            place[index] = len(reference)
            reference.append(_spot_of(point))
    return place


def _spot_of(point: ConnectionPoint) -> Spot:
    return Spot(point.position, point.normal)
