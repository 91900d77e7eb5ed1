"""Triangle surfaces: welding, removal of duplicates, consistent winding, filling of holes."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import manifold3d as m3
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import KDTree

from roboassembly.geometry.triangles import areas, scaled_normals, triple_products
from roboassembly.repair.cached import cached
from roboassembly.repair.edges import half_edges, numbered

WELD_DISTANCE = 2e-5
"""Distance below which vertices are merged [m]."""
MAX_HOLE_BULGE = 0.002
"""Largest distance of a rim from its plane for a flat cap [m]."""
MAX_BENT_RIM = 520
"""Largest number of edges of a bent rim that is filled."""
MAX_PATCHES = 400
"""Largest number of patches that are flipped against one another."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles in metres, not necessarily closed."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]

    @property
    def corners(self) -> Float[np.ndarray, "f 3 3"]:
        """Corners of each triangle [m]."""
        return self.vertices[self.faces]

    @property
    def area(self) -> float:
        """Area [m²]."""
        return float(areas(self.corners).sum())

    @property
    def volume(self) -> float:
        """Signed enclosed volume, valid only for a closed surface with consistent winding [m³]."""
        if not len(self.faces):
            return 0.0
        return float(triple_products(self.corners - self.vertices[self.faces[0, 0]]).sum() / 6.0)

    def flipped(self) -> Surface:
        """Return the same triangles with the opposite winding."""
        return Surface(self.vertices, self.faces[:, ::-1])

    def compact(self) -> Surface:
        """Return the surface without unused vertices."""
        used, faces = np.unique(self.faces, return_inverse=True)
        return Surface(self.vertices[used], faces.reshape(-1, 3))


@dataclass(frozen=True)
class CleaningCount:
    """Numbers of triangles that cleaning removed."""

    duplicates: int
    degenerate: int


def clean(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> tuple[Surface, CleaningCount]:
    """Merge vertices, and drop degenerate triangles and duplicates on the same three vertices."""
    pairs = KDTree(vertices).query_pairs(WELD_DISTANCE, output_type="ndarray")
    n = len(vertices)
    _, label = connected_components(coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (n, n)), False)
    _, first = np.unique(label, return_index=True)
    faces, vertices = label[faces].astype(np.int64), vertices[first]
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = faces[proper]
    _, keep = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    count = CleaningCount(duplicates=len(faces) - len(keep), degenerate=int((~proper).sum()))
    return Surface(vertices, faces[np.sort(keep)]).compact(), count


def patches(surface: Surface) -> list[Surface]:
    """Return the connected pieces after cuts along edges where more than two faces meet."""
    return _pieces(surface, most=2)


def components(surface: Surface) -> list[Surface]:
    """Return the pieces that share no edge with one another, largest area first."""
    return _pieces(surface, most=len(surface.faces))


def _pieces(surface: Surface, most: int) -> list[Surface]:
    """Return the pieces connected by edges with at most `most` faces, largest area first."""
    directed, owner = half_edges(surface.faces)
    edge, count = numbered(directed)
    joins = count[edge] <= most
    f, e = len(surface.faces), len(count)
    graph = coo_matrix((np.ones(int(joins.sum())), (owner[joins], f + edge[joins])), (f + e, f + e))
    label = connected_components(graph, False)[1][:f]
    pieces = [Surface(surface.vertices, surface.faces[label == k]).compact() for k in np.unique(label)]
    return sorted(pieces, key=lambda piece: -piece.area)


