"""Pages of a manual: cover, list of parts, steps, and a last page on helping hands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roboassembly.manual.arrangement import UPRIGHT
from roboassembly.manual.helpers import helps
from roboassembly.manual.line_drawing import Figure
from roboassembly.manual.merge_tree import Parts
from roboassembly.manual.page import ACCENT, GREY, HEIGHT, MARGIN, WIDTH, Box, Page, shortened, wrapped
from roboassembly.manual.part_list import PartKind, kind_figure, part_kinds
from roboassembly.manual.pictures import add_drawing, place
from roboassembly.manual.step_page import StepView, draw_people, draw_step, draw_turned, viewed_steps
from roboassembly.manual.steps import Manual
from roboassembly.manual.viewpoints import best_camera

_GRIDS = ((2, 3), (3, 4), (4, 5))
"""Kinds of parts beside and above each other on a page; the first grid that holds them all is taken, or the last."""
_HEADER = 10.0
"""Height of the line with the name of the piece, and of that with the number of the page [mm]."""
_GAP = 5.0
"""Distance between panels [mm]."""
_ROWS_OF_STEPS = 2
_LINE = 5.2
"""Distance between lines of text [mm]."""


def pages_of(manual: Manual, on_plan: str = "") -> list[Page]:
    """Return the pages of a manual.

    Args:
        manual: its steps.
        on_plan: paragraph on the plan, for the last page.
    """
    part_list = part_kinds(manual.furniture)
    letters = {p: kind.letter for kind in part_list for p in kind.members}
    helping = helps(manual)
    double = {h.step: frozenset[int]() for h in helping}
    for h in helping:
        double[h.step] |= h.parts_held
    pages = [_cover(manual), *_part_pages(manual, part_list)]
    groups = _pages_of_rows(viewed_steps(manual))
    for number, rows in enumerate(groups, start=1):
        page = _new_page(manual, f"Steps, page {number}")
        _draw_rows(page, manual, rows, letters, double)
        if len(rows) < _ROWS_OF_STEPS and number == len(groups):
            _draw_done(page, manual)
        pages.append(page)
    done = len(groups[-1]) < _ROWS_OF_STEPS
    pages.append(_last_page(manual, on_plan, with_piece=not done))
    for number, page in enumerate(pages[1:], start=2):
        page.text(0.5 * WIDTH, MARGIN - 5, str(number), 9, centered=True, ink=GREY)
    return pages


def title_of(manual: Manual) -> str:
    """Return the name of the piece in words."""
    return manual.furniture.name.replace("_", " ").strip() or "Furniture"


def _new_page(manual: Manual, title: str) -> Page:
    page = Page(title)
    name = shortened(title_of(manual), 9, WIDTH - 2 * MARGIN)
    page.text(MARGIN, HEIGHT - MARGIN, name, 9, ink=GREY)
    return page


def _whole(manual: Manual) -> list[Figure]:
    furniture = manual.furniture
    return [
        Figure(p.mesh, pose, i) for i, (p, pose) in enumerate(zip(furniture.parts, furniture.assembled, strict=True))
    ]


def _cover(manual: Manual) -> Page:
    page = Page("Cover")
    furniture = manual.furniture
    left, right = MARGIN + 8, WIDTH - MARGIN - 8
    name = shortened(title_of(manual), 34, right - left, bold=True)
    page.text(left, HEIGHT - 42, name, 34, bold=True)
    count, steps = len(furniture.parts), len(manual.steps)
    fasteners = f", {len(furniture.fasteners)} fasteners" if furniture.fasteners else ""
    line = f"Assembly manual: {count} parts{fasteners}, {steps} step{'s' if steps != 1 else ''}"
    page.text(left, HEIGHT - 54, line, 14, ink=GREY)
    figures = _whole(manual)
    box = Box(left, 48, right, HEIGHT - 70)
    add_drawing(page, place(figures, best_camera(figures, UPRIGHT), box, largest=10.0), plain=True)
    size = np.ptp(np.concatenate([p.mesh.bounds @ q.rotation.T + q.translation for p, q in
                                  zip(furniture.parts, furniture.assembled, strict=True)]), axis=0)  # fmt: skip
    x, y, z = (round(1e3 * v) for v in size.tolist())
    page.text(left, 34, f"{x} × {y} × {z} mm", 12)
    origin = furniture.provenance
    origins = [w for w in (origin.source, origin.identifier, origin.licence) if w]
    if origins:
        page.text(left, 27, shortened(", ".join(origins), 8, right - left), 8, ink=GREY)
    page.path([np.array([[left, HEIGHT - 60], [right, HEIGHT - 60]])], stroke=ACCENT, width=1.0, closed=False)
    return page


def _part_pages(manual: Manual, part_list: Sequence[PartKind]) -> list[Page]:
    pages: list[Page] = []
    columns, rows = next((grid for grid in _GRIDS if grid[0] * grid[1] >= len(part_list)), _GRIDS[-1])
    width = (WIDTH - 2 * MARGIN) / columns
    height = (HEIGHT - 2 * MARGIN - 2 * _HEADER - 8) / rows
    for start in range(0, len(part_list), columns * rows):
        page = _new_page(manual, "Parts" if not pages else f"Parts, page {len(pages) + 1}")
        page.text(MARGIN, HEIGHT - MARGIN - 12, "Parts", 20, bold=True)
        top = HEIGHT - MARGIN - _HEADER - 8
        for k, kind in enumerate(part_list[start : start + columns * rows]):
            left, high = MARGIN + width * (k % columns), top - height * (k // columns)
            _draw_kind(page, manual, kind, Box(left, high - height, left + width, high))
        pages.append(page)
    return pages


def _draw_kind(page: Page, manual: Manual, kind: PartKind, box: Box) -> None:
    page.bubble((box.left + 5, box.high - 6), kind.letter, size=11)
    page.text(box.left + 12, box.high - 7.8, f"{len(kind.members)}×", 14, bold=True)
    picture = Box(box.left + 2, box.low + 13, box.right - 3, box.high - 13)
    add_drawing(page, place([kind_figure(kind)], kind.camera, picture, largest=1.0), plain=True)
    page.text(box.left + 2, box.low + 7.5, " × ".join(map(str, kind.size)) + " mm", 8)
    page.text(box.left + 2, box.low + 3.5, shortened(kind.name, 7, box.width - 4), 7, ink=GREY)


def _pages_of_rows(steps: Sequence[StepView]) -> list[list[list[StepView]]]:
    """Return the rows of each page; two small steps that follow each other share a row."""
    rows: list[list[StepView]] = []
    for view in steps:
        if rows and len(rows[-1]) == 1 and rows[-1][0].is_small and view.is_small:
            rows[-1].append(view)
        else:
            rows.append([view])
    return [rows[i : i + _ROWS_OF_STEPS] for i in range(0, len(rows), _ROWS_OF_STEPS)]


def _draw_rows(
    page: Page, manual: Manual, rows: Sequence[Sequence[StepView]], letters: dict[int, str], double: dict[int, Parts]
) -> None:
    top, low = HEIGHT - MARGIN - 4, MARGIN + 4
    height = (top - low - (_ROWS_OF_STEPS - 1) * _GAP) / _ROWS_OF_STEPS
    for r, row in enumerate(rows):
        high = top - r * (height + _GAP)
        width = (WIDTH - 2 * MARGIN - (len(row) - 1) * _GAP) / len(row)
        for k, view in enumerate(row):
            left = MARGIN + k * (width + _GAP)
            box = Box(left, high - height, left + width, high)
            if k:
                x = left - 0.5 * _GAP
                page.path([np.array([[x, box.low + 6], [x, box.high - 6]])], stroke=GREY, width=0.2, closed=False)
            draw_step(page, manual, view, box, letters, double.get(view.step.number))
        if r + 1 < len(rows):
            y = high - height - 0.5 * _GAP
            page.path([np.array([[MARGIN, y], [WIDTH - MARGIN, y]])], stroke=GREY, width=0.2, closed=False)


def _draw_done(page: Page, manual: Manual) -> None:
    """Draw the finished piece, and its turn onto its feet, into the lower half of a page."""
    middle = 0.5 * HEIGHT
    page.path([np.array([[MARGIN, middle], [WIDTH - MARGIN, middle]])], stroke=GREY, width=0.2, closed=False)
    right = WIDTH - MARGIN
    if manual.final_turn is not None:
        box = Box(right - 48, middle - 54, right - 2, middle - 8)
        draw_turned(page, manual.furniture, manual.steps[-1].result, manual.final_turn, "set it on its feet", box)
        right -= 52
    figures = _whole(manual)
    space = Box(MARGIN + 8, MARGIN + 8, right - 4, middle - 8)
    add_drawing(page, place(figures, best_camera(figures, UPRIGHT), space), plain=True)


def _last_page(manual: Manual, on_plan: str, *, with_piece: bool) -> Page:
    page = _new_page(manual, "Helping hands")
    right = WIDTH - MARGIN
    y = HEIGHT - MARGIN - 14
    page.text(MARGIN, y, "Two people", 20, bold=True)
    draw_people(page, MARGIN + 46, y - 1, 2)
    y -= 10
    helping = helps(manual)
    lines = [f"Step {h.step}: {h.reason}." for h in helping]
    if not lines:
        lines = ["One person can do every step: what is there stands by itself, and nothing is heavier than 15 kg or"
                 " longer than 1.5 m."]  # fmt: skip
    if manual.final_turn is not None:
        lines.append("After the last step: set the piece on its feet.")
    y = _paragraphs(page, lines, y, right)
    if manual.furniture.fasteners:
        page.text(MARGIN, y - 8, "Fasteners", 20, bold=True)
        y = _paragraphs(page, _fastener_lines(manual), y - 18, right)
    y -= 8
    page.text(MARGIN, y, "Two robots", 20, bold=True)
    y = _paragraphs(page, _robot_lines(manual, on_plan), y - 10, right)
    if with_piece and y > 0.5 * HEIGHT:
        _draw_done(page, manual)
    return page


def _fastener_lines(manual: Manual) -> list[str]:
    fasteners = manual.furniture.fasteners
    if not manual.not_inserted:
        return ["All fasteners go in along their axes. Two robots leave them to a person."]
    head = "Fasteners without a free way in in this order, to be fitted by other means:"
    return [head, *(f"{fasteners[index].name}: {reason}." for index, reason in manual.not_inserted)]


def _robot_lines(manual: Manual, on_plan: str) -> list[str]:
    furniture = manual.furniture
    lines = ["Two arms are needed in every step: one brings what comes, the other one holds what is there."]
    lines += [on_plan] if on_plan else []
    if furniture.unholdable:
        names = list(furniture.unholdable)
        more = f" and {len(names) - 6} more" if len(names) > 6 else ""
        lines.append(f"Parts that a gripper with an opening of 80 mm cannot hold at two places: "
                     f"{', '.join(names[:6])}{more}.")  # fmt: skip
    else:
        lines.append("A gripper with an opening of 80 mm can hold every part at two places.")
    return lines


def _paragraphs(page: Page, lines: Sequence[str], y: float, right: float) -> float:
    """Write paragraphs and return the height below them; what does not fit is counted."""
    for index, line in enumerate(lines):
        parts = wrapped(line, 11, right - MARGIN)
        if y - _LINE * len(parts) < MARGIN + 60 and index < len(lines) - 1:
            page.text(MARGIN, y, f"... and {len(lines) - index} more", 11)
            return y - _LINE
        for text in parts:
            page.text(MARGIN, y, text, 11)
            y -= _LINE
        y -= 1.6
    return y
