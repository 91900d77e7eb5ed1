"""Trimming: remove from a solid what a neighbour, grown by the gap, covers, and measure the harm."""

from __future__ import annotations

from dataclasses import dataclass

import manifold3d as m3
import numpy as np
from jaxtyping import Float

from roboassembly.geometry.triangles import scaled_normals, unit_normals
from roboassembly.repair.cached import cached
from roboassembly.repair.proximity import shell_of
from roboassembly.repair.surface import Surface, to_manifold, to_surface

SLIVER = 0.002
"""Share of the part's volume below which a piece that is cut off is dropped."""
OUTLYING = 0.001
"""Distance that a small piece sticks out of the box around the others, above which it is an end of the part [m]."""
BLOCKED = 0.01
"""Share of blocking walls in the contact surface, projected along a direction, below which the direction is free.

The rim that the gap adds around a flat face stays below it; a pocket 1 mm deep exceeds it.
"""
TIDY = 1e-5
"""Tolerance to which triangles are merged after a cut [m]."""

RECESS_MARGIN = 0.004
"""Margin around the contact in which the cutter's recess is found [m]."""
RECESS_CONTACT = 0.003
"""Largest distance of the two after a flush cut; they still count as connected [m]."""


def _directions(count: int) -> Float[np.ndarray, "d 3"]:
    k = np.arange(count)
    z = 1.0 - (2.0 * k + 1.0) / count
    turn = k * np.pi * (3.0 - np.sqrt(5.0))
    r = np.sqrt(1.0 - z * z)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), z])


DIRECTIONS = _directions(300)
"""Unit vectors, evenly distributed on the sphere."""
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)


@cached
def inflate(body: m3.Manifold, amount: float) -> m3.Manifold:
    """Return the solid with every face moved outward by `amount` metres; edges and corners stay sharp."""
    grown = _offset(body, amount)
    return body if grown is None else grown + body


def deflate(body: m3.Manifold, amount: float) -> m3.Manifold:
    """Return the solid with every face moved inward by `amount` metres; edges and corners stay sharp.

    A solid of which nothing would be left stays as it is.
    """
    shrunk = _offset(body, -amount)
    rest = body if shrunk is None else shrunk ^ body
    return body if rest.is_empty() else rest


def _offset(body: m3.Manifold, amount: float) -> m3.Manifold | None:
    """Return the solid with every face moved outward by `amount` metres; None if the faces then enclose nothing."""
    skin = to_surface(body)
    normal = scaled_normals(skin.corners)
    size = np.linalg.norm(normal, axis=1)
    has_area = size > 1e-12
    normal = normal[has_area] / size[has_area, None]
    faces, corners = skin.faces[has_area], skin.corners[has_area]
    n = len(skin.vertices)
    matrix, right = np.zeros((n, 3, 3)), np.zeros((n, 3))
    for k in range(3):
        edge_a, edge_b = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        weight = np.arctan2(np.linalg.norm(np.cross(edge_a, edge_b), axis=1), np.einsum("ij,ij->i", edge_a, edge_b))
        np.add.at(matrix, faces[:, k], weight[:, None, None] * normal[:, :, None] * normal[:, None, :])
        np.add.at(right, faces[:, k], weight[:, None] * normal)
    values, axes = np.linalg.eigh(matrix)
    keep = values > 0.01 * np.maximum(values[:, -1:], 1e-30)
    along = np.einsum("nij,ni->nj", axes, right)
    move = np.einsum("nij,nj->ni", axes, np.where(keep, along / np.where(keep, values, 1.0), 0.0))
    least = np.ones(n)
    for k in range(3):
        np.minimum.at(least, faces[:, k], np.einsum("ij,ij->i", normal, move[faces[:, k]]))
    move *= (amount / np.clip(least, 0.5, 1.0))[:, None]
    length = np.linalg.norm(move, axis=1, keepdims=True)
    move *= np.minimum(1.0, 4.0 * abs(amount) / np.maximum(length, 1e-30))
    return to_manifold(Surface(skin.vertices + move, skin.faces))


