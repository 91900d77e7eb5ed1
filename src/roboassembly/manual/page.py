"""Pages as lists of shapes and texts, which the writers of PDF and HTML share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from roboassembly.manual.line_drawing import Polygon

WIDTH, HEIGHT = 210.0, 297.0
"""Size of a page, A4 [mm]."""
MARGIN = 12.0
"""Width of the empty border of a page [mm]."""
Ink = tuple[float, float, float]
"""Red, green and blue (sRGB), each in `[0, 1]`."""
BLACK: Ink = (0.1, 0.1, 0.1)
GREY: Ink = (0.45, 0.45, 0.45)
WHITE: Ink = (1.0, 1.0, 1.0)
ACCENT: Ink = (0.84, 0.33, 0.02)
"""Colour of arrows."""
_CIRCLE = np.column_stack([np.cos(np.linspace(0, 2 * np.pi, 49)[:-1]), np.sin(np.linspace(0, 2 * np.pi, 49)[:-1])])
_ASCENT, _DESCENT = 0.74, 0.22
"""Height of letters above and below their line, in units of their size."""
MM_PER_POINT = 25.4 / 72.0


@dataclass(frozen=True)
class Box:
    """Rectangle on a page, in millimetres from its lower left corner."""

    left: float
    low: float
    right: float
    high: float

    @property
    def width(self) -> float:
        """Extent to the right [mm]."""
        return self.right - self.left

    @property
    def height(self) -> float:
        """Extent upward [mm]."""
        return self.high - self.low

    @property
    def center(self) -> Float[np.ndarray, "2"]:
        """Middle [mm]."""
        return np.array([0.5 * (self.left + self.right), 0.5 * (self.low + self.high)])

    def overlaps(self, other: Box) -> bool:
        """Whether two boxes share an area."""
        return self.left < other.right and other.left < self.right and self.low < other.high and other.low < self.high

    def contains(self, other: Box) -> bool:
        """Whether another box lies inside."""
        return (
            self.left <= other.left and self.low <= other.low and other.right <= self.right and other.high <= self.high
        )

    def inset(self, by: float) -> Box:
        """Return the box without a border."""
        return Box(self.left + by, self.low + by, self.right - by, self.high - by)


@dataclass(frozen=True, eq=False)
class Outline:
    """Filled or stroked lines."""

    lines: tuple[Polygon, ...]
    fill: Ink | None = None
    stroke: Ink | None = None
    width: float = 0.0
    """Width of the stroke [mm]."""
    closed: bool = True


@dataclass(frozen=True)
class Text:
    """One line of text."""

    x: float
    """Place of its left end, or of its middle if `centered` [mm]."""
    y: float
    """Height of its base line [mm]."""
    text: str
    size: float
    """Size of the letters [points]."""
    bold: bool = False
    centered: bool = False
    ink: Ink = BLACK

    @property
    def box(self) -> Box:
        """Rectangle that it fills."""
        width, size = text_width(self.text, self.size, bold=self.bold), self.size * MM_PER_POINT
        left = self.x - 0.5 * width if self.centered else self.x
        return Box(left, self.y - _DESCENT * size, left + width, self.y + _ASCENT * size)


@dataclass(eq=False)
class Page:
    """One page; shapes are drawn in their order."""

    title: str
    """Words for the page, read by screen readers."""
    items: list[Outline | Text] = field(default_factory=list["Outline | Text"])
    labels: list[Box] = field(default_factory=list[Box])
    """Boxes of all texts and of the circles around them; no two overlap."""

    def path(self, lines: Iterable[Polygon], fill: Ink | None = None, stroke: Ink | None = None, width: float = 0.0,
             closed: bool = True) -> None:  # fmt: skip
        """Add lines; see `Outline`."""
        self.items.append(Outline(tuple(np.asarray(line, float) for line in lines), fill, stroke, width, closed))

    def circle(self, center: Sequence[float] | Float[np.ndarray, "2"], radius: float, fill: Ink | None = None,
               stroke: Ink | None = None, width: float = 0.0) -> None:  # fmt: skip
        """Add a circle; see `Outline`."""
        self.path([np.asarray(center) + radius * _CIRCLE], fill, stroke, width)

    def text(self, x: float, y: float, text: str, size: float, *, bold: bool = False, centered: bool = False,
             ink: Ink = BLACK, label: bool = True) -> Text:  # fmt: skip
        """Add a line of text; `label` says whether its box counts as a label of its own."""
        item = Text(x, y, text, size, bold, centered, ink)
        self.items.append(item)
        if label:
            self.labels.append(item.box)
        return item

    def bubble(self, center: Sequence[float] | Float[np.ndarray, "2"], text: str, *, size: float = 10.0) -> None:
        """Add a text in a white circle or, if it is long, in a white lozenge."""
        box = bubble_box(center, text, size=size)
        radius = 0.5 * box.height
        turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 17)
        arc = radius * np.column_stack([np.cos(turn), np.sin(turn)])
        x, y = box.center
        reach = 0.5 * box.width - radius
        outline = np.concatenate([arc + np.array([x + reach, y]), np.array([x - reach, y]) - arc])
        self.path([outline], fill=WHITE, stroke=BLACK, width=0.3)
        self.text(x, y - 0.36 * size * MM_PER_POINT, text, size, bold=True, centered=True, label=False)
        self.labels.append(box)


def bubble_box(center: Sequence[float] | Float[np.ndarray, "2"], text: str, *, size: float = 10.0) -> Box:
    """Return the rectangle around a text in a bubble."""
    radius = 0.62 * size * MM_PER_POINT + 0.9
    reach = max(radius, 0.5 * text_width(text, size, bold=True) + 1.4)
    x, y = float(center[0]), float(center[1])
    return Box(x - reach, y - radius, x + reach, y + radius)


def printable(text: str) -> str:
    """Return a text with question marks for what the standard fonts of PDF lack."""
    return text.encode("cp1252", "replace").decode("cp1252")


def text_width(text: str, size: float, *, bold: bool = False) -> float:
    """Return the width of a line of text in Helvetica [mm]."""
    from reportlab.pdfbase.pdfmetrics import stringWidth

    return stringWidth(printable(text), "Helvetica-Bold" if bold else "Helvetica", size) * MM_PER_POINT


def shortened(text: str, size: float, width: float, *, bold: bool = False) -> str:
    """Return as much of a text as fits into a width [mm], with an ellipsis if it is cut."""
    if text_width(text, size, bold=bold) <= width:
        return text
    while text and text_width(text + "…", size, bold=bold) > width:
        text = text[:-1]
    return text.rstrip(" _-") + "…"


def wrapped(text: str, size: float, width: float) -> list[str]:
    """Return a text as lines that fit into a width [mm]."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and text_width(longer, size) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines
