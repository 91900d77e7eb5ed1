"""Exact collision test of both robots and what they hold, with the geometry that planning uses.

Contact in physics is between convex pieces, and parts do not collide with parts there. This test has the true meshes,
as dynamic execution has them. Pads may touch what they press. Two groups in hands may touch each other near their
joint.
"""

from __future__ import annotations

from dataclasses import replace

from roboassembly.control.cell import ControlCell
from roboassembly.planning.robot_shapes import WorldCache
from roboassembly.task.full.cell_state import CellState, world_cache


class CollisionTest:
    """Collision test of one episode.

    Args:
        cell: robots and groups of the episode.
    """

    def __init__(self, cell: ControlCell) -> None:
        self._cell = cell
        self._cache: WorldCache = world_cache(cell.furniture)

    def touches(self) -> bool:
        """Return whether a robot or what it holds touches anything that it must not touch."""
        if self._cell.physics.touching:
            return True
        state = self._cell.state().cell_state
        return any(self._robot_touches(state, robot) for robot in (0, 1))

    def _robot_touches(self, state: CellState, robot: int) -> bool:
        cell, physics, other = self._cell, self._cell.physics, 1 - robot
        own, others = physics.grasped(robot), physics.grasped(other)
        if own is not None and own == others:
            state = _without_payload(_without_payload(state, robot), other)
        elif own is not None and others is not None and cell.is_near_joint(own, others):
            state = _without_payload(state, other)
        contact = physics.contact(robot)
        if own is None and contact is not None:
            state = _without_payload(state, other) if contact.body == others else state
            pressed = cell.groups[contact.body].parts
            left = tuple(placed for placed in state.placed if placed.group.parts != pressed)
            posts = tuple(placed.post for placed in state.placed if placed.group.parts == pressed)
            state = replace(state, placed=left, free_posts=(*state.free_posts, *posts))
        world = state.world(cell.furniture, robot, cache=self._cache)
        return not bool(world.free(state.robots[robot].at[None])[0])


def _without_payload(state: CellState, robot: int) -> CellState:
    return state.with_robot(robot, replace(state.robots[robot], payload=None))