def orient(surface: Surface) -> Surface | None:
    """Orient all faces consistently, with as short an open rim as possible; None for a one-sided patch.

    The orientation spreads across edges with exactly two faces. The resulting patches are then flipped against one
    another where more than two faces meet. A one-sided patch is, for example, a Möbius strip.
    """
    faces = surface.faces
    directed, owner = half_edges(faces)
    forward = directed[:, 0] < directed[:, 1]
    edge, count = numbered(directed)
    order = np.argsort(edge, kind="stable")
    pair = order[(count == 2)[edge[order]]].reshape(-1, 2)
    first, second = owner[pair[:, 0]], owner[pair[:, 1]]
    agree = np.where(forward[pair[:, 0]] != forward[pair[:, 1]], 1, -1)
    f = len(faces)
    graph = coo_matrix((np.ones(len(first)), (first, second)), (f, f)).tocsr()
    relation = {}
    for a, b, s in zip(first.tolist(), second.tolist(), agree.tolist(), strict=True):
        relation[a, b] = relation[b, a] = s
    patches, label = connected_components(graph, False)
    sign = np.ones(f, dtype=np.int64)
    for patch in range(patches):
        start = int(np.argmax(label == patch))
        visited, before = breadth_first_order(graph, start, directed=False)
        for face in visited[1:].tolist():
            sign[face] = sign[before[face]] * relation[int(before[face]), face]
    if len(first) and (sign[first] * sign[second] != agree).any():
        return None
    sign *= _patch_signs(surface, directed, forward, owner, edge, count, label, patches, sign)[label]
    wound = np.where(sign[:, None] > 0, faces, faces[:, ::-1])
    return Surface(surface.vertices, wound)


def _patch_signs(
    surface: Surface,
    directed: Int[np.ndarray, "e 2"],
    forward: Bool[np.ndarray, "e"],
    owner: Int[np.ndarray, "e"],
    edge: Int[np.ndarray, "e"],
    count: Int[np.ndarray, "u"],
    label: Int[np.ndarray, "f"],
    patches: int,
    sign: Int[np.ndarray, "f"],
) -> Int[np.ndarray, "p"]:
    """Flip whole patches greedily, largest first, to shorten the open rim at edges of 3 and more faces."""
    out = np.ones(patches, dtype=np.int64)
    if patches == 1 or patches > MAX_PATCHES:
        return out
    length = np.linalg.norm(surface.vertices[directed[:, 0]] - surface.vertices[directed[:, 1]], axis=1)
    busy = np.flatnonzero(count[edge] > 2)
    flow = np.zeros(len(count))
    size = np.bincount(label, minlength=patches)
    value = np.where(forward, 1, -1) * sign[owner]
    mine: defaultdict[int, list[int]] = defaultdict(list)
    for h in busy.tolist():
        mine[int(label[owner[h]])].append(h)
    for sweep in range(4):
        changed = False
        for patch in np.argsort(-size, kind="stable").tolist():
            h = np.array(mine[patch], dtype=np.int64)
            if not len(h):
                continue
            contribution = np.bincount(edge[h], weights=value[h] * out[patch], minlength=len(count))
            touched = np.unique(edge[h])
            weight = np.zeros(len(count))
            weight[edge[h]] = length[h]
            rest = flow - (contribution if sweep else 0)
            keep = (np.abs(rest + contribution) * weight)[touched].sum()
            flip = (np.abs(rest - contribution) * weight)[touched].sum()
            if flip < keep - 1e-12:
                out[patch] *= -1
                contribution = -contribution
                changed = True
            flow = rest + contribution
        if sweep and not changed:
            break
    return out


def rims(surface: Surface) -> list[list[int]]:
    """Return the closed vertex loops of the open rims of an oriented surface, wound as filling faces must be."""
    directed, _ = half_edges(surface.faces)
    balance: dict[tuple[int, int], int] = defaultdict(int)
    for a, b in directed.tolist():
        if a < b:
            balance[a, b] += 1
        else:
            balance[b, a] -= 1
    following: dict[int, list[int]] = defaultdict(list)
    for (a, b), flow in sorted(balance.items()):
        for _ in range(abs(flow)):
            if flow > 0:
                following[b].append(a)
            else:
                following[a].append(b)
    rim_loops: list[list[int]] = []
    for start in sorted(following):
        while following[start]:
            path, place = [start], {start: 0}
            while True:
                here = following[path[-1]].pop()
                if here in place:
                    cut = place[here]
                    rim_loops.append(path[cut:])
                    for vertex in path[cut + 1 :]:
                        del place[vertex]
                    path = path[: cut + 1]
                    if not following[path[-1]]:
                        break
                else:
                    place[here] = len(path)
                    path.append(here)
            if len(path) > 1:  # unreachable on a boundary: every vertex has as many edges in as out
                break
    return rim_loops


