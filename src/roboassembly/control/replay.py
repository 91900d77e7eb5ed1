"""Planned merges as commands at the rate of control, to be replayed or recorded in `RoboAssembly/Control-v0`.

A plan's segments are timed as in dynamic execution; commands are their configurations every 50 ms. A hand closes until
it holds what is between its pads, and a merge waits until the joint has closed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from jaxtyping import Float

from roboassembly.control.cell import ControlCell
from roboassembly.control.controls import Commands
from roboassembly.robots.gripper import MAX_OPENING
from roboassembly.simulation.control_physics import SUBSTEPS
from roboassembly.task.full.cell_state import Segment
from roboassembly.task.full.failure import Stage
from roboassembly.task.full.timing import timed_motion

_SETTLE = 2
"""Control steps for which a robot waits at the end of a segment."""
_NEAR = 0.01
"""Difference up to which a command is carried out [m, rad]."""
_MOST_REPEATS = 20
"""Largest number of control steps of one command."""
_GRIP_STEPS, _JOIN_STEPS, _OPEN_STEPS = 30, 40, 8
"""Control steps for which a hand closes at most, a merge waits for its joint at most, and a hand opens."""


def commands_of(segments: Sequence[Segment], cell: ControlCell) -> Iterator[Commands]:
    """Yield the commands that carry out planned segments, one for each control step.

    The caller carries each out before it takes the next: hands and joints are looked at in between. A command that the
    limits of the control cut is repeated until it is reached. Commands go on after a grip or a joint that fails, as the
    plan has it.

    Args:
        segments: of a planned merge, from the cell's present state on.
        cell: where they are carried out.
    """
    targets = np.array(cell.physics.commands)
    openings = np.array([robot.opening for robot in segments[0].before.robots])
    for index, segment in enumerate(segments):
        robot = segment.robot
        if segment.stage is Stage.DRIVE_TO_GROUP:
            openings[robot] = min(segment.before.robots[robot].opening, MAX_OPENING)
        for q in _sampled(segment, cell):
            targets[robot] = q
            # Some controls have slower limits than the joints; what lags behind finds no way back on its own.
            yield targets.copy(), openings.copy()
            yield from _repeat(targets, openings, _MOST_REPEATS - 1, lambda: _reached(targets, cell))
        following = segments[index + 1].before if index + 1 < len(segments) else segment.after
        if segment.stage is Stage.APPROACH:
            openings[robot] = 0.0
            yield from _repeat(targets, openings, _GRIP_STEPS, lambda: cell.physics.grasped(robot) is not None)  # noqa: B023
        elif segment.stage is Stage.MATE:
            count = len(cell.groups)
            yield from _repeat(targets, openings, _JOIN_STEPS, lambda: len(cell.groups) < count)  # noqa: B023
            openings[0] = following.robots[0].opening
            yield from _repeat(targets, openings, _OPEN_STEPS)
        elif segment.stage is Stage.SET_DOWN:
            openings[robot] = following.robots[robot].opening
            yield from _repeat(targets, openings, _OPEN_STEPS)


def _sampled(segment: Segment, cell: ControlCell) -> Iterator[Float[np.ndarray, "10"]]:
    """Yield the configurations of a segment every 50 ms, and its end for as long as the robot settles."""
    payload = segment.before.robots[segment.robot].payload_shapes(cell.furniture)
    rows = timed_motion(segment.stage, segment.path, payload, cell.cell.density).ticks().position
    yield from rows[SUBSTEPS - 1 :: SUBSTEPS]
    for _ in range(_SETTLE):
        yield segment.path[-1]


def _reached(targets: Float[np.ndarray, "2 10"], cell: ControlCell) -> bool:
    """Return whether both robots are told to be where they should be; platforms may have turned fully."""
    left = targets - cell.physics.commands
    left[:, 2] = np.sin(0.5 * left[:, 2])
    return bool(np.abs(left).max() < _NEAR)


def _repeat(
    targets: Float[np.ndarray, "2 10"],
    openings: Float[np.ndarray, "2"],
    steps: int,
    done: Callable[[], bool] = lambda: False,
) -> Iterator[Commands]:
    """Yield the same commands for some control steps, or until something is done."""
    for _ in range(steps):
        if done():
            return
        yield targets.copy(), openings.copy()
