"""Pictures on a page: line drawings scaled into boxes, arrows, bubbles, enlarged joints."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from manifold3d import CrossSection, OpType

from roboassembly.geometry.poses import transform_points
from roboassembly.manual.line_drawing import MILLIMETRES, Figure, LineDrawing, Projection, draw
from roboassembly.manual.page import ACCENT, BLACK, WHITE, Box, Ink, Page, bubble_box

_THIN, _THICK = 0.12, 0.3
"""Widths of the lines inside a part and around it [mm]."""
_BROAD, _THINNEST = 2.5, 0.3
"""Width of a part from which its lines are as wide as that [mm], and least factor on the lines of thinner ones."""
_LINED = 0.8
"""Factor from which a part has lines inside, too."""
_FINEST = 0.12
"""Width on the page of what is too thin to be drawn [mm]."""
_BASE: tuple[Ink, Ink] = ((0.80, 0.81, 0.82), (0.985, 0.985, 0.985))
"""Darkest and lightest colour of parts that are there."""
_COMING: tuple[Ink, Ink] = ((0.93, 0.52, 0.16), (1.0, 0.83, 0.58))
"""The same of parts that come."""
_BASE_LINE: Ink = (0.42, 0.43, 0.45)
_LEAST_KINK = 5.0
"""Length of the last edge of a bent arrow at least [mm]."""
_SHAFT, _HEAD, _LEAST_ARROW = 0.9, 1.9, 7.0
"""Half the widths of an arrow's shaft and head, and its least length [mm]."""
_RADII = (0.0, 8.0, 11.0, 14.0, 18.0, 23.0, 29.0, 36.0, 45.0, 60.0)
_ANGLES = np.deg2rad(np.arange(0.0, 360.0, 15.0))


