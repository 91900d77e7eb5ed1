"""The unit of length that someone else's files are in: named, or guessed from typical sizes of furniture.

Plain mesh files do not say their unit. For each unit, the piece would have a height, a width and a depth in metres. The
guess is the unit whose size is the most likely for furniture, as `TYPICAL` has it; where another unit is nearly as
likely, the guess says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType

from roboassembly.errors import FurnitureError, InputError

METRES = MappingProxyType({"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254, "ft": 0.3048})
"""Metres per unit."""
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
"""Height, width (the longer side of the floor plan) and depth in metres: the range that nine of ten pieces lie in.

From the usual figures of the trade: a side chair 18 by 18 inches with its seat at 18, a dining table 28 to 30 high, 36
to 40 wide and 48 to 78 long, a low table 18 to 20 high, 24 by 24 to 30 by 48, a bookcase 9 to 14 deep and 48 to 84
high, a sofa 33 to 38 by 72 to 90, beds 75 to 84 long.
"""
_NINE_OF_TEN = 2 * 1.645
"""Width in standard deviations of the range that holds nine of ten."""
CLOSE = 0.05
"""A unit whose share of the likelihood is at least this is told as another possibility."""
SMALLEST, LARGEST = 0.1, 4.0
"""Metres: a longest side outside these is believed in no unit."""
TYPICAL_LONGEST = 1.0
"""Metres: the longest side of a piece whose size fits no unit."""


@dataclass(frozen=True)
class Unit:
    """How a piece got its size."""

    scale: float
    """Metres per unit of the files."""
    text: str
    """For people: `guessed inches`, `given: 0.5 m`, ..."""
    name: str | None = None
    """Of `METRES`; None where the scale is that of no unit."""
    guessed: bool = False
    others: tuple[str, ...] = ()
    """Units that are nearly as likely, of `METRES`."""


def given(scale: float) -> Unit:
    """The unit with a scale that someone named."""
    name = next((n for n, metres in METRES.items() if math.isclose(scale, metres, rel_tol=1e-9)), None)
    return Unit(scale, f"{NAMES[name]}, as given" if name else f"{scale:.6g} m, as given", name)


def of_format(scale: float, asked: float | None) -> Unit:
    """The unit of files whose format has one, or is scaled to a typical size."""
    if asked is not None:
        return given(asked)
    if scale == 1.0:
        return Unit(scale, f"{NAMES['m']}, as the format has it", "m")
    return Unit(scale, f"{scale:.4g} m, for a typical size")


def scale_of(unit: str | None, scale: float | None) -> float | None:
    """Metres per unit, by its name or by its size; None if neither is given.

    Raises:
        InputError: both are given, or there is no such unit.
    """
    if unit is None:
        return scale
    if scale is not None:
        raise InputError(f"--unit {unit} and --scale {scale:g} both say how large the files are; give one of them")
    if unit not in METRES:
        raise InputError(f"unit '{unit}' is not known; {', '.join(METRES)} would do")
    return METRES[unit]


def guess(extents: Sequence[float]) -> Unit:
    """The most likely unit of a piece with these extents (x, y, z; z up) in its own unit.

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
    """Of a size in metres (x, y, z; z up), for furniture of any kind that is as frequent as any other."""
    sides = (extents[2], max(extents[0], extents[1]), min(extents[0], extents[1]))
    logs = [sum(map(_log_density, sides, ranges)) for ranges in TYPICAL.values()]
    top = max(logs)
    return top + math.log(sum(math.exp(value - top) for value in logs) / len(logs))


def _log_density(side: float, usual: Range) -> float:
    """Log-normal."""
    low, high = math.log(usual[0]), math.log(usual[1])
    deviation = (high - low) / _NINE_OF_TEN
    return -0.5 * ((math.log(max(side, 1e-9)) - 0.5 * (low + high)) / deviation) ** 2 - math.log(deviation)
