"""Unit of length of imported files: given, or guessed from typical sizes of furniture.

Plain mesh files do not state their unit. Each unit implies a height, width and depth of the piece in metres. The guess
is the unit whose size is the most likely for furniture according to `TYPICAL`; it lists other units that are nearly as
likely.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType

from roboassembly.errors import FurnitureError, InputError

METRES = MappingProxyType({"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254, "ft": 0.3048})
"""Length of each unit [m]."""
NAMES = MappingProxyType({"mm": "millimetres", "cm": "centimetres", "m": "metres", "in": "inches", "ft": "feet"})

Range = tuple[float, float]
TYPICAL: MappingProxyType[str, tuple[Range, Range, Range]] = MappingProxyType(
    {
        "chair": ((0.75, 1.10), (0.42, 0.80), (0.40, 0.70)),
        "stool": ((0.40, 0.75), (0.30, 0.50), (0.28, 0.45)),
        "bench": ((0.42, 0.95), (0.90, 1.80), (0.35, 0.65)),
        "sofa": ((0.70, 0.95), (1.50, 2.40), (0.80, 1.00)),
        "table": ((0.70, 0.78), (0.75, 2.10), (0.60, 1.05)),
        "low table": ((0.35, 0.65), (0.45, 1.25), (0.40, 0.75)),
        "cabinet": ((0.45, 1.30), (0.40, 1.50), (0.30, 0.60)),
        "bookcase": ((0.75, 2.15), (0.40, 1.15), (0.22, 0.36)),
        "wardrobe": ((1.70, 2.30), (0.80, 2.00), (0.50, 0.65)),
        "bed": ((0.30, 1.20), (1.90, 2.20), (0.80, 2.00)),
        "anything": ((0.25, 2.20), (0.25, 2.20), (0.10, 1.50)),
    }
)
"""Ranges of height, width (the longer side of the floor plan) and depth that contain nine of ten pieces [m].

The figures are usual in the trade: a side chair 18 by 18 inches with its seat at 18, a dining table 28 to 30 high, 36
to 40 wide and 48 to 78 long, a low table 18 to 20 high, 24 by 24 to 30 by 48, a bookcase 9 to 14 deep and 48 to 84
high, a sofa 33 to 38 by 72 to 90, beds 75 to 84 long.
"""
_NINE_OF_TEN = 2 * 1.645
"""Width of the range that contains nine of ten, in standard deviations."""
CLOSE = 0.05
"""Share of the likelihood from which a unit is listed as another possibility."""
SMALLEST, LARGEST = 0.1, 4.0
"""Bounds of a plausible longest side [m]."""
TYPICAL_LONGEST = 1.0
"""Longest side given to a piece whose size fits no unit [m]."""


@dataclass(frozen=True)
class Unit:
    """Scale of a piece's files and its origin."""

    scale: float
    """Length of the files' unit [m]."""
    text: str
    """Description for the user: `guessed inches`, `metres, as given`, ..."""
    name: str | None = None
    """Name of the unit in `METRES`; None if the scale is that of no unit."""
    guessed: bool = False
    others: tuple[str, ...] = ()
    """Names of units in `METRES` that are nearly as likely."""


def given(scale: float) -> Unit:
    """Return the unit of a scale given by the user."""
    name = next((n for n, metres in METRES.items() if math.isclose(scale, metres, rel_tol=1e-9)), None)
    return Unit(scale, f"{NAMES[name]}, as given" if name else f"{scale:.6g} m, as given", name)


def of_format(scale: float, asked: float | None) -> Unit:
    """Return the unit of files whose format states it or which are scaled to a typical size."""
    if asked is not None:
        return given(asked)
    if scale == 1.0:
        return Unit(scale, f"{NAMES['m']}, as the format has it", "m")
    return Unit(scale, f"{scale:.4g} m, for a typical size")


def scale_of(unit: str | None, scale: float | None) -> float | None:
    """Return the length of a unit given by name or by size [m]; None if neither is given.

    Raises:
        InputError: both are given, or there is no such unit.
    """
    if unit is None:
        return scale
    if scale is not None:
        raise InputError(f"--unit {unit} and --scale {scale:g} both say how large the files are; give one of them")
    if unit not in METRES:
        raise InputError(f"unit '{unit}' is not known; expected one of {', '.join(METRES)}")
    return METRES[unit]


def guess(extents: Sequence[float]) -> Unit:
    """Return the most likely unit of a piece with these extents (x, y, z; z up) in its own unit.

    Raises:
        FurnitureError: the piece has no extent.
    """
    longest = max(extents)
    if not longest >= 1e-300:
        raise FurnitureError("all its points are one and the same; give parts with some extent")
    fitting = [name for name, metres in METRES.items() if SMALLEST <= longest * metres <= LARGEST]
    if not fitting:
        text = f"no unit fits a longest side of {longest:.4g}; scaled to {TYPICAL_LONGEST:g} m"
        return Unit(TYPICAL_LONGEST / longest, text, guessed=True)
    scores = {name: _log_likelihood([e * METRES[name] for e in extents]) for name in fitting}
    best = max(fitting, key=lambda name: scores[name])
    total = sum(math.exp(score - scores[best]) for score in scores.values())
    others = [name for name in fitting if name != best and math.exp(scores[name] - scores[best]) / total >= CLOSE]
    others.sort(key=lambda name: -scores[name])
    return Unit(METRES[best], f"guessed {NAMES[best]}", best, True, tuple(others))


def _log_likelihood(extents: Sequence[float]) -> float:
    """Return the log-likelihood of a size (x, y, z; z up) [m], with all kinds of furniture equally frequent."""
    sides = (extents[2], max(extents[0], extents[1]), min(extents[0], extents[1]))
    logs = [sum(map(_log_density, sides, ranges)) for ranges in TYPICAL.values()]
    top = max(logs)
    return top + math.log(sum(math.exp(value - top) for value in logs) / len(logs))


def _log_density(side: float, usual: Range) -> float:
    """Return the log-normal log-density of a side [m] with a usual range."""
    low, high = math.log(usual[0]), math.log(usual[1])
    deviation = (high - low) / _NINE_OF_TEN
    return -0.5 * ((math.log(max(side, 1e-9)) - 0.5 * (low + high)) / deviation) ** 2 - math.log(deviation)