def fill_holes(surface: Surface) -> Surface | None:
    """Close an oriented surface; None if a rim is too long and too bent for a reliable cap.

    Rims in one plane are filled together, so that the end of a tube gets a ring. Bent rims of up to `MAX_BENT_RIM`
    edges get the cap of least area.
    """
    v = surface.vertices
    groups: list[tuple[np.ndarray, float, list[list[int]]]] = []
    caps = [surface.faces]
    for loop in rims(surface):
        if len(loop) < 4:
            if len(loop) == 3:
                caps.append(np.array([loop]))
            continue
        points = v[loop]
        centre = points.mean(axis=0)
        _, _, axes = np.linalg.svd(points - centre, full_matrices=False)
        normal = axes[2] if abs(axes[2]).max() == axes[2].max() else -axes[2]
        bulge = float(np.abs((points - centre) @ normal).max())
        thin = float(np.ptp((points - centre) @ axes[1]))
        if bulge > MAX_HOLE_BULGE or thin < MAX_HOLE_BULGE:
            if len(loop) > MAX_BENT_RIM:
                return None
            caps.append(_least_cap(v, loop))
            continue
        height = float(centre @ normal)
        for other_normal, other_height, members in groups:
            if other_normal @ normal > 0.9999 and abs(other_height - height) < 5e-4:
                members.append(loop)
                break
        else:
            groups.append((normal, height, [loop]))
    caps += [_cap(v, normal, members) for normal, _, members in groups]
    return Surface(v, np.concatenate(caps))


def _least_cap(v: Float[np.ndarray, "v 3"], loop: list[int]) -> Int[np.ndarray, "f 3"]:
    """Return triangles that span a bent loop with the least area (dynamic programming over its chords)."""
    p, n = v[loop], len(loop)
    squared = ((p[:, None] - p[None]) ** 2).sum(axis=2)
    cost = np.zeros((n, n))
    split = np.zeros((n, n), dtype=np.int64)
    for reach in range(2, n):
        i = np.arange(n - reach)
        j = i + reach
        m = i[:, None] + np.arange(1, reach)
        side_a, side_b, side_c = squared[i[:, None], m], squared[m, j[:, None]], squared[i, j][:, None]
        # Heron's formula in squared sides.
        area = 0.25 * np.sqrt(np.maximum(4.0 * side_a * side_b - (side_a + side_b - side_c) ** 2, 0.0))
        total = cost[i[:, None], m] + cost[m, j[:, None]] + area
        k = np.argmin(total, axis=1)
        cost[i, j], split[i, j] = total[i, k], m[i, k]
    out: list[tuple[int, int, int]] = []
    stack = [(0, n - 1)]
    while stack:
        i, j = stack.pop()
        if j - i >= 2:
            k = int(split[i, j])
            out.append((loop[i], loop[k], loop[j]))
            stack += [(i, k), (k, j)]
    return np.array(out, dtype=np.int64)


def _cap(
    v: Float[np.ndarray, "v 3"], normal: Float[np.ndarray, "3"], members: list[list[int]]
) -> Int[np.ndarray, "f 3"]:
    """Return triangles that span loops in one plane; the winding distinguishes outer loops from holes."""
    x = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    x /= np.linalg.norm(x)
    y = np.cross(normal, x)
    flat = [np.column_stack([v[loop] @ x, v[loop] @ y]) for loop in members]
    area = sum(0.5 * float(np.sum(p[:, 0] * np.roll(p[:, 1], -1) - p[:, 1] * np.roll(p[:, 0], -1))) for p in flat)
    if area < 0:
        flat = [p * [1.0, -1.0] for p in flat]
    index = np.concatenate([np.asarray(loop) for loop in members])
    return index[np.asarray(m3.triangulate(flat), dtype=np.int64)]


def thicken(sheet: Surface, thickness: float) -> Surface:
    """Return an oriented sheet as a plate, with half of `thickness` on either side [m]."""
    weighted = scaled_normals(sheet.corners)
    normal = np.zeros_like(sheet.vertices)
    for k in range(3):
        np.add.at(normal, sheet.faces[:, k], weighted)
    normal *= 0.5 * thickness / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    n = len(sheet.vertices)
    walls: list[tuple[int, int, int]] = []
    for loop in rims(sheet):
        for p, q in zip(loop, [*loop[1:], loop[0]], strict=True):
            walls += [(p, q, q + n), (p, q + n, p + n)]
    faces = [sheet.faces, sheet.faces[:, ::-1] + n, np.array(walls, dtype=np.int64).reshape(-1, 3)]
    return Surface(np.concatenate([sheet.vertices + normal, sheet.vertices - normal]), np.concatenate(faces))


