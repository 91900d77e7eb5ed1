"""Values that a control takes from a browser: only those that it offers."""

from __future__ import annotations

import math
from typing import Any

from viser import (
    GuiButtonHandle,
    GuiCheckboxHandle,
    GuiDropdownHandle,
    GuiNumberHandle,
    GuiSliderHandle,
    GuiTextHandle,
)

LONGEST_TEXT = 500
"""Characters in a text control, or of a file's name."""


class Refused(Exception):  # noqa: N818
    """A message is dropped. The text is for the person at the browser; empty if no person can have caused it."""


def check_value(control: Any, value: bool | int | float | str) -> None:
    """Whether a control offers the value.

    Raises:
        Refused: it does not.
    """
    named = f"“{getattr(control, 'label', '')}”"
    match control:
        case GuiButtonHandle():
            allowed = value is True
        case GuiCheckboxHandle():
            allowed = isinstance(value, bool)
        case GuiDropdownHandle():
            allowed = isinstance(value, str) and value in control.options
            if not allowed:
                raise Refused(f"{named} does not offer {_shortened(value)}.")
        case GuiSliderHandle() | GuiNumberHandle():
            allowed = _in_range(value, control)
            if not allowed:
                raise Refused(f"{named} takes {control.min} to {control.max}, not {_shortened(value)}.")
        case GuiTextHandle():
            allowed = isinstance(value, str)
            if allowed:
                check_text(str(value), named)
        case _:
            allowed = False
    if not allowed:
        raise Refused(f"{named} does not take {_shortened(value)}.")


def _in_range(value: object, control: GuiSliderHandle[Any] | GuiNumberHandle[Any]) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return False
    if isinstance(control.value, int) and value != int(value):
        return False
    # Without limits nothing is in range: every control of the studio has some.
    return control.min is not None and control.max is not None and control.min <= value <= control.max


def check_text(text: str, named: str) -> None:
    """Whether a text is short and shows on one line.

    Raises:
        Refused: it is not.
    """
    if len(text) > LONGEST_TEXT:
        raise Refused(f"{named} has at most {LONGEST_TEXT} characters, not {len(text):,}.")
    if not text.isprintable():
        raise Refused(f"{named} cannot hold control characters.")


def _shortened(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
