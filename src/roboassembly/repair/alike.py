"""Congruent parts: they are made solid alike, and stay alike when they are trimmed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import manifold3d as m3
import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import CONTACT_DISTANCE, RawPart
from roboassembly.furniture.symmetry import rotations_onto, symmetries
from roboassembly.furniture.turns import MAX_TURNS, SAME_TURN, groups
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.triangles import areas
from roboassembly.repair.cached import cached
from roboassembly.repair.limits import RepairLimits
from roboassembly.repair.piece import Piece
from roboassembly.repair.proximity import Shell, shell_of
from roboassembly.repair.surface import to_surface
from roboassembly.repair.trim import without_slivers

SAME_SHAPE = 1e-3
"""Distance between corresponding corners below which parts count as congruent [m]."""
MAX_EXTRA = 0.03
"""Share of its volume that a part may lose to stay congruent, beyond the loss of the most trimmed member."""
MAX_DEPTH = 0.002
"""Largest depth of cuts made for symmetry only; deeper cuts are pockets and shortened ends [m]."""
MAX_GROUPS = 4
"""Number of rotation groups that are tried: as many as a board has."""
MAX_TURNED = 12_000
"""Largest number of triangles times rotations; an intersection of more takes minutes."""
MAX_SHORTER = 0.001
"""Largest loss of a part's size, or of a joint's depth, to cuts that only keep parts congruent [m]."""
MIN_TURN_GAIN = 0.001
"""Share of a part's volume that another rotation must save to be chosen."""
MAX_FEATURED_FACES = 60_000
"""Largest number of triangles of parts that are compared."""


@dataclass(frozen=True, eq=False)
class Likeness:
    """Congruence of a part with an earlier part, its master, or with itself."""

    master: int
    """Index of the master."""
    mesh: Mesh
    """Delivered mesh of this part, its centre at the origin [m]."""
    onto: Float[np.ndarray, "n 3 3"] | None
    """Rotations about the centre that map the master onto this part; None for a master."""
    master_centre: Float[np.ndarray, "3"]
    """Centre of the master [m]."""
    centre: Float[np.ndarray, "3"]
    """Corresponding point of this part [m]."""

    @cached_property
    def turns(self) -> Float[np.ndarray, "n 3 3"]:
        """Rotations about the centre that map the master onto this part."""
        if self.onto is not None:
            return self.onto
        # Symmetries take long to find, and a part that nothing is cut from does not need them.
        return symmetries(self.mesh, SAME_SHAPE) if _comparable(self.mesh, self.mesh) else np.eye(3)[None]

    def _turn(self, index: int) -> Float[np.ndarray, "3 3"]:
        return np.eye(3) if self.onto is None and index == 0 else self.turns[index]

    def placed(self, body: m3.Manifold, turn: int = 0) -> m3.Manifold:
        """Return the master's solid moved to this part's pose."""
        rotation = self._turn(turn)
        shift = self.centre - rotation @ self.master_centre
        return body.transform(np.column_stack([rotation, shift]))

    def placed_back(self, body: m3.Manifold, turn: int = 0) -> m3.Manifold:
        """Return this part's solid moved to the master's pose."""
        rotation = self._turn(turn).T
        return body.transform(np.column_stack([rotation, self.master_centre - rotation @ self.centre]))


def likenesses(parts: Sequence[RawPart]) -> list[Likeness]:
    """Return, for each part, its congruence with the first such part; mirror images are not congruent."""
    out: list[Likeness] = []
    for index, part in enumerate(parts):
        centre = _middle(part.mesh)
        mesh = Mesh(part.mesh.vertices - centre, part.mesh.faces)
        found = Likeness(index, mesh, None, centre, centre)
        for master in range(index):
            if out[master].master != master or not _comparable(out[master].mesh, mesh):
                continue
            turns = rotations_onto(out[master].mesh, mesh, SAME_SHAPE)
            if len(turns):
                found = Likeness(master, mesh, turns, out[master].centre, centre)
                break
        out.append(found)
    return out


def _middle(mesh: Mesh) -> Float[np.ndarray, "3"]:
    """Return the area-weighted centroid of the triangles; the mesh need not be closed."""
    corners = mesh.vertices[mesh.faces]
    weight = areas(corners)
    return (weight[:, None] * corners.sum(axis=1)).sum(axis=0) / (3.0 * weight.sum())


def _comparable(first: Mesh, second: Mesh) -> bool:
    """Return whether two meshes are not flat, and their face counts are similar and not too large."""
    flat = min(np.linalg.svd(mesh.vertices, compute_uv=False)[2] for mesh in (first, second)) < 1e-4
    return not flat and abs(len(first.faces) - len(second.faces)) <= 0.2 * len(first.faces) <= 0.2 * MAX_FEATURED_FACES


def keep_alike(pieces: list[Piece], alike: Sequence[Likeness], limits: RepairLimits, tidy: float) -> None:
    """Give congruent parts each other's cuts, and each part its own cuts in all its symmetric positions.

    The pieces change in place, if that costs little and breaks no contact. More cuts cause no overlap and lock no part
    in place. Faces that lie within `tidy` metres of one plane are merged.
    """
    for master in range(len(pieces)):
        members = [p for p, like in enumerate(alike) if like.master == master]
        if not any(pieces[p].removed > 0.0 for p in members):
            continue
        if len(members) > 1 and not _share_cuts(pieces, alike, members, np.eye(3)[None], limits, tidy):
            continue
        if 2 * pieces[master].body.num_tri() > MAX_TURNED:
            continue
        *turned, _ = groups(alike[master].turns)
        any(_share_cuts(pieces, alike, members, turns, limits, tidy) for turns in turned[:MAX_GROUPS])


