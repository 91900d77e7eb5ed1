"""Numbers of parts: the order of PartNet's hierarchy, and a geometric order among parts of one label.

PartNet (Mo et al. 2019) describes a chair as a tree of fixed vocabulary, and numbers its leaves depth first. The paper
numbers parts in this order, so that a number means something from chair to chair: backs come first, then arms, seats
and bases.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import RawPart

_LEAVES = """
chair_head/headrest
chair_back/back_surface/back_single_surface
chair_back/back_surface/back_soft_surface
chair_back/back_surface/back_surface_horizontal_bar
chair_back/back_surface/back_surface_vertical_bar
chair_back/back_frame/back_frame_vertical_bar
chair_back/back_frame/back_frame_horizontal_bar
chair_back/back_connector
chair_back/back_support
chair_arm/arm_sofa_style
chair_arm/arm_near_vertical_bar
chair_arm/arm_horizontal_bar
chair_arm/arm_writing_table
chair_arm/arm_knob
chair_seat/seat_surface/seat_single_surface
chair_seat/seat_surface/seat_soft_surface
chair_seat/seat_surface/seat_surface_bar
chair_seat/seat_frame/seat_frame_bar
chair_seat/seat_support
chair_base/regular_leg_base/leg
chair_base/regular_leg_base/foot
chair_base/regular_leg_base/runner
chair_base/regular_leg_base/bar_stretcher
chair_base/star_leg_base/central_support
chair_base/star_leg_base/star_leg_set/star_leg
chair_base/star_leg_base/star_leg_set/wheel
chair_base/pedestal_base/pedestal
footrest/footrest_surface
table/tabletop
table/table_apron
shelf/top_panel
shelf/back_panel
shelf/frame_board
shelf/shelf
shelf/board
shelf/frame_bar
"""
_NEEDED = {
    "seat_single_surface", "seat_soft_surface", "leg", "foot", "runner", "central_support", "star_leg", "pedestal",
    "tabletop",
}  # fmt: skip
"""Leaves without which a piece would not stand, or serve."""
_PATHS = {path.rsplit("/", 1)[-1]: path for path in _LEAVES.split()}
"""Path of each leaf, in the order of the hierarchy; those of tables and shelves are ours."""
_RANKS = {leaf: rank for rank, leaf in enumerate(_PATHS)}
_ARM = {leaf for leaf, path in _PATHS.items() if path.startswith("chair_arm/")}
"""Leaves below an arm."""
_MIDDLE = 0.02
"""Largest distance from the plane x = 0 at which a part is in the middle [m]."""
_ROW_GAP = 0.25
"""Gap between parts in two rows, as a share of the extent of all parts of their label."""


def label_path(leaf: str) -> str:
    """Return the path of a leaf in PartNet's hierarchy, such as `chair_seat/seat_support`; itself if it is unknown."""
    return _PATHS.get(leaf, leaf)


def is_optional(label: str) -> bool:
    """Return whether furniture may lack a part with this label, a path or a leaf; false for unknown labels."""
    leaf = label.rsplit("/", 1)[-1]
    return leaf in _RANKS and leaf not in _NEEDED


def in_partnet_order(parts: Sequence[RawPart]) -> tuple[RawPart, ...]:
    """Return parts in PartNet's order; those of unknown labels come last.

    Parts of one label are ordered by side (the sitter's left, middle, right), then by rows from front to back and from
    bottom to top, then along the direction in which they are spread most.

    Args:
        parts: parts in the furniture's frame: z up, the sitter looks along -y and has +x on the left hand.
    """
    by_node: dict[tuple[int, float, int, str], list[RawPart]] = {}
    for part in parts:
        by_node.setdefault(_node(part), []).append(part)
    return tuple(by_node[node][i] for node in sorted(by_node) for i in _geometric_order(by_node[node]))


def _node(part: RawPart) -> tuple[int, float, int, str]:
    """Return the place of a part's leaf in the depth-first order. The hierarchy has one node for each arm."""
    leaf = part.label.rsplit("/", 1)[-1]
    rank = _RANKS.get(leaf, len(_RANKS))
    if leaf in _ARM:
        return min(_RANKS[name] for name in _ARM), float(_sides(_centers([part]))[0]), rank, part.label
    return rank, 0.0, rank, part.label


def _centers(parts: Sequence[RawPart]) -> Float[np.ndarray, "n 3"]:
    """Return the middles of the parts' boxes, with axes from left to right, front to back and bottom to top [m]."""
    return np.array([part.mesh.bounds.mean(axis=0) for part in parts]) * (-1.0, 1.0, 1.0)


def _sides(centers: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    """Return -1 for parts on the left, 0 in the middle, 1 on the right."""
    return np.where(np.abs(centers[:, 0]) < _MIDDLE, 0.0, np.sign(centers[:, 0]))


def _geometric_order(parts: Sequence[RawPart]) -> list[int]:
    """Return the indices of parts of one label in geometric order."""
    centers = _centers(parts)
    extent = np.ptp(centers, axis=0)
    rows = [_rows(centers[:, axis], _ROW_GAP * float(extent.max())) for axis in (1, 2)]
    longest = centers[:, int(np.argmax(extent))].round(4)
    return np.lexsort((centers[:, 2], centers[:, 1], centers[:, 0], longest, *rows[::-1], _sides(centers))).tolist()


def _rows(values: Float[np.ndarray, "n"], gap: float) -> Float[np.ndarray, "n"]:
    """Return the number of each value's row; between rows there is at least a gap."""
    order = np.argsort(values, kind="stable")
    steps = np.diff(values[order], prepend=values[order[0]]) > max(gap, 1e-6)
    out = np.empty(len(values))
    out[order] = np.cumsum(steps)
    return out
