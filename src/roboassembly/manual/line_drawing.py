"""Line drawings with hidden surfaces removed, as polygons: exact visible regions of the parts in a parallel projection.

Each mesh is cut at its sharp edges into smooth patches. The front of a patch projects to one polygon. Where two of them
overlap, the nearer one hides the other: solids do not penetrate, so that within one connected overlap the order cannot
change. What is left of each polygon is drawn, and its border is a line of the drawing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from manifold3d import CrossSection, FillRule, JoinType, OpType, triangulate
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, transform_points
from roboassembly.manual.surfaces import drawn_surface

Polygon = Float[np.ndarray, "n 2"]
"""Corners of a closed line."""
MILLIMETRES = 1e3
"""Units of a drawing per metre."""
_LEAST_OVERLAP = 1e-4
"""Area below which an overlap is a rounding error [mm²]."""
DETAIL = 0.3
"""Width of what is too thin to be drawn, unless given [mm of the object]."""
_LINES = 0.2
"""Distance by which drawn lines may deviate, as a share of the detail."""
_SPECK = 8.0
"""Size of holes and patches that are left out, as a multiple of the detail."""
_LARGE = 60.0
"""Size of a part in the picture from which its specks are left out, as a multiple of a speck's."""
_FLAT = 1e-6
"""Square of the largest difference of normals in a flat patch."""
_LIGHT = np.array([-0.35, 0.75, 0.56])
"""Direction toward the light: right, up and toward the viewer."""