@dataclass(frozen=True, eq=False)
class Placement:
    """Line drawing at its place on a page."""

    drawing: LineDrawing
    camera: Projection
    scale: float
    """Millimetres on the page per millimetre of the object."""
    shift: Float[np.ndarray, "2"]
    """Place of the object's origin on the page [mm]."""

    def at(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
        """Return the places of points on the page [mm]."""
        return self.scale * self.camera.project(points) + self.shift

    def on_page(self, shape: CrossSection) -> CrossSection:
        """Return a region of the drawing on the page."""
        return shape.scale((self.scale, self.scale)).translate(tuple(self.shift.tolist()))

    @cached_property
    def covered(self) -> CrossSection:
        """Region of the page that the drawing covers."""
        return self.on_page(CrossSection.batch_boolean([r.shape for r in self.drawing.regions], OpType.Add))


def bounds_of(figures: Sequence[Figure], camera: Projection) -> Float[np.ndarray, "2 2"]:
    """Return the lower left and upper right corner of figures in a picture [mm of the object]."""
    points = np.concatenate([camera.project(transform_points(f.pose, f.mesh.hull_vertices)) for f in figures])
    return np.array([points.min(axis=0), points.max(axis=0)])


def place(figures: Sequence[Figure], camera: Projection, box: Box, *, largest: float = 0.5) -> Placement:
    """Return a drawing of figures that fills a box.

    Args:
        figures: what is drawn.
        camera: the projection.
        box: where it is drawn.
        largest: scale that small things are not enlarged beyond.
    """
    low, high = bounds_of(figures, camera)
    extent = np.maximum(high - low, 1e-6)
    scale = float(min(box.width / extent[0], box.height / extent[1], largest))
    return Placement(draw(figures, camera, _FINEST / scale), camera, scale, box.center - scale * 0.5 * (low + high))


def ink(shades: tuple[Ink, Ink], tone: float) -> Ink:
    """Return the colour of a brightness between two shades."""
    dark, light = (np.array(shade) for shade in shades)
    r, g, b = (dark + tone * (light - dark)).tolist()
    return r, g, b


def add_drawing(
    page: Page, placed: Placement, coming: Collection[int] = (), *, plain: bool = False, lines: float = 1.0
) -> None:
    """Draw a placed drawing: parts that come in colour, all others in light grey.

    Args:
        page: where it is drawn.
        placed: the drawing.
        coming: keys of the parts in colour.
        plain: whether parts that are there have black lines, in pictures where nothing comes.
        lines: factor on the widths of the lines.
    """
    moves = set(coming)
    keys = sorted({r.key for r in placed.drawing.regions}, key=lambda key: key in moves)
    outlines = {key: placed.on_page(placed.drawing.outline(key)) for key in keys}
    finer = {key: min(1.0, max(_THINNEST, _breadth(outline) / _BROAD)) for key, outline in outlines.items()}
    for region in placed.drawing.regions:
        fill = ink(_COMING if region.key in moves else _BASE, region.tone)
        line = BLACK if plain or region.key in moves else _BASE_LINE
        # The sides of a thin part differ by their shades; lines between them would fill it.
        thin = finer[region.key]
        stroke = line if thin >= _LINED else None
        page.path(placed.on_page(region.shape).to_polygons(), fill=fill, stroke=stroke, width=lines * thin * _THIN)
    for key, outline in outlines.items():
        line = BLACK if plain or key in moves else _BASE_LINE
        width = lines * finer[key] * (_THICK if plain or key in moves else 0.7 * _THICK)
        page.path(outline.to_polygons(), stroke=line, width=width)


def _breadth(shape: CrossSection) -> float:
    """Return the mean width of a region, about [mm]."""
    left, low, right, high = shape.bounds()
    return shape.area() / max(float(np.hypot(right - left, high - low)), 1e-9)


def add_arrow(page: Page, points: Float[np.ndarray, "n 2"], size: float = 1.0) -> Box:
    """Draw an arrow through points; a short one begins farther off. Returns its box."""
    shaft, broad = size * _SHAFT, size * _HEAD
    points = np.asarray(points, float)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    points = points[np.concatenate([[True], steps > 0.05])]
    while len(points) > 2 and float(np.linalg.norm(points[-1] - points[-2])) < _LEAST_KINK:
        points = np.delete(points, -2, axis=0)
    if len(points) < 2:
        points = np.array([points[0] + [0.0, _LEAST_ARROW], points[0]])
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    if length < _LEAST_ARROW:
        back = points[0] - points[1]
        points = np.vstack([points[0] + (_LEAST_ARROW - length) * back / np.linalg.norm(back), points[1:]])
    tip, before = points[-1], points[-2]
    along = (tip - before) / np.linalg.norm(tip - before)
    aside = np.array([-along[1], along[0]])
    neck = tip - 2.2 * broad * along
    body = np.vstack([points[:-1], neck]) if len(points) > 2 or float((neck - points[0]) @ along) > 0 else None
    head = np.array([tip, neck + broad * aside, neck - broad * aside])
    if body is not None:
        page.path([body], stroke=WHITE, width=2 * shaft + 0.7, closed=False)
    page.path([head], fill=ACCENT, stroke=WHITE, width=0.7)
    if body is not None:
        page.path([body], stroke=ACCENT, width=2 * shaft, closed=False)
    page.path([head], fill=ACCENT)
    corners = np.vstack([points, head])
    low, high = corners.min(axis=0), corners.max(axis=0)
    return Box(float(low[0]), float(low[1]), float(high[0]), float(high[1]))


def add_label(
    page: Page, text: str, anchor: Float[np.ndarray, "2"], area: Box, covered: CrossSection, arrows: Sequence[Box],
    size: float = 10.0,
) -> None:  # fmt: skip
    """Add a bubble with a line to a point of the drawing, where it hides no other label and little of the drawing.

    Args:
        page: where it is drawn.
        text: words in the bubble.
        anchor: point that it names [mm].
        area: rectangle in which it must lie.
        covered: region of the drawing.
        arrows: boxes of arrows, which it should not hide.
        size: size of the letters [points].
    """

    def cost(center: Float[np.ndarray, "2"]) -> float:
        box = bubble_box(center, text, size=size)
        if not area.contains(box) or any(box.overlaps(other) for other in page.labels):
            return np.inf
        square = CrossSection.square((box.width, box.height)).translate((box.left, box.low))
        hidden = (square ^ covered).area() / (box.width * box.height)
        return float(np.linalg.norm(center - anchor)) + 22.0 * hidden + 12.0 * sum(box.overlaps(a) for a in arrows)

    around = [anchor + r * np.array([np.cos(a), np.sin(a)]) for r in _RADII for a in (_ANGLES if r else _ANGLES[:1])]
    grid = [
        np.array([x, y]) for x in np.arange(area.left, area.right, 4.0) for y in np.arange(area.low, area.high, 4.0)
    ]
    best, spot = np.inf, anchor
    for candidate in (*around, *grid):
        # The grid is farther off than most of what is around, and only needed where that is taken.
        if float(np.linalg.norm(candidate - anchor)) < best and (value := cost(candidate)) < best:
            best, spot = value, candidate
    if not np.isfinite(best):
        return
    if float(np.linalg.norm(spot - anchor)) > 4.0:
        page.path([np.array([spot, anchor])], stroke=BLACK, width=0.2, closed=False)
        page.circle(anchor, 0.5, fill=BLACK)
    page.bubble(spot, text, size=size)


def inner_spot(shape: CrossSection) -> Float[np.ndarray, "2"]:
    """Return a point well inside of a region."""
    deep = shape
    left, low, right, high = shape.bounds()
    step = 0.25 * min(right - left, high - low)
    while step > 0.05:
        smaller = deep.offset(-step)
        if smaller.is_empty():
            step *= 0.5
        else:
            deep = smaller
    longest = max(deep.to_polygons(), key=len)
    return np.asarray(longest, float).mean(axis=0) if len(deep.to_polygons()) == 1 else np.asarray(longest[0], float)


def add_detail(
    page: Page, figures: Sequence[Figure], camera: Projection, middle: Float[np.ndarray, "2"], radius: float, box: Box,
    coming: Collection[int],
) -> Placement:  # fmt: skip
    """Draw an enlarged round part of a picture.

    Args:
        page: where it is drawn.
        figures: what is drawn.
        camera: the projection.
        middle: middle of the round part in the picture [mm of the object].
        radius: its radius [mm of the object].
        box: where it is drawn.
        coming: keys of the parts in colour.
    """
    on_page = 0.5 * min(box.width, box.height)
    scale = on_page / radius
    near: list[Figure] = []
    for figure in figures:
        low, high = bounds_of([figure], camera)
        if (low < middle + radius).all() and (high > middle - radius).all():
            near.append(figure)
    window = CrossSection.circle(radius, 64).translate(tuple(middle.tolist()))
    placed = Placement(draw(near, camera, _FINEST / scale).clipped(window), camera, scale, box.center - scale * middle)
    page.circle(box.center, on_page, fill=WHITE)
    add_drawing(page, placed, coming)
    page.circle(box.center, on_page, stroke=BLACK, width=0.5)
    return placed


def extent_of(points: Float[np.ndarray, "n 3"]) -> float:
    """Return the size of what some points span [mm]."""
    return MILLIMETRES * float(np.linalg.norm(np.ptp(points, axis=0)))
