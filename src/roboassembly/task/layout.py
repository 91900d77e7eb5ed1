"""Layout of groups on the ground: rest poses of parts, and free spots between other groups."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, shifted, turn_about_vertical
from roboassembly.task.rules.groups import Circle, Group, TaskState, footprint

GROUND_CLEARANCE = 1e-3
"""Distance between the ground and the lowest point of anything that rests on it [m]."""
SPACING = 0.03
"""Distance between the circles around groups on the ground [m]."""
_TOUCHING = 1e-9
"""Overlap of circles that counts as touching [m]."""
_AT_ONCE = 64
"""Number of places that are tested together."""
_CROWDING = 0.6
"""Share of the floor that the circles of all parts cover at the beginning of an episode."""


def free_spot(circle: Circle, occupied: Sequence[Circle], spacing: float = SPACING) -> Float[np.ndarray, "2"]:
    """Return the place nearest to `circle.center` at which the circle keeps `spacing` from all occupied ones.

    The nearest free point of the plane outside a union of discs is the point itself, its projection onto one of the
    rims, or a point where two rims cross; all are tried.
    """
    if not occupied:
        return circle.center
    centers = np.array([c.center for c in occupied])
    reach = np.array([c.radius for c in occupied]) + circle.radius + spacing
    offset = circle.center - centers
    distance = np.linalg.norm(offset, axis=1)
    if (distance - reach > -_TOUCHING).all():
        return circle.center
    outward = np.where(distance[:, None] > 1e-9, offset / np.maximum(distance, 1e-9)[:, None], np.array([1.0, 0.0]))
    on_rims = centers + outward * reach[:, None]
    nearest = _nearest_free(circle.center, on_rims, centers, reach)
    # A crossing is no nearer than the rims on which it lies.
    within = np.inf if nearest is None else float(np.linalg.norm(nearest - circle.center)) + 1e-6
    close = np.abs(distance - reach) <= within
    places = [*([] if nearest is None else [nearest[None]]), _crossings(centers[close], reach[close])]
    best = _nearest_free(circle.center, np.concatenate(places), centers, reach)
    assert best is not None
    return best


def _nearest_free(
    to: Float[np.ndarray, "2"],
    places: Float[np.ndarray, "k 2"],
    centers: Float[np.ndarray, "n 2"],
    reach: Float[np.ndarray, "n"],
) -> Float[np.ndarray, "2"] | None:
    """Return the nearest of some places outside all discs, the first of equally near ones; None if there is none."""
    order = np.argsort(np.linalg.norm(places - to, axis=1).round(9), kind="stable")
    for start in range(0, len(order), _AT_ONCE):
        some = places[order[start : start + _AT_ONCE]]
        free = (np.linalg.norm(some[:, None] - centers[None], axis=2) - reach > -_TOUCHING).all(axis=1)
        if free.any():
            return some[np.argmax(free)]
    return None


def _crossings(centers: Float[np.ndarray, "n 2"], reach: Float[np.ndarray, "n"]) -> Float[np.ndarray, "k 2"]:
    """Return the points where two circles cross."""
    i, j = np.triu_indices(len(centers), 1)
    between = centers[j] - centers[i]
    d = np.linalg.norm(between, axis=1)
    crossing = (d >= 1e-9) & (d <= reach[i] + reach[j]) & (d >= np.abs(reach[i] - reach[j]))
    i, j, between, d = i[crossing], j[crossing], between[crossing], d[crossing]
    along = (d * d + reach[i] ** 2 - reach[j] ** 2) / (2 * d)
    across = np.sqrt(np.maximum(0.0, reach[i] ** 2 - along * along))
    unit = between / d[:, None]
    normal = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    foot = centers[i] + along[:, None] * unit
    return np.concatenate([foot + across[:, None] * normal, foot - across[:, None] * normal])


def scatter_parts(furniture: Furniture, rng: np.random.Generator) -> TaskState:
    """Return a state with every part alone, at rest on the ground in a random place and pose."""
    placed: list[tuple[SE3, Circle]] = []
    for part in furniture.parts:
        rotations, likely = part.mesh.resting_rotations
        rest = rotations[rng.choice(len(rotations), p=likely)]
        turn = turn_about_vertical(rng.uniform(-np.pi, np.pi)) @ rest
        points = part.mesh.hull_vertices @ turn.T
        placed.append((SE3(turn, np.array([0.0, 0.0, GROUND_CLEARANCE - points[:, 2].min()])), footprint(points)))
    side = float(np.sqrt(sum(np.pi * (c.radius + SPACING) ** 2 for _, c in placed) / _CROWDING))
    occupied: list[Circle] = []
    groups: list[Group | None] = [None] * len(placed)
    # The largest first: small ones still find room between them.
    for part in sorted(range(len(placed)), key=lambda p: -placed[p][1].radius):
        pose, circle = placed[part]
        circle_at = Circle(rng.uniform(-0.5 * side, 0.5 * side, size=2), circle.radius)
        spot = free_spot(circle_at, occupied)
        occupied.append(Circle(spot, circle.radius))
        moved = shifted(pose, np.array([*(spot - circle.center), 0.0]))
        slot = furniture.assembled[part]
        groups[part] = Group((part,), (part,), (slot,), moved * slot.inverse())
    return TaskState(tuple(g for g in groups if g is not None))
