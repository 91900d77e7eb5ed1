"""Checks of what users hand to an environment. Errors are Gymnasium's or Python's own; they say what would do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.error import InvalidAction

from roboassembly.errors import ArgumentError

_LONGEST = 80
"""Characters of a value that an error shows."""


def checked_action(action: object, sizes: Sequence[int], names: Sequence[str]) -> tuple[int, ...]:
    """The integers of a `MultiDiscrete` action.

    Args:
        action: from the user.
        sizes: number of values of each component.
        names: of the components.

    Raises:
        gymnasium.error.InvalidAction: a wrong shape, values that are not integers, or one out of range.
    """
    wanted = f"{len(sizes)} integers ({', '.join(names)}) would do"
    values = _array(action, wanted)
    if values.shape != (len(sizes),):
        raise InvalidAction(f"action {shortened(action)} has shape {values.shape}; shape ({len(sizes)},), {wanted}")
    if not np.issubdtype(values.dtype, np.integer):
        raise InvalidAction(f"action {shortened(action)} has dtype {values.dtype}; {wanted}")
    for name, value, size in zip(names, values.tolist(), sizes, strict=True):
        if not 0 <= value < size:
            raise InvalidAction(f"action {shortened(action)}: {name} is {value}; 0 to {size - 1} would do")
    return tuple(values.tolist())


def checked_number(action: object, size: int) -> int:
    """The number of a `Discrete` action.

    Raises:
        gymnasium.error.InvalidAction: not one integer, or out of range.
    """
    wanted = f"an integer from 0 to {size - 1} would do"
    value = _array(action, wanted)
    if value.shape != ():
        raise InvalidAction(f"action {shortened(action)} has shape {value.shape}; {wanted}")
    if not np.issubdtype(value.dtype, np.integer):
        raise InvalidAction(f"action {shortened(action)} has dtype {value.dtype}; {wanted}")
    if not 0 <= int(value) < size:
        raise InvalidAction(f"action {shortened(action)} is out of range; {wanted}")
    return int(value)


def checked_integer(name: str, value: object, low: int, high: int) -> int:
    """An argument that is an integer within a range.

    Raises:
        TypeError: no integer.
        ArgumentError: out of range.
    """
    wanted = f"{low} to {high} would do"
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise TypeError(f"{name} is {shortened(value)}; an integer, {wanted}")
    if not low <= value <= high:
        raise ArgumentError(f"{name} is {value}; {wanted}")
    return int(value)


def checked_piece(options: object, pieces: int) -> int | None:
    """Index of the furniture that the options of `reset` ask for; None if they leave it open.

    Raises:
        TypeError: the options are no dictionary.
        ArgumentError: an unknown option, or no such piece.
    """
    if options is None:
        return None
    if not isinstance(options, Mapping):
        raise TypeError(f"options is {shortened(options)}; a dictionary such as {{'furniture': 0}} would do")
    for name, value in options.items():
        if name != "furniture":
            raise ArgumentError(f"unknown reset option {name!r} (its value is {shortened(value)}); known: 'furniture'")
    index: Any = options.get("furniture")
    if index is None:
        return None
    if isinstance(index, bool) or not isinstance(index, int | np.integer) or not 0 <= index < pieces:
        raise ArgumentError(f"options['furniture'] is {shortened(index)}; an index from 0 to {pieces - 1} would do")
    return int(index)


def shortened(value: object) -> str:
    """One line that shows a value."""
    text = " ".join(repr(value.item() if isinstance(value, np.generic) else value).split())
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def _array(action: object, wanted: str) -> np.ndarray:
    try:
        return np.asarray(action)
    except (TypeError, ValueError) as error:
        raise InvalidAction(f"action {shortened(action)} is no array; {wanted}") from error
