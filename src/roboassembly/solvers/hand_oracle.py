"""The oracle of the full setting: what can still be finished if two hands have to hold all that is joined."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from roboassembly.poses import SE3
from roboassembly.solvers.blocking import Parts
from roboassembly.solvers.options import fitting
from roboassembly.solvers.oracle import Oracle
from roboassembly.task.full import FullTask
from roboassembly.task.groups import Group, TaskState
from roboassembly.task.object_centric import ObjectCentricTask
from roboassembly.task.rules import UP_AXES


class HandOracle(Oracle):
    """Knows one piece of furniture by heart, and where hands find room. Arms it does not ask.

    Two sub-assemblies can be joined if they leave each other straight and two hands, one at each, pass the cheap tests
    of the full setting. As nothing stands on the ground, there are no ways up: either all `w` are possible or none.
    """

    def __init__(self, task: FullTask) -> None:
        super().__init__(ObjectCentricTask(task.furniture))
        self.full = task
        self._held: dict[tuple[Parts, Parts], bool] = {}

    def ways(self, moving: Parts, waiting: Parts) -> Bool[np.ndarray, "6"]:
        """Whether R_a can bring `moving` to `waiting`, which R_b holds; six times the same."""
        key = (moving, waiting)
        if key not in self._held:
            self._held[key] = len(self.exits(moving, waiting)) > 0 and self._hands_join(moving, waiting)
        return np.full(len(UP_AXES), self._held[key])

    def _hands_join(self, moving: Parts, waiting: Parts) -> bool:
        pairs = []
        for c in self.furniture.connections:
            a, b = (c.part_a, c.point_a), (c.part_b, c.point_b)
            if c.part_a in moving and c.part_b in waiting:
                pairs.append((a, b))
            elif c.part_b in moving and c.part_a in waiting:
                pairs.append((b, a))
        state = TaskState((self._group(moving), self._group(waiting)))
        return next(fitting(self.full, state, pairs, in_turn=True), None) is not None

    def _group(self, slots: Parts) -> Group:
        """Parts in their own slots."""
        parts = tuple(sorted(slots))
        return Group(parts, parts, tuple(self.furniture.assembled[p] for p in parts), SE3.Identity())
