"""Shared overlaps: one solid loses its tip, and the other gets a socket for the rest of it."""

from __future__ import annotations

from dataclasses import dataclass

import manifold3d as m3
import numpy as np

from roboassembly.repair.exits import main_axes
from roboassembly.repair.surface import to_surface
from roboassembly.repair.trim import Cut, cut, cut_off, inflate, near

TIP_SHARES = (0.25, 0.5, 0.75)
"""Removed lengths of a tip, as shares of its depth in the other solid."""
MAX_TRIED = 4
"""Largest number of tips for which the socket is cut."""


@dataclass(frozen=True, eq=False)
class SharedCut:
    """Cuts of two solids that share an overlap."""

    tip: Cut
    """Cut of the solid that is shortened."""
    socket: Cut
    """Cut of the solid that receives it."""


def shared_cuts(body: m3.Manifold, other: m3.Manifold, gap: float, most: float) -> list[SharedCut]:
    """Return cuts that shorten `body` across a main axis in its overlap with `other`, and recess the other.

    Args:
        body: solid that loses its tip, or a side of it.
        other: solid that gets the socket.
        gap: distance left between the two [m].
        most: largest volume that `body` may lose [m³].
    """
    tool = inflate(near(other, body, 20.0 * gap), gap)
    overlap = (tool ^ body).simplify(0.1 * gap)
    if overlap.is_empty():
        return []
    corners = to_surface(overlap).vertices
    tips: list[Cut] = []
    for axis in main_axes(to_surface(body)):
        for direction in (axis, -axis):
            low, high = float((corners @ direction).min()), float((corners @ direction).max())
            for share in TIP_SHARES:
                beyond = tool.trim_by_plane(tuple(direction.tolist()), high - share * (high - low))
                if not beyond.is_empty():
                    tips.append(cut_off(body, beyond))
    tips = [tip for tip in tips if tip.removed <= most and not tip.body.is_empty() and not tip.splits]
    tips.sort(key=lambda tip: tip.removed)
    return [SharedCut(tip, cut(other, tip.body, gap)) for tip in _spread_by_cost(tips)]


def _spread_by_cost(tips: list[Cut]) -> list[Cut]:
    """Return a few tips, from the smallest loss to the largest."""
    return [tips[k] for k in np.unique(np.linspace(0, len(tips) - 1, min(MAX_TRIED, len(tips))).astype(int))]
