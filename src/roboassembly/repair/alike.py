"""Parts that are delivered alike are made solid alike, and stay alike when they are trimmed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import manifold3d as m3
import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import CONTACT_DISTANCE, RawPart
from roboassembly.furniture.symmetry import rotations_onto, symmetries
from roboassembly.geometry.meshes import Mesh
from roboassembly.repair.limits import RepairLimits
from roboassembly.repair.piece import Piece
from roboassembly.repair.proximity import Shell
from roboassembly.repair.surface import to_surface
from roboassembly.repair.trim import without_slivers
from roboassembly.repair.turns import MAX_TURNS, SAME_TURN, groups

SAME_SHAPE = 1e-3
"""Metres: parts whose corners agree to this are delivered alike; whoever drew them meant one part."""
MAX_EXTRA = 0.03
"""Share of its volume that a part may lose, beyond what the most trimmed of its like lost, to stay like it."""
MAX_DEPTH = 0.002
"""Metres: deeper cuts are pockets and shortened ends, and are not made where no other part asks for them."""
MAX_GROUPS = 4
"""Groups of turns that are tried: as many as a board has."""
MAX_TURNED = 12_000
"""Triangles of a part, times its turns: intersecting more of them takes minutes."""
MAX_SHORTER = 0.001
"""Metres of a part's size, or of a joint's depth, that cuts in other turns, or those of parts like it, may take."""
MIN_TURN_GAIN = 0.001
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

    def placed_back(self, body: m3.Manifold, turn: int = 0) -> m3.Manifold:
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
        found = None
        for master in range(index):
            if out[master].master != master or not _comparable(centred[master], mesh):
                continue
            turns = rotations_onto(centred[master], mesh, SAME_SHAPE)
            if len(turns):
                found = Likeness(master, turns, out[master].centre, centre)
                break
        if found is None:
            turns = symmetries(mesh, SAME_SHAPE) if _comparable(mesh, mesh) else np.eye(3)[None]
            found = Likeness(index, turns, centre, centre)
        out.append(found)
    return out


def _middle(mesh: Mesh) -> Float[np.ndarray, "3"]:
    """Centroid of the triangles: it needs no inside, and repeated triangles are few."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    weight = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return (weight[:, None] * (a + b + c)).sum(axis=0) / (3.0 * weight.sum())


def _comparable(first: Mesh, second: Mesh) -> bool:
    flat = min(np.linalg.svd(mesh.vertices, compute_uv=False)[2] for mesh in (first, second)) < 1e-4
    return not flat and abs(len(first.faces) - len(second.faces)) <= 0.2 * len(first.faces) <= 0.2 * MAX_FEATURED_FACES


def keep_alike(pieces: list[Piece], alike: Sequence[Likeness], limits: RepairLimits, tidy: float) -> None:
    """Give members of a class the cuts of every member, and each part its cuts in every way that it could be turned.

    In place, where that costs little and parts no contact. Cutting more makes no overlap and holds nothing fast. Faces
    off one plane by less than `tidy` metres are made one.
    """
    for master in range(len(pieces)):
        members = [p for p, like in enumerate(alike) if like.master == master]
        if not any(pieces[p].removed > 0.0 for p in members):
            continue
        *turned, alone = groups(alike[master].turns)
        if len(members) > 1 and not _share_cuts(pieces, alike, members, alone, limits, tidy):
            continue
        any(_share_cuts(pieces, alike, members, turns, limits, tidy) for turns in turned[:MAX_GROUPS])


def _still_alike(bodies: Sequence[m3.Manifold], turns: Float[np.ndarray, "n 3 3"]) -> bool:
    """Whether the first body can be laid onto each of the others, and onto itself in all these ways."""
    centred = []
    for body in bodies:
        skin = to_surface(body)
        mesh = Mesh(skin.vertices, skin.faces)
        centred.append(Mesh(mesh.vertices - mesh.center_of_mass, mesh.faces))
    return all(len(rotations_onto(centred[0], mesh)) for mesh in centred[1:]) and (
        len(turns) == 1 or len(rotations_onto(centred[0], centred[0])) >= len(turns)
    )


