"""Ways out of a joint: straight, in two straight motions, or none."""

from __future__ import annotations

import numpy as np
import pytest

import shapes
from roboassembly.audit.full import audit_full_plan
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.mating import distinct_directions
from roboassembly.geometry.poses import shifted
from roboassembly.solvers.full_search import solve_full
from roboassembly.solvers.grasp_choice import choose_grasps
from roboassembly.task.full.failure import Stage
from roboassembly.task.full.grips import Retract, retracts
from roboassembly.task.full.task import FullTask
from roboassembly.task.rules.connections import UP_AXES
from roboassembly.task.rules.groups import group_in_place

UP, AHEAD = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
FRAME, BOARD = 0, 1


def ways_out(furniture: Furniture) -> list[Retract]:
    """Ways of the board out of the frame, in the furniture's frame, without hands."""
    board, frame = (group_in_place(furniture, [part]) for part in (BOARD, FRAME))
    return list(retracts(furniture, board, frame, None, None, distinct_directions([*UP_AXES])))


def distance_along(furniture: Furniture, way: Retract, steps: int = 40) -> float:
    """Least distance between board and frame on the way, by python-fcl [m]."""
    frame = shapes.fcl_object(furniture.parts[FRAME].mesh, furniture.assembled[FRAME])
    at, least = furniture.assembled[BOARD], np.inf
    for motion in way.motions:
        for share in np.linspace(0.0, 1.0, steps):
            pose = shifted(at, share * motion.length * motion.direction)
            board = shapes.fcl_object(furniture.parts[BOARD].mesh, pose)
            least = min(least, shapes.least_distance([board, frame]))
        at = shifted(at, motion.length * motion.direction)
    return least


def test_a_board_without_a_peg_is_drawn_out() -> None:
    furniture = shapes.pegged(peg=False)
    ways = ways_out(furniture)
    assert [len(way.motions) for way in ways] == [1]
    assert np.allclose(ways[0].motions[0].direction, AHEAD)
    # From the frame's back, 169.5 mm behind its front edge.
    assert 0.1695 < ways[0].motions[0].length < 0.25
    assert distance_along(furniture, ways[0]) > 0.0


def test_a_board_on_a_peg_is_lifted_and_drawn_out() -> None:
    furniture = shapes.pegged()
    ways = ways_out(furniture)
    assert ways
    for way in ways:
        lift, draw = way.motions
        assert np.allclose(lift.direction, UP)
        assert np.allclose(draw.direction, AHEAD)
        # Above the peg, 20 mm high, and below the roof, 55 mm above the board.
        assert 0.0195 < lift.length < 0.055
        assert draw.length > 0.1695
        assert distance_along(furniture, way) > 0.0


def test_a_board_behind_a_front_does_not_leave() -> None:
    assert not ways_out(shapes.pegged(front=True))


def test_robots_mate_in_two_motions() -> None:
    pytest.importorskip("fcl")
    furniture = choose_grasps(shapes.pegged()).furniture
    plan = solve_full(furniture, 0, task=FullTask(furniture)).plan
    assert plan.success
    mate = next(segment for segment in plan.steps[0].segments if segment.stage is Stage.MATE)
    start, bend, end = (np.array(q[:2]) for q in (mate.path[0], mate.path[-2], mate.path[-1]))
    # The platform drives in, then aside: the joint is planned with both motions level.
    assert abs(float((bend - start) @ (end - bend))) < 0.1 * np.linalg.norm(bend - start) * np.linalg.norm(end - bend)
    assert audit_full_plan(plan, 0.1).passed
