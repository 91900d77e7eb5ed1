"""Exchange of parts of nearly one shape: equal parts but for marks and millimetres, and boards that fit either way.

Two parts are interchangeable if either may stand in the other's place in the finished furniture, so that nothing
penetrates and no connection opens; a part has another symmetry if it may be turned in its place in the same way. The
real meshes decide, in all combinations with what may stand beside them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import coal
import numpy as np
from jaxtyping import Float

from roboassembly.furniture.contacts import Contact
from roboassembly.furniture.model import CONTACT_DISTANCE, NEAR, SAME_POINT, ShapeClass
from roboassembly.furniture.near_shapes import NearShape
from roboassembly.furniture.turns import SAME_TURN, groups
from roboassembly.geometry.meshes import Mesh, collision_request, distances_to, nearest_points
from roboassembly.geometry.poses import SE3, orthonormal, shifted, transform_points

LEAST_CLEARANCE = 1e-4
"""Least distance that an exchanged part keeps from its neighbours [m]: half of the gap that repair leaves."""
CLEARANCE_SHARE = 0.5
"""The same as a share of the distance between the neighbours' own parts, if these are closer together."""
MAX_TESTS = 2_000
"""Largest number of pairs of placed parts that are tested for one exchange."""
_AROUND = [np.array([x, y, z]) for x, y, z in product((0.0, 1.0, -1.0), repeat=3) if x or y or z]
NUDGES: tuple[Float[np.ndarray, "3"], ...] = (
    np.zeros(3),
    *(size * way for size in (1e-4, 2e-4, 4e-4) for way in _AROUND),
)
"""Translations that are tried on top of the best fit of two shapes, which may touch where others have room [m]."""
_SAME_DIRECTION = 0.3
"""Largest angle between the normals of contacts that fall on each other [rad]."""
_SAME_PLACE = 2e-5
"""Largest distance between two placed meshes that count as one [m]."""
_FEW = 200
"""Number of corners that measure it."""


@dataclass(frozen=True, eq=False)
class Exchange:
    """Parts with the classes and frames in which they may be exchanged."""

    classes: tuple[ShapeClass, ...]
    slots: tuple[SE3, ...]
    """`furniture_from_part` of each part."""
    meshes: tuple[Mesh, ...]
    """Meshes in the parts' frames [m]."""


def interchangeable(
    classes: Sequence[ShapeClass], slots: Sequence[SE3], meshes: Sequence[Mesh], contacts: Sequence[Contact]
) -> Exchange:
    """Return classes in which parts of nearly one shape are together, with all turns that leave the furniture sound.

    Frames change where classes change: those of two classes that become one coincide where their shapes fall on each
    other, and a part's frame lies in the middle of its turns. It may then be some millimetres off its centre of mass.

    Args:
        classes: classes of exactly equal parts.
        slots: `furniture_from_part` of each part.
        meshes: meshes in the parts' frames; equal parts share them [m].
        contacts: contacts of the parts in the assembled furniture.
    """
    search = _Search(slots, meshes, contacts, classes)
    return search.result(search.turned(search.joined(search.sure(_of_one_mesh(classes, meshes)))))


def _of_one_mesh(classes: Sequence[ShapeClass], meshes: Sequence[Mesh]) -> list[_Class]:
    """Return the classes without members whose place has no room for the mesh of the first one."""
    out: list[_Class] = []
    for c in classes:
        by_mesh: dict[int, list[int]] = {}
        for member in c.members:
            by_mesh.setdefault(id(meshes[member]), []).append(member)
        out += [_Class(tuple(members), c.symmetries) for members in by_mesh.values()]
    return sorted(out, key=lambda c: c.members[0])


@dataclass(frozen=True, eq=False)
class _Class:
    """Class of parts during the search; frames are those that it proposes for its members."""

    members: tuple[int, ...]
    symmetries: Float[np.ndarray, "s 3 3"]
    frames: tuple[SE3, ...] | None = None
    """`new_from_old` part frames of the members; None if they stay."""

    def new_from_old(self, member: int) -> SE3:
        return SE3.Identity() if self.frames is None else self.frames[self.members.index(member)]


@dataclass(frozen=True, eq=False)
class _Placed:
    """Mesh in a slot."""

    mesh: Mesh
    furniture_from_mesh: SE3
    sole: bool
    """Whether the furniture has only one part with this mesh."""


class _Search:
    def __init__(
        self, slots: Sequence[SE3], meshes: Sequence[Mesh], contacts: Sequence[Contact], exact: Sequence[ShapeClass]
    ) -> None:
        self._slots, self._meshes, self._contacts = slots, meshes, contacts
        self._touching = {frozenset((c.a, c.b)) for c in contacts}
        self._exact = {member: c for c in exact for member in c.members}
        placed = [mesh.transformed(slot) for mesh, slot in zip(meshes, slots, strict=True)]
        self._placed = placed
        self._shapes = [NearShape(mesh) for mesh in placed]
        self._least_of: dict[frozenset[int], float] = {}
        self._known_variants: dict[tuple[int, _Class], list[_Placed]] = {}
        self._errors: dict[tuple[Mesh, ShapeClass, int], float] = {}
        self._failed: set[tuple[int, int]] = set()

    def sure(self, classes: list[_Class]) -> list[_Class]:
        """Return the classes without those symmetries that hold up to a tolerance only and that neighbours forbid."""
        out = list(classes)
        for index, known in enumerate(classes):
            first = known.members[0]
            errors = [self._error(self._meshes[first], self._exact[first], i) for i in range(len(known.symmetries))]
            exact = known.symmetries[np.array(errors) < _SAME_PLACE]
            if len(exact) < len(known.symmetries) and not self._is_sound(known, [*out[:index], *out[index + 1 :]]):
                out[index] = _Class(known.members, groups(exact)[0])
        return out

    def joined(self, classes: list[_Class]) -> list[_Class]:
        """Return the classes, with those joined whose parts are interchangeable."""
        done: list[_Class] = []
        for number, new in enumerate(classes):
            # Equal parts come first.
            for index, known in sorted(enumerate(done), key=lambda entry: not self._are_equal(entry[1], new)):
                others = [*done[:index], *done[index + 1 :], *classes[number + 1 :]]
                both = next((c for c in self._joins(known, new) if self._is_sound(c, others)), None)
                if both is not None:
                    done[index] = both
                    break
            else:
                done.append(new)
        return done

    def _are_equal(self, known: _Class, new: _Class) -> bool:
        """Return whether the first parts of two classes have one shape exactly."""
        return self._exact[known.members[0]] is self._exact[new.members[0]]

    def _joins(self, known: _Class, new: _Class) -> Iterable[_Class]:
        """Yield ways to join two classes, those first in which most connections coincide."""
        first, other = known.members[0], new.members[0]
        if self._are_equal(known, new):
            frames = {p: c.new_from_old(p) for c in (known, new) for p in c.members}
            members = tuple(sorted(frames))
            moved = tuple(frames[p] for p in members)
            yield _Class(members, known.symmetries, None if known.frames is None else moved)
        fitted = self._shapes[first].motions_onto(self._shapes[other])
        motions = [shifted(m, nudge) for m in fitted for nudge in NUDGES]
        matches = [self._matches(m, self._spots(first), self._spots(other)) for m in motions]
        for index in sorted(range(len(motions)), key=lambda i: -matches[i]):
            if not matches[index]:
                continue
            # The frame of `other` in which its shape falls on the first one's.
            old_from_new = (
                self._slots[other].inverse() * motions[index] * self._slots[first] * known.new_from_old(first).inverse()
            )
            new_from_old = orthonormal(old_from_new).inverse()
            turns = np.einsum("ij,sjk,lk->sil", new_from_old.rotation, new.symmetries, new_from_old.rotation)
            symmetries = _larger(known.symmetries, turns)
            if symmetries is None:
                continue
            frames = {p: known.new_from_old(p) for p in known.members}
            frames.update(dict.fromkeys(new.members, new_from_old))
            members = tuple(sorted(frames))
            yield _Class(members, symmetries, tuple(frames[p] for p in members))

    def turned(self, classes: list[_Class]) -> list[_Class]:
        """Return the classes with all symmetries that leave the furniture sound."""
        out = list(classes)
        for index, known in enumerate(classes):
            others = [*out[:index], *out[index + 1 :]]
            better = next((c for c in self._turns(known) if self._is_sound(c, others)), None)
            out[index] = known if better is None else better
        return out

    def _turns(self, known: _Class) -> Iterable[_Class]:
        """Yield the class with more symmetries, the most first."""
        first = known.members[0]
        frame = self._slots[first] * known.new_from_old(first).inverse()
        motions = [frame.inverse() * m * frame for m in self._shapes[first].motions_onto(self._shapes[first])]
        to_known = known.new_from_old(first)
        motions += [to_known * SE3(turn, np.zeros(3)) * to_known.inverse() for turn in self._exact[first].symmetries]
        everything = known.symmetries
        for motion in motions:
            if _distance(everything, motion.rotation) > SAME_TURN:
                everything = np.concatenate([everything, motion.rotation[None]])
        if len(everything) == len(known.symmetries):
            return
        spots = [
            (frame * known.new_from_old(p) * self._slots[p].inverse(), spot)
            for p in known.members
            for spot in self._spots(p)
        ]
        ends = [(motion.act(x), motion.rotation @ n) for motion, (x, n) in spots]
        for group in groups(everything):
            if len(group) <= len(known.symmetries) or any(_distance(group, t) > SAME_TURN for t in known.symmetries):
                continue
            # The middle of all places to which the motions take a point stays where it is.
            middles = [
                np.mean([_origin_after(turn, some) for turn in group], axis=0) for some in (motions, motions[::-1])
            ]
            for middle, nudge in product(middles, NUDGES):
                center = middle + frame.rotation.T @ nudge
                about = [SE3(turn, center - turn @ center) for turn in group]
                if all(self._matches(frame * m * frame.inverse(), ends, ends) for m in about[1:]):
                    shift = SE3(np.eye(3), -center)
                    yield _Class(known.members, group, tuple(shift * known.new_from_old(p) for p in known.members))

    def _spots(self, part: int) -> list[tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]]:
        """Return position and outward normal of a part's contacts in the furniture's frame [m]."""
        return [(c.center, c.normal if part == c.a else -c.normal) for c in self._contacts if part in (c.a, c.b)]

    def _matches(
        self,
        motion: SE3,
        spots: Sequence[tuple[np.ndarray, np.ndarray]],
        others: Sequence[tuple[np.ndarray, np.ndarray]],
    ) -> int:
        """Return the number of contacts that a motion lays on others."""
        return sum(
            any(
                np.linalg.norm(motion.act(x) - y) < SAME_POINT
                and np.linalg.norm(motion.rotation @ n - m) < _SAME_DIRECTION
                for y, m in others
            )
            for x, n in spots
        )

    def _is_sound(self, changed: _Class, others: Sequence[_Class]) -> bool:
        """Return whether each part of a class may stand in all its slots, in all turns, beside all neighbours."""
        class_of = {member: c for c in (changed, *others) for member in c.members}
        pairs = [(s, t) for s in changed.members for t in class_of if s < t or t not in changed.members]
        pairs = [(s, t) for s, t in pairs if s != t and self._are_near(s, t)]
        # The pair that failed for the last candidate often fails for the next one, too.
        pairs.sort(key=lambda pair: pair not in self._failed)
        variants = {p: self._variants(p, class_of[p]) for pair in pairs for p in pair}
        if sum(len(variants[s]) * len(variants[t]) for s, t in pairs) > MAX_TESTS:
            return False
        for s, t in pairs:
            for a, b in product(variants[s], variants[t]):
                if not (a.sole and a.mesh is b.mesh) and not self._clear(a, b, s, t):
                    self._failed = {(s, t)}
                    return False
        return True

    def _variants(self, slot: int, shape_class: _Class) -> list[_Placed]:
        """Return everything that may stand in a slot, without repetitions. Results are cached."""
        if (slot, shape_class) in self._known_variants:
            return self._known_variants[slot, shape_class]
        out: list[_Placed] = []
        seen: list[Mesh] = []
        there = self._slots[slot] * shape_class.new_from_old(slot).inverse()
        for part in shape_class.members:
            mesh = self._meshes[part]
            if any(mesh is other for other in seen):
                continue
            seen.append(mesh)
            sole = sum(self._meshes[p] is mesh for p in shape_class.members) == 1
            poses: list[SE3] = []
            for turn in shape_class.symmetries:
                pose = there * SE3(turn, np.zeros(3)) * shape_class.new_from_old(part)
                if not any(self._looks_same(part, other.inverse() * pose) for other in poses):
                    poses.append(pose)
            out += [_Placed(mesh, pose, sole) for pose in poses]
        self._known_variants[slot, shape_class] = out
        return out

    def _looks_same(self, part: int, motion: SE3) -> bool:
        """Return whether a motion of a part in its own frame leaves its shape where it is."""
        exact = self._exact[part]
        index = int(np.argmin(np.abs(exact.symmetries - motion.rotation).max(axis=(1, 2))))
        moved = _distance(exact.symmetries, motion.rotation) * self._meshes[part].radius
        moved += float(np.linalg.norm(motion.translation))
        return moved < _SAME_PLACE and self._error(self._meshes[part], exact, index) < _SAME_PLACE

    def _error(self, mesh: Mesh, exact: ShapeClass, index: int) -> float:
        """Return how far a symmetry takes corners of a mesh off its surface [m]. Results are cached."""
        if (mesh, exact, index) not in self._errors:
            some = mesh.vertices[np.linspace(0, len(mesh.vertices) - 1, min(len(mesh.vertices), _FEW)).astype(int)]
            turned = some @ exact.symmetries[index].T
            self._errors[mesh, exact, index] = float(distances_to(mesh.bvh, turned).max()) if index else 0.0
        return self._errors[mesh, exact, index]

    def _are_near(self, first: int, second: int) -> bool:
        (low, high), (other_low, other_high) = self._placed[first].bounds, self._placed[second].bounds
        return bool((np.maximum(low - other_high, other_low - high) < CONTACT_DISTANCE + 2.0 * NEAR).all())

    def _clear(self, a: _Placed, b: _Placed, s: int, t: int) -> bool:
        """Return whether two placed meshes keep apart, and meet if their slots do."""
        if _within(a, b, self._least(s, t)):
            return False
        if frozenset((s, t)) in self._touching and not _within(a, b, CONTACT_DISTANCE):
            return False
        b_from_a = b.furniture_from_mesh.actInv(a.furniture_from_mesh)
        inner, outer = transform_points(b_from_a, a.mesh.vertices[:1])[0], b.mesh.vertices[:1]
        return not b.mesh.contains(inner) and not a.mesh.contains(transform_points(b_from_a.inverse(), outer)[0])

    def _least(self, s: int, t: int) -> float:
        """Return the distance that parts in two slots have to keep [m]."""
        pair = frozenset((s, t))
        if pair not in self._least_of:
            own = (
                nearest_points(self._placed[s], self._placed[t]).distance
                if pair in self._touching
                else CONTACT_DISTANCE
            )
            self._least_of[pair] = min(LEAST_CLEARANCE, CLEARANCE_SHARE * own)
        return self._least_of[pair]

    def result(self, classes: Sequence[_Class]) -> Exchange:
        """Return the furniture with the frames of the classes."""
        slots, meshes = list(self._slots), list(self._meshes)
        for c in classes:
            if c.frames is None:
                continue
            made: dict[tuple[int, bytes], Mesh] = {}
            for part, new_from_old in zip(c.members, c.frames, strict=True):
                if (new_from_old.homogeneous == np.eye(4)).all():
                    continue
                slots[part] = self._slots[part] * new_from_old.inverse()
                key = (id(self._meshes[part]), new_from_old.homogeneous.tobytes())
                meshes[part] = made.setdefault(key, self._meshes[part].transformed(new_from_old))
        ordered = sorted(classes, key=lambda c: c.members[0])
        return Exchange(tuple(ShapeClass(c.members, c.symmetries) for c in ordered), tuple(slots), tuple(meshes))