def _share_cuts(
    pieces: list[Piece],
    alike: Sequence[Likeness],
    members: list[int],
    turns: Float[np.ndarray, "n 3 3"],
    limits: RepairLimits,
    tidy: float,
) -> bool:
    """Whether all members have, now, one shape that looks the same however it is turned by one of the rotations."""
    master = members[0]
    moved = [pieces[p].moved for p in members]
    unmoved = [pieces[p].body.translate(tuple((-m).tolist())) for p, m in zip(members, moved, strict=True)]
    if _still_alike(unmoved, turns):
        return True
    if len(turns) > 1 and unmoved[0].num_tri() * len(turns) > MAX_TURNED:
        return False
    common, chosen = _common_in_all_turns(unmoved[0], alike[master], turns, tidy), [0]
    whole = pieces[master].whole
    extra = min(body.volume() for body in unmoved) - common.volume()
    if extra > MAX_EXTRA * whole or common.is_empty():
        return False
    if len(turns) > 1 and _depth(Shell(to_surface(unmoved[0])), Shell(to_surface(common))) > MAX_DEPTH:
        return False
    for p, body in zip(members[1:], unmoved[1:], strict=True):
        indices = _distinct_turns(alike[p], turns)
        turned = {
            index: _common_in_all_turns(alike[p].placed_back(body, index), alike[master], turns, tidy)
            for index in indices
        }
        tries = {index: common ^ turned[index] for index in indices}
        best = max(indices, key=lambda index: tries[index].volume())
        # The copies were placed by the first turn, so that it fits exactly; the others do within the tolerance.
        if tries[best].volume() < tries[0].volume() + MIN_TURN_GAIN * pieces[master].whole:
            best = 0
        common = _tidied(tries[best], tidy)
        chosen.append(best)
    common = without_slivers(common)
    extra = min(body.volume() for body in unmoved) - common.volume()
    loses = whole - common.volume()
    if loses > limits.trimmed * whole or extra > MAX_EXTRA * whole:
        return False
    if any(len(common.decompose()) > len(body.decompose()) for body in unmoved):
        return False
    fresh = {
        p: alike[p].placed(common, index).translate(tuple(m.tolist()))
        for p, index, m in zip(members, chosen, moved, strict=True)
    }
    if _harmed(pieces, fresh):
        return False
    shells = {p: Shell(to_surface(body)) for p, body in fresh.items()}
    if len(turns) > 1 and any(_depth(pieces[p].shell, shell) > MAX_DEPTH for p, shell in shells.items()):
        return False
    for p in members:
        for q, other in enumerate(pieces):
            if q == p or pieces[p].shell.box_distance(other.shell) >= CONTACT_DISTANCE:
                continue
            if pieces[p].shell.nearest(other.shell)[0] >= CONTACT_DISTANCE:
                continue
            if shells[p].nearest(shells.get(q, other.shell))[0] >= CONTACT_DISTANCE:
                return False
    for p, body in fresh.items():
        piece = pieces[p]
        if body.volume() < piece.body.volume() * (1.0 - 1e-6):
            piece.notes.append("cut like the parts that are like it" if len(members) > 1 else "cut alike all round")
        piece.removed = max(piece.removed, piece.whole - body.volume())
        piece.become(body)
    return True


def _harmed(pieces: list[Piece], fresh: dict[int, m3.Manifold]) -> bool:
    """Whether new solids of some parts take more of a size, or of a joint's depth, than `MAX_SHORTER`.

    Args:
        pieces: all parts, as they are.
        fresh: what some of them would become, by index.
    """
    now = {piece.name: piece.body for piece in pieces}
    then = {**now, **{pieces[p].name: body for p, body in fresh.items()}}
    for p, piece in enumerate(pieces):
        if p in fresh and piece.shrinkage(fresh[p]) > piece.shrinkage(piece.body) + MAX_SHORTER:
            return True
        for other in piece.depths:
            if then[piece.name] is now[piece.name] and then[other] is now[other]:
                continue
            loss = piece.depth_loss(then[piece.name], other, then[other])
            if loss > max(0.0, piece.depth_loss(now[piece.name], other, now[other])) + MAX_SHORTER:
                return True
    return False


def _distinct_turns(like: Likeness, turns: Float[np.ndarray, "n 3 3"]) -> list[int]:
    """Turns of a part that differ by more than one of the rotations that its master is laid onto itself by."""
    out: list[int] = []
    for index, turn in enumerate(like.turns[:MAX_TURNS]):
        between = [like.turns[other].T @ turn for other in out]
        if not any(np.abs(turns - rotation).max(axis=(1, 2)).min() < SAME_TURN for rotation in between):
            out.append(index)
    return out


def _depth(before: Shell, after: Shell) -> float:
    """Metres that the deepest cut goes below the old surface.

    At corners, and in the middle of edges and triangles: a hole right through has all its corners on the old surface.
    """
    corners = after.surface.corners
    middles = 0.5 * (corners + np.roll(corners, 1, axis=1))
    points = np.concatenate([after.surface.vertices, middles.reshape(-1, 3), corners.mean(axis=1)])
    return max(before.distance_to(point) for point in points)


def _common_in_all_turns(
    body: m3.Manifold, master: Likeness, turns: Float[np.ndarray, "n 3 3"], tidy: float
) -> m3.Manifold:
    """What the master's solid has in common with itself turned about its centre in all these ways."""
    if len(turns) == 1:
        return body
    about = [np.column_stack([turn, master.centre - turn @ master.centre]) for turn in turns[1:]]
    common = m3.Manifold.batch_boolean([body, *(body.transform(pose) for pose in about)], m3.OpType.Intersect)
    return _tidied(common, tidy)


def _tidied(body: m3.Manifold, tidy: float) -> m3.Manifold:
    """The same solid with what is flat made of few triangles.

    Faces that were meant to lie in each other cross again and again, being off by rounding. They are only joined once
    it is forgotten that they come from different solids.
    """
    return body.as_original().simplify(tidy)
