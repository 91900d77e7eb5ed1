"""Makes a manual from the actions of a plan, and writes it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from roboassembly.furniture.model import Furniture
from roboassembly.manual.arrangement import arrange
from roboassembly.manual.document import pages_of, title_of
from roboassembly.manual.merge_tree import tree_of
from roboassembly.manual.steps import Manual, steps_of
from roboassembly.manual.writers import html, pdf

PDF, HTML = "manual.pdf", "manual.html"
"""Names of the files."""


def make_manual(furniture: Furniture, actions: Sequence[tuple[int, ...]], seed: int, name: str = "the plan") -> Manual:
    """Return the steps of a manual, in an order for people that the planner has checked.

    Args:
        furniture: the piece.
        actions: actions of a plan that assembles it, in either setting.
        seed: seed of the planner.
        name: words for the plan in errors.

    Raises:
        InputError: the actions do not assemble the piece.
        ManualError: the planner finds no path for a step.
    """
    return steps_of(arrange(furniture, tree_of(furniture, actions, name), seed))


def write_manual(manual: Manual, folder: Path, on_plan: str = "") -> tuple[Path, Path, int]:
    """Write `manual.pdf` and `manual.html`, and return their paths and the number of pages.

    Args:
        manual: its steps.
        folder: existing folder; earlier manuals in it are replaced.
        on_plan: paragraph on the plan, for the last page.
    """
    pages, title = pages_of(manual, on_plan), title_of(manual)
    (folder / PDF).write_bytes(pdf(pages, title))
    (folder / HTML).write_text(html(pages, title), encoding="utf-8")
    return folder / PDF, folder / HTML, len(pages)
