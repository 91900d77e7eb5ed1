"""Captions of pictures: words laid out by their measured widths on a dark panel in the upper left corner.

In `step 3 of 14: slat onto post | R_a: lift` the part that moves and the part that waits have the colours that they
have in the picture; what follows the bar goes on a line of its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from roboassembly.rendering.colors import Color, to_bytes

TEXT: Color = (1.0, 1.0, 1.0)
DETAIL: Color = (0.78, 0.81, 0.85)
PANEL: Color = (0.09, 0.11, 0.14)
OPACITY = 0.82
"""Opacity of the panel."""
_MOVING: Color = (1.0, 0.63, 0.25)
_WAITING: Color = (0.47, 0.86, 0.50)
_SHARE = 1 / 26
"""Height of letters over that of the picture."""
_SMALLEST = 7
"""Smallest size of letters [pixels]."""
_TALLEST = 0.45
"""Largest height of a panel over that of the picture."""
_LINE = 1.3
"""Distance between lines, in sizes of letters."""
_ELLIPSIS = "..."


@dataclass(frozen=True)
class Word:
    """A word and the box that it fills, in pixels from the upper left corner of the picture."""

    text: str
    color: Color
    left: float
    top: float
    right: float
    bottom: float


@dataclass(frozen=True)
class CaptionLayout:
    """Words of a caption and the panel behind them."""

    boxes: tuple[Word, ...]
    size: int
    """Size of the letters [pixels]."""
    left: int
    """Left edge of the panel; also its distance from the upper edge of the picture [pixels]."""
    right: int
    bottom: int


@lru_cache(maxsize=256)
def layout_caption(caption: str, width: int, height: int) -> CaptionLayout:
    """Return where the words of a caption go. All stay inside the picture; words that find no room are left out.

    Args:
        caption: text.
        width: width of the picture [pixels].
        height: height of the picture [pixels].
    """
    size = max(_SMALLEST, round(_SHARE * height))
    while True:
        boxes = _lines(caption, width, size)
        edge = _edge(size)
        bottom = boxes[-1].bottom + 0.5 * edge if boxes else 0.0
        if bottom <= max(_TALLEST * height, 2.0 * size) or size <= _SMALLEST:
            break
        size -= 1
    fitting = tuple(word for word in boxes if word.bottom <= height - 1 and word.right <= width - 1)
    right = max((word.right for word in fitting), default=0.0) + 0.7 * edge
    bottom = max((word.bottom for word in fitting), default=0.0) + 0.5 * edge
    return CaptionLayout(fitting, size, edge // 2, min(width - 1, round(right)), min(height - 1, round(bottom)))


def draw_caption(picture: UInt8[np.ndarray, "height width 3"], caption: str) -> None:
    """Draw a caption into a picture, in place; nothing if it is empty."""
    if not caption:
        return
    height, width, _ = picture.shape
    color, opacity, left, top = _panel(caption, width, height)
    rows, columns, _ = color.shape
    under = picture[top : top + rows, left : left + columns]
    under[:] = np.round(color * opacity + under * (1.0 - opacity))


@lru_cache(maxsize=64)
def _panel(
    caption: str, width: int, height: int
) -> tuple[Float[np.ndarray, "rows columns 3"], Float[np.ndarray, "rows columns 1"], int, int]:
    """Return the colours and opacities of a caption's panel, and its left and its upper edge [pixels]."""
    layout = layout_caption(caption, width, height)
    left = top = layout.left
    size = (max(1, layout.right - left), max(1, layout.bottom - top))
    panel = Image.new("RGB", size, to_bytes(PANEL))
    pen = ImageDraw.Draw(panel)
    for word in layout.boxes:
        pen.text((word.left - left, word.top - top), word.text, to_bytes(word.color), _font(layout.size))
    shape = Image.new("L", (4 * size[0], 4 * size[1]), 0)
    corner = (0, 0, 4 * size[0] - 1, 4 * size[1] - 1)
    ImageDraw.Draw(shape).rounded_rectangle(corner, 4 * layout.size // 3, round(255 * OPACITY))
    opacity = np.asarray(shape.resize(size, Image.Resampling.BOX), float)[..., None] / 255.0
    # Letters are opaque.
    ink = (np.abs(np.asarray(panel, float) - to_bytes(PANEL)).max(axis=2, keepdims=True) / 160.0).clip(0.0, 1.0)
    return np.asarray(panel, float), np.maximum(opacity, ink), left, top


def _lines(caption: str, width: int, size: int) -> list[Word]:
    """Return the words, row by row; a word that is wider than the picture is cut."""
    font, edge = _font(size), _edge(size)
    most = width - 2.2 * edge
    space = font.getlength(" ")
    out: list[Word] = []
    top = float(edge)
    for number, line in enumerate(caption.split(" | ")):
        x, top = float(edge), top + (number > 0) * _LINE * size
        for text, color in _colored(line) if number == 0 else ((w, DETAIL) for w in line.split()):
            shown = _cut(text, font, most)
            wide = font.getlength(shown)
            if x > edge and x + wide > edge + most:
                x, top = float(edge), top + _LINE * size
            out.append(Word(shown, color, x, top, x + wide, top + _LINE * size))
            x += wide + space
    return out


def _colored(line: str) -> Iterator[tuple[str, Color]]:
    """Yield the words of a caption's first line with their colours."""
    start, mark, action = line.partition(": ")
    moving, onto, waiting = action.partition(" onto ")
    yield from ((word, TEXT) for word in (start + mark.strip()).split())
    yield from ((word, _MOVING if onto else TEXT) for word in moving.split())
    yield from ((word, TEXT) for word in onto.split())
    yield from ((word, _WAITING) for word in waiting.split())


def _cut(text: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, most: float) -> str:
    if font.getlength(text) <= most:
        return text
    kept = text
    while kept and font.getlength(kept + _ELLIPSIS) > most:
        kept = kept[:-1]
    return kept + _ELLIPSIS if kept else ""


def _edge(size: int) -> int:
    """Return the distance between the edge of the picture and the text [pixels]."""
    return max(2, round(0.9 * size))


@lru_cache(maxsize=16)
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)