def _within(a: _Placed, b: _Placed, margin: float) -> bool:
    """Return whether two surfaces are closer than `margin` [m]."""
    request = collision_request()
    request.security_margin = margin
    places = [coal.Transform3s(x.furniture_from_mesh.rotation, x.furniture_from_mesh.translation) for x in (a, b)]
    return bool(coal.collide(a.mesh.bvh, places[0], b.mesh.bvh, places[1], request, coal.CollisionResult()))


def _distance(turns: Float[np.ndarray, "s 3 3"], turn: Float[np.ndarray, "3 3"]) -> float:
    """Return the largest entry of the difference from the nearest of some rotations."""
    return float(np.abs(turns - turn).max(axis=(1, 2)).min())


def _origin_after(turn: Float[np.ndarray, "3 3"], motions: Sequence[SE3]) -> Float[np.ndarray, "3"]:
    """Return where the first motion with about this rotation takes the origin; none: it stays where it is [m]."""
    return next((m.translation for m in motions if np.abs(m.rotation - turn).max() < SAME_TURN), np.zeros(3))


def _larger(first: Float[np.ndarray, "s 3 3"], second: Float[np.ndarray, "t 3 3"]) -> Float[np.ndarray, "n 3 3"] | None:
    """Return the one of two groups that holds the other; None if neither does."""
    if all(_distance(first, turn) < SAME_TURN for turn in second):
        return first
    return second if all(_distance(second, turn) < SAME_TURN for turn in first) else None
