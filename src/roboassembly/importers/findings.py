"""Findings of an import: changes and gaps that a person should look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from roboassembly.furniture.model import GRASP_REGIONS, Furniture, Part, RawFurniture
from roboassembly.geometry.units import METRES, NAMES, Unit
from roboassembly.repair import PartRepair
from roboassembly.repair.insertion import box_axes, extents
from roboassembly.robots.gripper import MAX_OPENING

SIZE_CHANGE = 0.001
"""Change of a part's size, or loss of depth in a joint, above which it is a finding [m]."""
SHIFT = 0.001
"""Translation of a part above which it is a finding [m]."""
TRIMMED = 0.05
"""Trimmed share of a part's volume above which it is a finding."""
SHAPE_ERROR = 0.001
"""Distance of a solid from the delivered surface above which it is a finding [m]."""
SOCKET = 0.002
"""Trimmed share of a part's volume above which its new sockets are a finding."""
_NOTED = (
    (65.0, "of its volume left to", "gave the volume that two parts had to the other"),
    (50.0, "cut through by", "cut through by another part and kept as one rigid part"),
    (45.0, "opened so that", "opened so that a neighbour can leave"),
    (40.0, "no longer within", "lost the contact with a neighbour"),
)
"""Weights of findings, words in the notes of repair, and their text."""
OPEN_GAP = 0.001
"""Distance from the nearest neighbour above which a part's joint is a finding [m]."""


@dataclass(frozen=True)
class Finding:
    """Something worth a look."""

    weight: float
    """Importance, from 0 to 100."""
    text: str
    """One line: what it is, of which part, by how much, and what would do."""


def findings(
    raw: RawFurniture, furniture: Furniture, repairs: Sequence[PartRepair], *, hands_find_order: bool = True
) -> tuple[Finding, ...]:
    """Return what is worth a look, the most important first; one finding for each kind of change.

    Args:
        raw: parts as read.
        furniture: furniture after repair and annotation.
        repairs: changes to each part.
        hands_find_order: whether two hands can join the parts in some order.
    """
    found = [
        *_of_unit(raw),
        *_of_holds(furniture, hands_find_order),
        *_of_repairs(repairs),
        *_of_gaps(furniture),
        *(Finding(55.0 if "separate bodies" in remark else 30.0, remark) for remark in raw.remarks if _counts(remark)),
    ]
    return tuple(sorted(found, key=lambda finding: -finding.weight))


def why_not_held(part: Part) -> str:
    """Return why a hand has fewer than two places to hold a part; empty if it has them."""
    places = len(part.grasps)
    if places >= GRASP_REGIONS:
        return ""
    thinnest = float(extents(part.mesh.vertices, box_axes(part.mesh.vertices)).min())
    count = "no place" if places == 0 else "one place only"
    if thinnest > MAX_OPENING:
        return f"{count} to hold it: it is {1e3 * thinnest:.0f} mm thick, and the hand opens {1e3 * MAX_OPENING:.0f} mm"
    return f"{count} to hold it: no further two sides face each other within reach of a hand and clear of the part"


def _of_unit(raw: RawFurniture) -> list[Finding]:
    unit = raw.unit
    if unit is None:
        return []
    if unit.guessed and unit.name is None:
        return [Finding(95.0, f"{unit.text}: name the unit of the files with --unit or --scale")]
    if not unit.others:
        return []
    likely = ", or ".join(f"{_size(raw, unit, name)} in {NAMES[name]} (--unit {name})" for name in unit.others)
    weight = 60.0 if unit.guessed else 85.0
    return [Finding(weight, f"the size: {_size(raw, unit, None)} with {unit.text}; it would be {likely}")]


def _size(raw: RawFurniture, unit: Unit, name: str | None) -> str:
    factor = 1.0 if name is None else METRES[name] / unit.scale
    return " x ".join(f"{factor * side:.3g}" for side in raw.size) + " m"


def _counts(remark: str) -> bool:
    return "separate bodies" in remark or "left out" in remark or "like fasteners" in remark


def _of_holds(furniture: Furniture, hands_find_order: bool) -> list[Finding]:
    out: list[Finding] = []
    never = [part for part in furniture.parts if not part.grasps]
    seldom = [part for part in furniture.parts if len(part.grasps) == 1]
    if never:
        names, first = _names([part.name for part in never]), why_not_held(never[0])
        text = f"a robot's hand cannot hold {names} ({first}); the setting object-centric needs no hand"
        out.append(Finding(75.0, text))
    elif not hands_find_order:
        text = (
            "two robot hands find no order in which they can join the parts; the setting object-centric needs no hand"
        )
        out.append(Finding(74.0, text))
    if seldom:
        text = f"a robot's hand can hold {_names([part.name for part in seldom])} in one place only"
        out.append(Finding(33.0, text))
    return out