@dataclass(frozen=True, eq=False)
class Projection:
    """Parallel projection: axes of the picture in the frame of what is drawn."""

    right: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    toward: Float[np.ndarray, "3"]
    """Direction from the object to the viewer."""

    @classmethod
    def looking(cls, toward: Float[np.ndarray, "3"], vertical: Float[np.ndarray, "3"]) -> Projection:
        """Return the camera on the side `toward`, with `vertical` upward in the picture."""
        toward = toward / np.linalg.norm(toward)
        right = np.cross(vertical, toward)
        right /= np.linalg.norm(right)
        return cls(right, np.cross(toward, right), toward)

    def project(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
        """Return points in the picture [mm]."""
        return MILLIMETRES * np.stack([points @ self.right, points @ self.up], axis=-1)


@dataclass(frozen=True, eq=False)
class Figure:
    """Mesh at a place in a drawing."""

    mesh: Mesh
    pose: SE3
    """Pose in the frame of the camera's axes."""
    key: int
    """Number by which the drawing's regions refer to it."""


@dataclass(frozen=True, eq=False)
class Region:
    """Visible part of a patch."""

    key: int
    """Number of the figure."""
    shape: CrossSection
    """Region in the picture [mm]."""
    tone: float
    """Brightness in `[0, 1]`."""


@dataclass(frozen=True, eq=False)
class LineDrawing:
    """Visible regions of a scene."""

    regions: tuple[Region, ...]

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Left, lower, right and upper border [mm]."""
        each = np.array([r.shape.bounds() for r in self.regions])
        low, high = each[:, :2].min(axis=0), each[:, 2:].max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def area(self, key: int) -> float:
        """Return the visible area of a figure [mm²]."""
        return sum(r.shape.area() for r in self.regions if r.key == key)

    def outline(self, key: int) -> CrossSection:
        """Return the visible region of a figure as one."""
        return CrossSection.batch_boolean([r.shape for r in self.regions if r.key == key], OpType.Add)

    def clipped(self, window: CrossSection) -> LineDrawing:
        """Return what lies inside a window."""
        cut = [Region(r.key, r.shape ^ window, r.tone) for r in self.regions]
        return LineDrawing(tuple(r for r in cut if not r.shape.is_empty()))


@dataclass(frozen=True, eq=False)
class _Patch:
    """Front of a smooth patch in the picture."""

    key: int
    convex: bool
    """Whether the figure is convex, so that its patches hide nothing of each other."""
    shape: CrossSection
    box: Float[np.ndarray, "4"]
    corners: Float[np.ndarray, "t 3 2"]
    """Corners of its triangles [mm]."""
    depths: Float[np.ndarray, "t 3"]
    """Distance toward the viewer of these corners [mm]."""
    plane: Float[np.ndarray, "3"] | None
    """The depth as a linear function `(x, y, 1)` of the place in the picture; None of a bent patch."""
    tone: float

    def depth(self, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
        """Return the distance toward the viewer at points in the picture [mm]."""
        if self.plane is not None:
            return points @ self.plane[:2] + self.plane[2]
        a, b, c = (self.corners[:, i] for i in range(3))
        double = _cross(b - a, c - a)
        w_b = _cross(points[:, None] - a, c - a) / double
        w_c = _cross(b - a, points[:, None] - a) / double
        inside = np.minimum(np.minimum(w_b, w_c), 1.0 - w_b - w_c)
        # Overlapping triangles of one patch: the nearest one counts.
        value = self.depths[:, 0] * (1.0 - w_b - w_c) + self.depths[:, 1] * w_b + self.depths[:, 2] * w_c
        hit = np.where(inside > -1e-6, value, -np.inf).max(axis=1)
        nearest = np.take_along_axis(value, inside.argmax(axis=1)[:, None], axis=1)[:, 0]
        return np.where(np.isfinite(hit), hit, nearest)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def draw(figures: Sequence[Figure], camera: Projection, detail: float = DETAIL) -> LineDrawing:
    """Return the visible regions of figures.

    Args:
        figures: what is drawn; they do not penetrate each other.
        camera: the projection.
        detail: width of what is too thin to be drawn [mm of the object].
    """
    patches = [patch for figure in figures for patch in _patches(figure, camera, detail)]
    hidden: list[list[CrossSection]] = [[] for _ in patches]
    if patches:
        boxes = np.array([p.box for p in patches])
        near = np.array([p.depths.max() for p in patches])
        far = np.array([p.depths.min() for p in patches])
        for i, patch in enumerate(patches):
            separate = (boxes[i, :2] >= boxes[i + 1 :, 2:]) | (boxes[i + 1 :, :2] >= boxes[i, 2:])
            for j in (np.flatnonzero(~separate.any(axis=1)) + i + 1).tolist():
                if patch.convex and patch.key == patches[j].key:
                    continue
                if far[i] >= near[j]:
                    hidden[j].append(patch.shape)
                elif far[j] >= near[i]:
                    hidden[i].append(patches[j].shape)
                else:
                    _hide(patches, hidden, i, j)
    regions: list[Region] = []
    for patch, covers in zip(patches, hidden, strict=True):
        shape = CrossSection.batch_boolean([patch.shape, *covers], OpType.Subtract) if covers else patch.shape
        shape = _without_specks(_broad(shape, detail), detail).simplify(_LINES * detail)
        if not shape.is_empty():
            regions.append(Region(patch.key, shape, patch.tone))
    # A region whose specks were filled may cover a small one, which is drawn after it.
    return LineDrawing(tuple(sorted(regions, key=lambda region: -region.shape.area())))


def _without_specks(shape: CrossSection, detail: float) -> CrossSection:
    """Return a region without small holes, such as those of marks in imported meshes."""
    if shape.num_contour() < 2:
        return shape
    lines = shape.to_polygons()
    kept = [line for line in lines if _signed_area(line) > 0 or -_signed_area(line) > (_SPECK * detail) ** 2]
    return shape if len(kept) == len(lines) else CrossSection(kept, FillRule.Positive)


def _signed_area(line: Polygon) -> float:
    return 0.5 * float(_cross(line, np.roll(line, -1, axis=0)).sum())


def _broad(shape: CrossSection, detail: float) -> CrossSection:
    """Return a region without whatever is too thin to be drawn, such as needles that rounding leaves along edges."""
    half = 0.5 * detail
    return shape.offset(-half, JoinType.Miter).offset(half, JoinType.Miter)


def _is_thin(shape: CrossSection, detail: float) -> bool:
    left, low, right, high = shape.bounds()
    return shape.area() < detail * float(np.hypot(right - left, high - low))


def _hide(patches: Sequence[_Patch], hidden: list[list[CrossSection]], i: int, j: int) -> None:
    """Note what two patches hide of each other."""
    overlap = patches[i].shape ^ patches[j].shape
    if overlap.is_empty():
        return
    pieces = overlap.decompose() if overlap.num_contour() > 1 else [overlap]
    pieces = [piece for piece in pieces if piece.area() > _LEAST_OVERLAP]
    if not pieces:
        return
    points = np.array([_inner_point(piece) for piece in pieces])
    front = patches[i].depth(points) > patches[j].depth(points)
    for piece, first in zip(pieces, front.tolist(), strict=True):
        hidden[j if first else i].append(piece)


def _inner_point(shape: CrossSection) -> Float[np.ndarray, "2"]:
    """Return the centroid of the largest triangle of a region."""
    polygons = shape.to_polygons()
    corners = np.concatenate(polygons)[triangulate(polygons)]
    areas = np.abs(_cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    return corners[int(np.argmax(areas))].mean(axis=0)


def _patches(figure: Figure, camera: Projection, detail: float) -> list[_Patch]:
    """Return the patches of a figure that face the viewer."""
    surface = drawn_surface(figure.mesh)
    toward = figure.pose.rotation.T @ camera.toward
    facing = surface.normals @ toward
    front = facing > 1e-4 if surface.closed else np.abs(facing) > 1e-4
    if not front.any():
        return []
    placed = transform_points(figure.pose, surface.vertices)
    flat, depth = camera.project(placed), MILLIMETRES * (placed @ camera.toward)
    links = surface.smooth[front[surface.smooth].all(axis=1)]
    # An open surface shows both of its sides; they are patches of their own.
    links = links[(facing[links] > 0).all(axis=1) | (facing[links] < 0).all(axis=1)]
    count = len(surface.faces)
    graph = coo_array((np.ones(len(links), bool), (links[:, 0], links[:, 1])), shape=(count, count))
    labels = connected_components(graph, directed=False)[1]
    shown = np.flatnonzero(front)
    shown = shown[np.argsort(labels[shown], kind="stable")]
    groups = np.split(shown, np.flatnonzero(np.diff(labels[shown])) + 1)
    width, height = np.ptp(flat, axis=0).tolist()
    # Marks are left out of all but small parts.
    least = detail**2 * (_SPECK**2 if width * height > _LARGE * (_SPECK * detail) ** 2 else 1.0)
    out: list[_Patch] = []
    light = np.column_stack([camera.right, camera.up, camera.toward]) @ (_LIGHT / np.linalg.norm(_LIGHT))
    for group in groups:
        faces = surface.faces[group]
        if not surface.closed:
            faces = np.where((facing[group] < 0)[:, None], faces[:, ::-1], faces)
        corners = flat[faces]
        areas = 0.5 * _cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        if areas.sum() < least:
            continue
        shape = CrossSection([flat[loop] for loop in _border_lines(faces)], FillRule.Positive)
        if shape.is_empty() or _is_thin(shape, detail):
            continue
        normal = figure.pose.rotation @ (areas @ surface.normals[group]) / areas.sum()
        solid = areas > 1e-9
        out.append(
            _Patch(
                figure.key,
                surface.convex,
                shape,
                np.array(shape.bounds()),
                corners[solid],
                depth[faces][solid],
                _plane(surface.normals[group], corners[solid], depth[faces][solid]),
                min(1.0, max(0.0, float(normal @ light))),
            )
        )
    return out


def _plane(
    normals: Float[np.ndarray, "t 3"], corners: Float[np.ndarray, "t 3 2"], depths: Float[np.ndarray, "t 3"]
) -> Float[np.ndarray, "3"] | None:
    """Return the depth of a flat patch as a linear function of the place; None if the patch is bent."""
    if ((normals - normals[0]) ** 2).sum(axis=1).max() > _FLAT:
        return None
    largest = int(np.argmax(np.abs(_cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))))
    matrix: Float[np.ndarray, "3 3"] = np.column_stack([corners[largest], np.ones(3)])
    return np.linalg.inv(matrix) @ depths[largest]


def _border_lines(faces: Int[np.ndarray, "t 3"]) -> list[list[int]]:
    """Return the closed border lines of a set of triangles, as vertex indices, in the triangles' own sense."""
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    size = int(faces.max()) + 1
    low, high = directed.min(axis=1), directed.max(axis=1)
    # Thin triangles that were left out make edges of more than two faces: what counts is the sum of the directions.
    edges, which = np.unique(low * size + high, return_inverse=True)
    net = np.bincount(which, weights=np.where(directed[:, 0] == low, 1, -1)).round().astype(int)
    ends = np.column_stack([edges // size, edges % size])
    border = np.concatenate([np.repeat(ends, np.maximum(net, 0), axis=0),
                             np.repeat(ends[:, ::-1], np.maximum(-net, 0), axis=0)])  # fmt: skip
    after: dict[int, list[int]] = {}
    for start, end in border.tolist():
        after.setdefault(start, []).append(end)
    out: list[list[int]] = []
    while after:
        start = next(iter(after))
        loop, at = [start], start
        while at in after:
            ends = after[at]
            following = ends.pop()
            if not ends:
                del after[at]
            at = following
            if at == start:
                break
            loop.append(at)
        if len(loop) > 2:
            out.append(loop)
    return out
