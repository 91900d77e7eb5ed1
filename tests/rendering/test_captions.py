"""Captions: every word inside the picture, none upon another."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from roboassembly.rendering.captions import DETAIL, TEXT, draw_caption, layout_caption

LONG = "step 12 of 14: " + " ".join(f"part_{k}" for k in range(9)) + " onto the_other_part_with_a_name_that_never_ends"
CAPTIONS = [
    "ladder-0: 15 parts",
    "step 3 of 8: stretcher_left onto leg_back_left (+3) | R_a: drive to mate",
    LONG + " | R_b: carry",
    "a name that is " + "x" * 300,
    "wardrobe: not assembled, stopped after 3 of 19 steps",
]


@pytest.mark.parametrize("caption", CAPTIONS)
@pytest.mark.parametrize(("width", "height"), [(1280, 720), (960, 540), (640, 360), (200, 150), (90, 160)])
def test_words_are_inside_and_apart(caption: str, width: int, height: int) -> None:
    layout = layout_caption(caption, width, height)
    assert 0 < layout.left < layout.right < width
    assert layout.left < layout.bottom < height
    for word in layout.boxes:
        assert layout.left < word.left <= word.right < layout.right
        assert layout.left < word.top < word.bottom < layout.bottom
    for a, b in itertools.combinations(layout.boxes, 2):
        beside = a.right <= b.left or b.right <= a.left
        above = a.bottom <= b.top + 1e-6 or b.bottom <= a.top + 1e-6
        assert beside or above, (a, b)


def test_usual_captions_are_whole_and_colored() -> None:
    layout = layout_caption(CAPTIONS[1], 1280, 720)
    assert " ".join(word.text for word in layout.boxes) == CAPTIONS[1].replace(" | ", " ")
    assert layout.size == 28
    color = {word.text: word.color for word in layout.boxes}
    assert color["step"] == color["onto"] == TEXT
    assert color["drive"] == DETAIL
    moving, waiting = color["stretcher_left"], color["leg_back_left"]
    assert moving[0] > 1.5 * moving[2], "orange as the part that moves"
    assert waiting[1] > 1.5 * waiting[2], "green as the part that waits"
    top = {word.top for word in layout.boxes}
    assert len(top) == 2, "what the robot does has a line of its own"


def test_a_caption_is_drawn_on_its_panel_alone() -> None:
    picture = np.full((360, 640, 3), 200, np.uint8)
    draw_caption(picture, CAPTIONS[0])
    layout = layout_caption(CAPTIONS[0], 640, 360)
    rows, columns = np.nonzero((picture != 200).any(axis=2))
    assert (rows.min(), columns.min()) >= (layout.left, layout.left)
    assert (rows.max(), columns.max()) <= (layout.bottom, layout.right)
    # Ink does not reach the borders of the panel.
    bright = np.argwhere(picture.min(axis=2) > 220)
    assert len(bright) > 100
    assert (bright.min(axis=0) > layout.left + 2).all()
    assert (bright.max(axis=0) < np.array([layout.bottom, layout.right]) - 2).all()