def _of_repairs(repairs: Sequence[PartRepair]) -> list[Finding]:
    smaller = [(-r.size_change, r.name) for r in repairs if r.size_change < -SIZE_CHANGE]
    larger = [(r.size_change, r.name) for r in repairs if r.size_change > SIZE_CHANGE]
    depth = [(loss, f"{r.name}' in '{other}") for r in repairs for other, loss in r.depth_losses]
    moved = [(r.displacement, r.name) for r in repairs if r.displacement > SHIFT]
    trimmed = [(r.trimmed, r.name) for r in repairs if r.trimmed > TRIMMED]
    out = [
        *_of_amounts(smaller, "mm", (50.0, 6e3, 90.0), "became smaller: {}; it overlapped its neighbours"),
        *_of_amounts(larger, "mm", (50.0, 6e3, 90.0), "became larger: {}; its surface had to be closed"),
        *_of_amounts(depth, "mm", (50.0, 6e3, 90.0), "sits less deep in its joint: {}"),
        *_of_amounts(moved, "mm", (40.0, 3e3, 80.0), "moved to its neighbours: {}"),
        *_of_amounts(trimmed, "%", (30.0, 200.0, 80.0), "lost volume where parts overlapped: {}"),
    ]
    sockets = [(r.trimmed, r.name) for r in repairs if r.trimmed > SOCKET and _noted(r, "has a socket for")]
    out += _of_amounts(sockets, "%", (32.0, 0.0, 32.0), "sockets cut where a part runs into another: {}")
    for weight, note, what in _NOTED:
        if noted := [r.name for r in repairs if _noted(r, note)]:
            out.append(Finding(weight, f"{what}: {_names(noted)}"))
    reshaped = [(max(r.shape_error, r.shape_added), r.name) for r in repairs if r.how != "as delivered"]
    rough = [(error, name) for error, name in reshaped if error > SHAPE_ERROR]
    return out + _of_amounts(rough, "mm", (45.0, 1e3, 80.0), "closed, off its delivered surface: {}")


def _noted(repair: PartRepair, text: str) -> bool:
    return any(text in note for note in repair.notes)


def _of_gaps(furniture: Furniture) -> list[Finding]:
    """Return the parts whose every joint is open."""
    nearest: dict[int, tuple[float, str]] = {}
    for c in furniture.connections:
        gap = furniture.parts[c.part_a].points[c.point_a].gap
        for own, other in ((c.part_a, c.part_b), (c.part_b, c.part_a)):
            text = f"{furniture.parts[own].name}' from '{furniture.parts[other].name}"
            nearest[own] = min(nearest.get(own, (np.inf, "")), (gap, text))
    open_joints = [entry for entry in nearest.values() if entry[0] > OPEN_GAP]
    return _of_amounts(open_joints, "mm", (35.0, 5e3, 80.0), "touches nothing: {}; it counts as joined up to 5 mm")


def _of_amounts(
    amounts: Sequence[tuple[float, str]], unit: Literal["mm", "%"], weight: tuple[float, float, float], text: str
) -> list[Finding]:
    """Return one finding that names the part with the largest amount and counts the others; none without amounts.

    Args:
        amounts: amount of each part [m, or a share], and its name.
        unit: unit of the amounts in the text.
        weight: weight of no amount, its rise with the amount, and its bound.
        text: text of the finding, with braces for amounts and names.
    """
    if not amounts:
        return []
    factor, space = (1e3, " ") if unit == "mm" else (1e2, "")
    (most, name), *others = sorted(amounts, key=lambda entry: -entry[0])
    listed = f"'{name}' by {factor * most:.1f}{space}{unit}"
    if others:
        count = "one other part" if len(others) == 1 else f"{len(others)} other parts"
        listed += f", and {count} by up to {factor * others[0][0]:.1f}{space}{unit}"
    least, rise, largest = weight
    return [Finding(min(largest, least + rise * most), text.format(listed))]


def _names(names: Sequence[str], shown: int = 3) -> str:
    rest = len(names) - shown
    return ", ".join(f"'{name}'" for name in names[:shown]) + (f" and {rest} more" if rest > 0 else "")