def near(body: m3.Manifold, other: m3.Manifold, margin: float) -> m3.Manifold:
    """Return the part of `body` inside the other's box, widened by `margin` metres."""
    return _cropped(body, tuple(other.bounding_box()), margin)


@cached
def _cropped(body: m3.Manifold, box: tuple[float, ...], margin: float) -> m3.Manifold:
    low, high = np.reshape(box, (2, 3))
    size = high - low + 2.0 * margin
    return body ^ m3.Manifold.cube(tuple(size)).translate(tuple(low - margin))


@dataclass(frozen=True, eq=False)
class Cut:
    """Cut that makes two solids clear each other."""

    body: m3.Manifold
    """Solid that is left of the trimmed one."""
    removed: float
    """Removed volume [m³]."""
    freedom: float
    """Share of all directions in which the cutter can leave the cut: 0.5 at a flat face, 0 if it is trapped."""
    dropped: int
    """Number of slivers that were dropped."""
    splits: bool
    """Whether the cut splits the solid into several sizeable pieces."""


@cached
def cut(body: m3.Manifold, cutter: m3.Manifold, gap: float) -> Cut:
    """Remove from `body` what `cutter`, grown by `gap` metres, covers."""
    return cut_with(body, inflate(near(cutter, body, 20.0 * gap), gap), cutter, gap)


def cut_with(body: m3.Manifold, tool: m3.Manifold, other: m3.Manifold, gap: float) -> Cut:
    """Remove from `body` what `tool` covers, and what is closer to `other` than `gap` [m]."""
    tool = tool.as_original()
    freedom = _freedom(tool, body)
    before = len(_sizeable(body)[0])
    rest = _widen((body - tool).simplify(TIDY), other, gap)
    return _finish(body, rest, freedom, before)


def cut_off(body: m3.Manifold, tool: m3.Manifold) -> Cut:
    """Remove from `body` exactly what `tool` covers; the freedom is not measured and is 0.5."""
    return _finish(body, (body - tool).simplify(TIDY), 0.5, len(_sizeable(body)[0]))


def without_slivers(body: m3.Manifold) -> m3.Manifold:
    """Return the solid without slivers."""
    pieces, slivers = _sizeable(body)
    return m3.Manifold.compose(pieces) if slivers and pieces else body


def _finish(body: m3.Manifold, rest: m3.Manifold, freedom: float, before: int) -> Cut:
    pieces, slivers = _sizeable(rest, body.volume())
    if slivers and pieces:
        rest = pieces[0] if len(pieces) == 1 else m3.Manifold.compose(pieces)
    return Cut(rest, body.volume() - rest.volume(), freedom, slivers, len(pieces) > max(1, before))


def _widen(rest: m3.Manifold, cutter: m3.Manifold, gap: float) -> m3.Manifold:
    """Cut again, triangle by triangle, where the rest is still closer to the cutter than the gap."""
    shell = shell_of(cutter)
    for grow in (1.0, 1.15):
        if rest.is_empty():
            return rest
        close = shell.triangles_near(shell_of(rest), 0.6 * gap)
        if not len(close):
            return rest
        offsets = (2.0 * _CORNERS - 1.0) * gap * grow
        prisms = [m3.Manifold.hull_points((t[:, None] + offsets).reshape(-1, 3)) for t in shell.surface.corners[close]]
        rest = (rest - m3.Manifold.batch_boolean(prisms, m3.OpType.Add)).simplify(TIDY)
    return rest


def flush_cut(body: m3.Manifold, cutter: m3.Manifold, gap: float) -> Cut | None:
    """Cut as if the cutter's own recess for the body were filled, for a pin with an existing hole.

    Returns None if the two would lose contact.
    """
    meeting = inflate(near(cutter, body, 20.0 * gap), gap) ^ body
    if meeting.is_empty():
        return None
    filled = near(cutter, meeting, RECESS_MARGIN).hull()
    made = cut(body, filled, gap)
    if made.body.is_empty() or shell_of(made.body).nearest(shell_of(cutter))[0] > RECESS_CONTACT:
        return None
    return made