def _still_alike(bodies: Sequence[m3.Manifold], turns: Float[np.ndarray, "n 3 3"]) -> bool:
    """Return whether the first body is congruent to all others, and has as many symmetries as there are rotations."""
    return all(_turn_count(bodies[0], body) for body in bodies[1:]) and (
        len(turns) == 1 or _turn_count(bodies[0], bodies[0]) >= len(turns)
    )


@cached
def _turn_count(body: m3.Manifold, other: m3.Manifold) -> int:
    """Return the number of rotations that map a solid onto another."""
    return len(rotations_onto(_centred(body), _centred(other)))


@cached
def _centred(body: m3.Manifold) -> Mesh:
    skin = to_surface(body)
    mesh = Mesh(skin.vertices, skin.faces)
    return Mesh(mesh.vertices - mesh.center_of_mass, mesh.faces)


@cached
def _translated(body: m3.Manifold, shift: tuple[float, ...]) -> m3.Manifold:
    return body.translate(shift)


def _share_cuts(
    pieces: list[Piece],
    alike: Sequence[Likeness],
    members: list[int],
    turns: Float[np.ndarray, "n 3 3"],
    limits: RepairLimits,
    tidy: float,
) -> bool:
    """Give all members one shape with the symmetry of the rotations; return whether they have it now."""
    master = members[0]
    moved = [pieces[p].moved for p in members]
    unmoved = [_translated(pieces[p].body, tuple((-m).tolist())) for p, m in zip(members, moved, strict=True)]
    if _still_alike(unmoved, turns):
        return True
    if len(turns) > 1 and unmoved[0].num_tri() * len(turns) > MAX_TURNED:
        return False
    common, chosen = _common_in_all_turns(unmoved[0], alike[master], turns, tidy), [0]
    whole = pieces[master].whole
    extra = min(body.volume() for body in unmoved) - common.volume()
    if extra > MAX_EXTRA * whole or common.is_empty():
        return False
    if len(turns) > 1 and _depth(shell_of(unmoved[0]), shell_of(common)) > MAX_DEPTH:
        return False
    for p, body in zip(members[1:], unmoved[1:], strict=True):
        indices = _distinct_turns(alike[p], turns)
        turned = {
            index: _common_in_all_turns(alike[p].placed_back(body, index), alike[master], turns, tidy)
            for index in indices
        }
        tries = {index: common ^ turned[index] for index in indices}
        best = max(indices, key=lambda index: tries[index].volume())
        # The first rotation placed the copies and fits exactly; the others fit within the tolerance.
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
    shells = {p: shell_of(body) for p, body in fresh.items()}
    if len(turns) > 1 and any(_depth(pieces[p].shell, shell) > MAX_DEPTH for p, shell in shells.items()):
        return False
    for p in members:
        for q, other in enumerate(pieces):
            if q == p or not pieces[p].shell.is_within(other.shell, CONTACT_DISTANCE):
                continue
            if not shells[p].is_within(shells.get(q, other.shell), CONTACT_DISTANCE):
                return False
    for p, body in fresh.items():
        piece = pieces[p]
        if body.volume() < piece.body.volume() * (1.0 - 1e-6):
            piece.notes.append("cut like the parts that are like it" if len(members) > 1 else "cut alike all round")
        piece.removed = max(piece.removed, piece.whole - body.volume())
        piece.become(body)
    return True


def _harmed(pieces: list[Piece], fresh: dict[int, m3.Manifold]) -> bool:
    """Return whether new solids of some parts reduce a size, or a joint's depth, by more than `MAX_SHORTER`.

    Args:
        pieces: all parts, with their present solids.
        fresh: new solids of some of them, by index.
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
    """Return indices of a part's rotations that are distinct up to the master's symmetries `turns`."""
    out: list[int] = []
    for index, turn in enumerate(like.turns[:MAX_TURNS]):
        between = [like.turns[other].T @ turn for other in out]
        if not any(np.abs(turns - rotation).max(axis=(1, 2)).min() < SAME_TURN for rotation in between):
            out.append(index)
    return out


def _depth(before: Shell, after: Shell) -> float:
    """Return the depth of the deepest cut below the old surface [m].

    The depth is measured at corners and at the centres of edges and triangles, because a through hole has all its
    corners on the old surface.
    """
    corners = after.surface.corners
    middles = 0.5 * (corners + np.roll(corners, 1, axis=1))
    points = np.concatenate([after.surface.vertices, middles.reshape(-1, 3), corners.mean(axis=1)])
    return float(before.distances_to(np.unique(points, axis=0)).max())


def _common_in_all_turns(
    body: m3.Manifold, master: Likeness, turns: Float[np.ndarray, "n 3 3"], tidy: float
) -> m3.Manifold:
    """Return the intersection of the master's solid with its copies rotated about its centre."""
    if len(turns) == 1:
        return body
    about = [np.column_stack([turn, master.centre - turn @ master.centre]) for turn in turns[1:]]
    common = m3.Manifold.batch_boolean([body, *(body.transform(pose) for pose in about)], m3.OpType.Intersect)
    return _tidied(common, tidy)


def _tidied(body: m3.Manifold, tidy: float) -> m3.Manifold:
    """Return the same solid with fewer triangles on flat faces.

    Faces that should coincide intersect many times because of rounding. `as_original` drops the record of the solids
    that they come from; only then does `simplify` merge them.
    """
    return body.as_original().simplify(tidy)
