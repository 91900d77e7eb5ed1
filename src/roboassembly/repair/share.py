"""Sharing an overlap: the tip of one solid goes, and the other gets a socket for what is left of it."""

from __future__ import annotations

from dataclasses import dataclass

import manifold3d as m3
import numpy as np

from roboassembly.repair.exits import main_axes
from roboassembly.repair.surface import to_surface
from roboassembly.repair.trim import Cut, cut, cut_off, inflate, near

TIP_SHARES = (0.25, 0.5, 0.75)
"""How much of the depth to which it sits in the other one the tip loses."""
MAX_TRIED = 4
"""Tips for which the socket is made, those that are the cheapest to cut off."""


@dataclass(frozen=True, eq=False)
class SharedCut:
    """What the two become: `tip` of the one that is cut short, `socket` of the one that takes it in."""

    tip: Cut
    socket: Cut


def shared_cuts(body: m3.Manifold, other: m3.Manifold, gap: float, most: float) -> list[SharedCut]:
    """Ways to cut `body` short, across one of its main axes, where it sits in `other`, and to recess the other.

    Args:
        body: loses its tip, or a side of it.
        other: gets the socket.
        gap: metres left between the two.
        most: cubic metres that `body` may lose.
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
    """A few of them, from the cheapest to the dearest."""
    return [tips[k] for k in np.unique(np.linspace(0, len(tips) - 1, min(MAX_TRIED, len(tips))).astype(int))]
