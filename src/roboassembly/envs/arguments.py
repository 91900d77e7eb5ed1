"""Checks of the arguments of an environment. Errors are Gymnasium's or Python's own and name the valid values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeGuard, cast

import gymnasium
import numpy as np
from gymnasium.error import InvalidAction, UnsupportedMode

from roboassembly.errors import ArgumentError

RGB_ARRAY = "rgb_array"
"""Render mode of the environments."""
_MAX_LENGTH = 80
"""Number of characters of a value that an error shows."""


def checked_action(action: object, sizes: Sequence[int], names: Sequence[str]) -> tuple[int, ...]:
    """Return the integers of a `MultiDiscrete` action.

    Args:
        action: action from the user.
        sizes: number of values of each component.
        names: names of the components.

    Raises:
        gymnasium.error.InvalidAction: a wrong shape, values that are not integers, or one out of range.
    """
    expected = f"{len(sizes)} integers ({', '.join(names)})"
    values = _array(action, expected)
    if values.shape != (len(sizes),):
        raise InvalidAction(f"action {shortened(action)} has shape {values.shape}; expected {expected}")
    if not np.issubdtype(values.dtype, np.integer):
        raise InvalidAction(f"action {shortened(action)} has dtype {values.dtype}; expected {expected}")
    for name, value, size in zip(names, values.tolist(), sizes, strict=True):
        if not 0 <= value < size:
            raise InvalidAction(f"action {shortened(action)}: {name} is {value}; expected 0 to {size - 1}")
    return tuple(values.tolist())


def checked_number(action: object, size: int) -> int:
    """Return the number of a `Discrete` action.

    Raises:
        gymnasium.error.InvalidAction: not one integer, or out of range.
    """
    expected = f"an integer from 0 to {size - 1}"
    value = _array(action, expected)
    if value.shape != ():
        raise InvalidAction(f"action {shortened(action)} has shape {value.shape}; expected {expected}")
    if not np.issubdtype(value.dtype, np.integer):
        raise InvalidAction(f"action {shortened(action)} has dtype {value.dtype}; expected {expected}")
    if not 0 <= int(value) < size:
        raise InvalidAction(f"action {shortened(action)} is out of range; expected {expected}")
    return int(value)


def checked_integer(name: str, value: object, low: int, high: int) -> int:
    """Return an argument if it is an integer within a range.

    Raises:
        TypeError: no integer.
        ArgumentError: out of range.
    """
    expected = f"an integer from {low} to {high}"
    if not _is_integer(value):
        raise TypeError(f"{name} is {shortened(value)}; expected {expected}")
    if not low <= value <= high:
        raise ArgumentError(f"{name} is {value}; expected {expected}")
    return int(value)


def checked_render_mode(render_mode: str | None) -> str | None:
    """Return a render mode of an environment of this package.

    Raises:
        gymnasium.error.UnsupportedMode: another one than `"rgb_array"` or None.
    """
    if render_mode not in (None, RGB_ARRAY):
        raise UnsupportedMode(f"render_mode is {render_mode!r}; expected '{RGB_ARRAY}' or None")
    return render_mode


def may_render(render_mode: str | None) -> bool:
    """Return whether an environment has a render mode, and warn as Gymnasium does if it has none."""
    if render_mode is None:
        gymnasium.logger.warn(
            "render() was called, but the environment was made without a render mode; "
            f'pass one to gymnasium.make(..., render_mode="{RGB_ARRAY}")'
        )
    return render_mode is not None


def checked_piece(options: object, pieces: int) -> int | None:
    """Return the index of the furniture in the options of `reset`; None if they name none.

    Raises:
        TypeError: the options are no dictionary.
        ArgumentError: an unknown option, or no such piece.
    """
    return checked_index(reset_options(options, ("furniture",)), "furniture", pieces)


def reset_options(options: object, known: Sequence[str]) -> Mapping[object, object]:
    """Return the options of `reset` as a mapping; an empty one if there are none.

    Raises:
        TypeError: the options are no dictionary.
        ArgumentError: an option that is not among the known ones.
    """
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise TypeError(f"options is {shortened(options)}; expected a dictionary such as {{'furniture': 0}}")
    named = cast("Mapping[object, object]", options)
    for name, value in named.items():
        if name not in known:
            raise ArgumentError(
                f"unknown reset option {name!r} (its value is {shortened(value)}); known: {', '.join(map(repr, known))}"
            )
    return named


def checked_index(named: Mapping[object, object], name: str, count: int) -> int | None:
    """Return an option of `reset` that is an index; None if it is not there.

    Raises:
        ArgumentError: no integer from 0 to `count` - 1.
    """
    index = named.get(name)
    if index is None:
        return None
    if not _is_integer(index) or not 0 <= index < count:
        raise ArgumentError(f"options[{name!r}] is {shortened(index)}; expected an index from 0 to {count - 1}")
    return int(index)


def shortened(value: object) -> str:
    """Return a value as one short line."""
    if isinstance(value, np.generic):
        value = cast("np.generic[Any]", value).item()
    text = " ".join(repr(value).split())
    return text if len(text) <= _MAX_LENGTH else f"{text[: _MAX_LENGTH - 3]}..."


def _is_integer(value: object) -> TypeGuard[int | np.integer[Any]]:
    return not isinstance(value, bool) and isinstance(value, int | np.integer)


def _array(action: object, expected: str) -> np.ndarray:
    try:
        return np.asarray(action)
    except (TypeError, ValueError) as error:
        raise InvalidAction(f"action {shortened(action)} is no array; expected {expected}") from error