def plane_cut(body: m3.Manifold, other: m3.Manifold, gap: float) -> list[Cut]:
    """Return cuts by planes that clear the other solid near the overlap, for shallow overlaps."""
    tool = inflate(near(other, body, 20.0 * gap), gap).as_original()
    normals, areas = _facing(tool, body)
    mean = (normals * areas[:, None]).sum(axis=0)
    candidates = [mean] if np.linalg.norm(mean) > 1e-12 else []
    candidates += [np.eye(3)[int(np.argmax(np.abs(mean)))] * np.sign(mean[int(np.argmax(np.abs(mean)))] or 1.0)]
    out: list[Cut] = []
    overlap = (tool ^ body).bounding_box()
    low, high = np.reshape(overlap, (2, 3))
    before = len(_sizeable(body)[0])
    for direction in candidates:
        direction = direction / np.linalg.norm(direction)
        # The tool inside the box of the overlap must stay below the plane along the direction.
        box = m3.Manifold.cube(tuple(high - low + 4 * gap)).translate(tuple(low - 2 * gap))
        inside = to_surface(tool ^ box).vertices
        if not len(inside):
            continue
        height = float((inside @ direction).max())
        slab = box.trim_by_plane(tuple(-direction), -height).as_original()
        rest = _widen((body - slab).simplify(TIDY), other, gap)
        out.append(_finish(body, rest, _freedom(slab, body), before))
    return out


@cached
def _sizeable(body: m3.Manifold, whole: float | None = None) -> tuple[list[m3.Manifold], int]:
    """Return the sizeable pieces, and the number of slivers: small pieces inside the box around the others.

    Args:
        body: solid of one or several pieces.
        whole: volume of the part; that of `body` if None [m³].
    """
    pieces = body.decompose()
    least = SLIVER * (body.volume() if whole is None else whole)
    kept = [piece for piece in pieces if piece.volume() >= least]
    if 0 < len(kept) < len(pieces):
        boxes = np.array([piece.bounding_box() for piece in kept])
        low, high = boxes[:, :3].min(axis=0) - OUTLYING, boxes[:, 3:].max(axis=0) + OUTLYING
        small = [(piece, np.array(piece.bounding_box())) for piece in pieces if piece.volume() < least]
        kept += [piece for piece, box in small if (box[:3] < low).any() or (box[3:] > high).any()]
    return kept, len(pieces) - len(kept)


def _facing(tool: m3.Manifold, body: m3.Manifold) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n"]]:
    """Return the outward unit normals and the areas of the tool's faces inside the body [m²]."""
    mesh = (tool ^ body).to_mesh64()
    faces, vertices = np.array(mesh.tri_verts).astype(np.int64), np.array(mesh.vert_properties[:, :3])
    runs, ids = np.array(mesh.run_index).astype(np.int64) // 3, mesh.run_original_id
    mine = np.zeros(len(faces), dtype=bool)
    for start, stop, owner in zip(runs[:-1], runs[1:], ids, strict=True):
        mine[start:stop] = owner == tool.original_id()
    return unit_normals(vertices[faces[mine]])


def _freedom(tool: m3.Manifold, body: m3.Manifold) -> float:
    normals, areas = _facing(tool, body)
    if not areas.sum() > 0:
        return 0.5
    largest = normals[np.argsort(-areas, kind="stable")[:12]]
    directions = np.concatenate([DIRECTIONS, -largest])
    blocked = np.maximum(directions @ normals.T, 0.0) @ areas / areas.sum()
    free = blocked < BLOCKED
    return float(max(free[: len(DIRECTIONS)].mean(), 0.003 * bool(free.any())))