def sample(surface: Surface, spacing: float, limit: int = 200_000) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices and evenly distributed points on the triangles, and the face of each.

    Args:
        surface: surface to sample.
        spacing: approximate distance between points [m].
        limit: largest number of points on the triangles; a large surface has wider spacing.
    """
    a, b, c = np.swapaxes(surface.corners, 0, 1)
    area = np.cumsum(areas(surface.corners))
    count = int(min(limit, np.ceil(2.0 * area[-1] / spacing**2) + 1))
    k = np.arange(count)
    place: Float[np.ndarray, "n"] = (k + 0.5) / count * area[-1]
    owner = np.minimum(np.searchsorted(area, place), len(area) - 1)
    # The R2 sequence of low discrepancy (plastic number), folded into the triangle.
    u, v = (0.5 + k * 0.7548776662466927) % 1.0, (0.5 + k * 0.5698402909980532) % 1.0
    fold = u + v > 1.0
    u, v = np.where(fold, 1.0 - u, u)[:, None], np.where(fold, 1.0 - v, v)[:, None]
    points = a[owner] + u * (b[owner] - a[owner]) + v * (c[owner] - a[owner])
    first = surface.faces.reshape(-1)
    used, where = np.unique(first, return_index=True)
    return np.concatenate([surface.vertices[used], points]), np.concatenate([where // 3, owner])


def plate(sheet: Surface, thickness: float) -> m3.Manifold:
    """Return a flat sheet as a plate: its outline, with half of `thickness` on either side [m]."""
    centre = sheet.vertices.mean(axis=0)
    axes = np.linalg.svd(sheet.vertices - centre, full_matrices=False)[2]
    axes[2] = np.cross(axes[0], axes[1])
    flat = ((sheet.vertices - centre) @ axes[:2].T)[sheet.faces]
    edge_a, edge_b = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    turned = edge_a[:, 0] * edge_b[:, 1] - edge_a[:, 1] * edge_b[:, 0] < 0
    flat[turned] = flat[turned][:, ::-1]
    outline = m3.CrossSection([np.ascontiguousarray(t) for t in flat], m3.FillRule.NonZero).simplify(WELD_DISTANCE)
    body = m3.Manifold.extrude(outline, thickness).translate((0.0, 0.0, -0.5 * thickness))
    return body.transform(np.column_stack([axes.T, centre]))


def to_manifold(surface: Surface) -> m3.Manifold | None:
    """Return the solid that a surface bounds; None if it is not closed and consistently oriented."""
    if surface.volume < 0:
        surface = surface.flipped()
    surface = _without_opposed(surface).compact()
    directed, _ = half_edges(surface.faces)
    edge, _ = numbered(directed)
    flow = np.bincount(edge, weights=np.where(directed[:, 0] < directed[:, 1], 1.0, -1.0))
    if not len(surface.faces) or flow.any():
        return None
    body = m3.Manifold(
        m3.Mesh64(np.ascontiguousarray(surface.vertices), np.ascontiguousarray(surface.faces.astype(np.uint64)))
    )
    return body if body.status() == m3.Error.NoError and not body.is_empty() else None


def _without_opposed(surface: Surface) -> Surface:
    """Return the surface without triangles back to back on the same three vertices, and without duplicates."""
    faces = surface.faces
    triple, _ = numbered(faces)
    low = np.argmin(faces, axis=1)
    turn = np.take_along_axis(faces, (low[:, None] + np.array([1, 2])) % 3, axis=1)
    sign = np.where(turn[:, 0] < turn[:, 1], 1, -1)
    total = np.bincount(triple, weights=sign)
    first = np.unique(2 * triple + (sign > 0), return_index=True)[1]
    keep = np.sort(first[total[triple[first]] * sign[first] > 0])
    return Surface(surface.vertices, faces[keep])


@cached
def to_surface(body: m3.Manifold) -> Surface:
    """Return the triangles of a solid."""
    mesh = body.to_mesh64()
    return Surface(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts).astype(np.int64))
