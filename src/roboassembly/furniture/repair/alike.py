"""Parts that are delivered alike are made solid alike, and stay alike when they are trimmed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import manifold3d as m3
import numpy as np
from jaxtyping import Float

from roboassembly.furniture.congruence import rotations_onto
from roboassembly.furniture.model import CONTACT_DISTANCE, RawPart
from roboassembly.furniture.repair.limits import RepairLimits
from roboassembly.furniture.repair.piece import Piece
from roboassembly.furniture.repair.proximity import Shell
from roboassembly.furniture.repair.surface import to_surface
from roboassembly.furniture.repair.trim import TIDY, without_slivers
from roboassembly.meshes import Mesh

SAME_SHAPE = 1e-3
"""Metres: parts whose corners agree to this are delivered alike; whoever drew them meant one part."""
MAX_TURNS = 16
"""Symmetries of a shape that are tried to lay its members' cuts over one another."""
MAX_EXTRA = 0.03
"""Share of its volume that a part may lose, beyond what the most trimmed of its like lost, to stay like it."""
WORTH_TURNING = 0.001
"""Share of a part's volume that another turn must save."""
MAX_FEATURED_FACES = 60_000
"""Parts of more triangles are not compared."""


@dataclass(frozen=True, eq=False)
class Likeness:
    """A part that is a moved copy of another, or of itself."""

    master: int
    turns: Float[np.ndarray, "n 3 3"]
    """Every rotation that lays the master, about its centre, onto this part."""
    master_centre: Float[np.ndarray, "3"]
    centre: Float[np.ndarray, "3"]
    """Metres; the same point of this part."""

    def placed(self, body: m3.Manifold, turn: int = 0) -> m3.Manifold:
        """The master's solid where this part is."""
        rotation = self.turns[turn]
        shift = self.centre - rotation @ self.master_centre
        return body.transform(np.column_stack([rotation, shift]))

    def taken_back(self, body: m3.Manifold, turn: int = 0) -> m3.Manifold:
        """This part's solid where the master is."""
        rotation = self.turns[turn].T
        return body.transform(np.column_stack([rotation, self.master_centre - rotation @ self.centre]))


def likenesses(parts: Sequence[RawPart]) -> list[Likeness]:
    """For each part the first that it is congruent to, as delivered; mirror images are not."""
    centred: list[Mesh] = []
    out: list[Likeness] = []
    for index, part in enumerate(parts):
        centre = _middle(part.mesh)
        mesh = Mesh(part.mesh.vertices - centre, part.mesh.faces)
        centred.append(mesh)
        found = Likeness(index, np.eye(3)[None], centre, centre)
        for master in range(index):
            if out[master].master != master or not _comparable(centred[master], mesh):
                continue
            turns = rotations_onto(centred[master], mesh, SAME_SHAPE)
            if len(turns):
                found = Likeness(master, turns[:MAX_TURNS], out[master].centre, centre)
                break
        out.append(found)
    return out


def _middle(mesh: Mesh) -> Float[np.ndarray, "3"]:
    """Centroid of the triangles: it needs no inside, and repeated triangles are few."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    weight = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return (weight[:, None] * (a + b + c)).sum(axis=0) / (3.0 * weight.sum())


def _comparable(one: Mesh, two: Mesh) -> bool:
    flat = min(np.linalg.svd(mesh.vertices, compute_uv=False)[2] for mesh in (one, two)) < 1e-4
    return not flat and abs(len(one.faces) - len(two.faces)) <= 0.2 * len(one.faces) <= 0.2 * MAX_FEATURED_FACES


def keep_alike(pieces: list[Piece], alike: Sequence[Likeness], limits: RepairLimits) -> None:
    """Give all members of a class the cuts of every member, in place, where that costs little and parts no contact.

    Cutting more makes no overlap and holds nothing fast.
    """
    for master in range(len(pieces)):
        members = [p for p, like in enumerate(alike) if like.master == master]
        if len(members) > 1 and any(pieces[p].removed > 0.0 for p in members):
            _share_cuts(pieces, alike, members, limits)


def _still_alike(bodies: Sequence[m3.Manifold]) -> bool:
    """Whether the first body can be laid onto each of the others."""
    centred = []
    for body in bodies:
        skin = to_surface(body)
        mesh = Mesh(skin.vertices, skin.faces)
        centred.append(Mesh(mesh.vertices - mesh.center_of_mass, mesh.faces))
    return all(len(rotations_onto(centred[0], mesh)) for mesh in centred[1:])


def _share_cuts(pieces: list[Piece], alike: Sequence[Likeness], members: list[int], limits: RepairLimits) -> None:
    master = members[0]
    moved = [pieces[p].moved for p in members]
    unmoved = [pieces[p].body.translate(tuple((-m).tolist())) for p, m in zip(members, moved, strict=True)]
    if _still_alike(unmoved):
        return
    common, chosen = unmoved[0], [0]
    for p, body in zip(members[1:], unmoved[1:], strict=True):
        turns = range(len(alike[p].turns))
        tries = [common ^ alike[p].taken_back(body, turn) for turn in turns]
        best = max(turns, key=lambda turn: tries[turn].volume())
        # The copies were placed by the first turn, so that it fits exactly; the others do within the tolerance.
        if tries[best].volume() < tries[0].volume() + WORTH_TURNING * pieces[master].whole:
            best = 0
        common = tries[best].simplify(TIDY)
        chosen.append(best)
    common = without_slivers(common)
    whole = pieces[master].whole
    extra = min(body.volume() for body in unmoved) - common.volume()
    loses = whole - common.volume()
    if loses > limits.trimmed * whole or extra > MAX_EXTRA * whole:
        return
    if any(len(common.decompose()) > len(body.decompose()) for body in unmoved):
        return
    fresh = {
        p: alike[p].placed(common, turn).translate(tuple(m.tolist()))
        for p, turn, m in zip(members, chosen, moved, strict=True)
    }
    shells = {p: Shell(to_surface(body)) for p, body in fresh.items()}
    for p in members:
        for q, other in enumerate(pieces):
            if q == p or pieces[p].shell.box_distance(other.shell) >= CONTACT_DISTANCE:
                continue
            if pieces[p].shell.nearest(other.shell)[0] >= CONTACT_DISTANCE:
                continue
            if shells[p].nearest(shells.get(q, other.shell))[0] >= CONTACT_DISTANCE:
                return
    for p, body in fresh.items():
        piece = pieces[p]
        if body.volume() < piece.body.volume() * (1.0 - 1e-6):
            piece.notes.append("cut like the parts that are like it")
        piece.removed = max(piece.removed, piece.whole - body.volume())
        piece.become(body)
