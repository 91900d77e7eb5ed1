"""Commands that the page types into the text control that links it to the studio.

A command is a number, which makes it differ from the one before it, a word, and the numbers that belong to the word:
`12 assemble`, `13 step 4`, `14 pointer 0.5120 0.3300`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

LINK = "Page link"
"""Label of the text control."""
_COMMAND = re.compile(
    r"(?P<serial>\d{1,9}) (?:(?P<word>touch|slow|assemble|steps|play|undo|cancel|read)"
    r"|step (?P<step>\d{1,3})|pointer (?P<x>0\.\d{1,4}) (?P<y>0\.\d{1,4}))",
    re.ASCII,
)


@dataclass(frozen=True)
class PageCommand:
    """Command of the page."""

    serial: int
    """Number of the command; the page counts its commands."""
    word: str
    """`touch`, `slow`, `assemble`, `steps`, `play`, `undo`, `cancel`, `read`, `step` or `pointer`."""
    step: int = 0
    """Step of the time line: 0 for the start, then 1 for the first step. Other words than `step` have 0."""
    pointer: tuple[float, float] = (0.0, 0.0)
    """Place of the pointer over the size of the scene: to the right and down, each from 0 to 1."""


def parse_command(text: object) -> PageCommand | None:
    """Return the command that a text holds; None if it holds none."""
    found = _COMMAND.fullmatch(text) if isinstance(text, str) else None
    if found is None:
        return None
    serial = int(found["serial"])
    if found["word"]:
        return PageCommand(serial, found["word"])
    if found["step"]:
        return PageCommand(serial, "step", step=int(found["step"]))
    return PageCommand(serial, "pointer", pointer=(float(found["x"]), float(found["y"])))
