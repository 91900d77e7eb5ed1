"""Lines for the user on an imported piece."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from roboassembly.cli.importing import ImportResult

NAMED = 3
"""Number of findings that are printed for a piece."""


def report_lines(item: ImportResult) -> list[str]:
    """Return the lines for the user."""
    lines = [f"{item.name}: {item.error}" if item.error else _summary(item)]
    if item.size_m is not None and item.scale is not None:
        lines.append(f"  unit: {item.unit_text}; {_size(item.size_m)}")
        lines += [_other(item, other) for other in item.unit_others]
    lines += [f"  {line}" for line in item.remarks]
    if item.error:
        return lines + [f"  report: {item.report}"] * (item.report is not None)
    if item.findings:
        more = len(item.findings) - NAMED
        lines.append("  worth a look:")
        lines += [f"    {k}. {line}" for k, line in enumerate(item.findings[:NAMED], start=1)]
        lines += [f"    and {more} more in the report"] * (more > 0)
    else:
        lines.append("  worth a look: nothing")
    lines += [f"  report: {item.report}"] * (item.report is not None)
    return lines


def _other(item: ImportResult, unit: str) -> str:
    from roboassembly.geometry.units import METRES, NAMES

    assert item.size_m is not None
    assert item.scale is not None
    size = [METRES[unit] / item.scale * side for side in item.size_m]
    return f"  the unit may also be {NAMES[unit]}: {_size(size)}; if so, import it with --unit {unit}"


def _size(sides: Sequence[float]) -> str:
    return " x ".join(f"{side:.2f}" if side >= 0.1 else f"{side:.3f}" for side in sides) + " m"


def _summary(item: ImportResult) -> str:
    text = f"{item.name}: {item.parts} parts -> {item.folder}"
    if item.cached:
        text += " (from the cache)"
    if item.unholdable:
        listed = ", ".join(item.unholdable[:NAMED]) + f" and {len(item.unholdable) - NAMED} more" * (
            len(item.unholdable) > NAMED
        )
        text += f" (the gripper cannot hold {listed}: for the setting object-centric only)"
    name, change = max(item.size_change_mm.items(), key=lambda named: abs(named[1]))
    return f"{text}; largest change of size: {name} {change:+.2f} mm"
