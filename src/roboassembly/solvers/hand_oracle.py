"""Oracle of the full setting: it also requires that two grippers can hold the groups that are joined."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.solvers.blocking import Parts
from roboassembly.solvers.hand_joints import HandJoints
from roboassembly.solvers.oracle import Oracle
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask

_MAX_PARTS = 16
"""Largest number of parts: the grasp tests grow exponentially with it."""


class HandOracle(Oracle):
    """Memoized oracle of one piece of furniture that checks grippers, but no arms.

    Two sub-assemblies can be joined if they can be separated along a straight line and if a gripper at each of them
    passes the cheap tests of the full setting. Nothing stands on the ground, so either all `w` are feasible or none.
    """

    def __init__(self, task: FullTask) -> None:
        super().__init__(ObjectCentricTask(task.furniture))
        self._grasp_task = task
        self._grippers = HandJoints(task)

    @property
    def grasp_task(self) -> FullTask:
        """Task whose grasps the oracle tests."""
        return self._grasp_task

    def feasible_along(self, moving: Parts, waiting: Parts, axes: Float[np.ndarray, "w 3"]) -> Bool[np.ndarray, "w"]:
        """Return whether R_a can bring `moving` to `waiting`, which R_b holds; equal values for all axes."""
        joined = len(self.graphs.straight_exits(moving, waiting)) > 0 and self._grippers.join(moving, waiting)
        return np.full(len(axes), joined)


def hand_oracle(furniture: Furniture) -> HandOracle:
    """Return the oracle of a piece of furniture.

    Raises:
        InputError: the furniture does not suit the robots, or has too many parts.
    """
    if len(furniture.parts) > _MAX_PARTS:
        raise InputError(
            f"{furniture.name} has {len(furniture.parts)} parts; the full oracle takes at most {_MAX_PARTS}"
        )
    task = FullTask(furniture)
    task.check_furniture()
    return HandOracle(task)
