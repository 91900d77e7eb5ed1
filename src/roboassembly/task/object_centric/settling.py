"""Settling: a released group falls and comes to rest on the ground, by physics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, transform_points
from roboassembly.task.layout import GROUND_CLEARANCE, free_spot
from roboassembly.task.plans.plan import SETTLING_INTERVAL
from roboassembly.task.rules.groups import Circle, Group, body, center_of_mass, footprint, hull_points


def settle_group(furniture: Furniture, group: Group, occupied: Sequence[Circle] = ()) -> tuple[tuple[SE3, ...], Group]:
    """Drop a group, let it settle, and lay it down at the nearest free spot, `GROUND_CLEARANCE` above the ground.

    Args:
        furniture: furniture of the group.
        group: group where it is released.
        occupied: circles of all other groups on the ground.

    Returns:
        Motions of the world that take the group to rest, every `SETTLING_INTERVAL` seconds, the first the identity;
        and the group at rest.
    """
    # Physics takes a tenth of the time in which a command starts, and nothing has fallen before the first merge.
    from roboassembly.simulation.settle import settle

    falling = body(furniture, group, "falling", origin=center_of_mass(furniture, group), moves=True)
    motions = [pose * falling.pose.inverse() for pose in settle(falling, SETTLING_INTERVAL).poses]
    rested = group.moved_to(motions[-1] * group.world_from_furniture)
    points = transform_points(rested.world_from_furniture, hull_points(furniture, rested))
    circle = footprint(points)
    lift = GROUND_CLEARANCE - float(points[:, 2].min())
    nudge = SE3(np.eye(3), np.array([*(free_spot(circle, occupied) - circle.center), lift]))
    motions[-1] = nudge * motions[-1]
    return tuple(motions), rested.moved_to(nudge * rested.world_from_furniture)
