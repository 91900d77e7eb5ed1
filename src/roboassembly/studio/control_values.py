"""Check of the values that browsers send: a control accepts only values that it offers."""

from __future__ import annotations

import math
from typing import cast

from viser import (
    GuiButtonHandle,
    GuiCheckboxHandle,
    GuiDropdownHandle,
    GuiNumberHandle,
    GuiSliderHandle,
    GuiTextHandle,
)

from roboassembly.studio.page_commands import LINK, parse_command

LONGEST_TEXT = 500
"""Largest number of characters in a text control or in the name of a file."""


class RefusedError(Exception):
    """A message is dropped. Its text is for the user; it is empty if the studio's page cannot have sent the message."""


def check_value(control: object, value: bool | int | float | str) -> None:
    """Check that a control offers a value.

    Raises:
        RefusedError: the control does not offer it.
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
                raise RefusedError(f"{named} does not offer {_shortened(value)}.")
        case GuiSliderHandle() | GuiNumberHandle():
            number = cast("GuiSliderHandle[float] | GuiNumberHandle[float]", control)
            allowed = _in_range(value, number)
            if not allowed:
                raise RefusedError(f"{named} accepts {number.min} to {number.max}, not {_shortened(value)}.")
        case GuiTextHandle() if control.label == LINK:
            if parse_command(value) is None:
                raise RefusedError
            allowed = True
        case GuiTextHandle():
            allowed = isinstance(value, str)
            if allowed:
                check_text(str(value), named)
        case _:
            allowed = False
    if not allowed:
        raise RefusedError(f"{named} does not accept {_shortened(value)}.")


def _in_range(value: object, control: GuiSliderHandle[float] | GuiNumberHandle[float]) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return False
    if isinstance(control.value, int) and value != int(value):
        return False
    # No value is in range without limits; every numeric control of the studio has them.
    return control.min is not None and control.max is not None and control.min <= value <= control.max


def check_text(text: str, named: str) -> None:
    """Check that a text is short and printable on one line.

    Args:
        text: text to check.
        named: what the text is, for the error.

    Raises:
        RefusedError: the text is too long or has control characters.
    """
    if len(text) > LONGEST_TEXT:
        raise RefusedError(f"{named} may have at most {LONGEST_TEXT} characters, not {len(text):,}.")
    if not text.isprintable():
        raise RefusedError(f"{named} must not contain control characters.")


def _shortened(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
