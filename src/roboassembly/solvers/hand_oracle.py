"""The oracle of the full setting: what can still be finished if two hands have to hold all that is joined."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from roboassembly.geometry.poses import SE3
from roboassembly.solvers.blocking import Parts
from roboassembly.solvers.options import End, fitting
from roboassembly.solvers.oracle import Oracle
from roboassembly.task.full.grips import MateGrasp
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.rules.connections import UP_AXES
from roboassembly.task.rules.groups import Group, TaskState


class HandOracle(Oracle):
    """Knows one piece of furniture by heart, and where hands find room. Arms it does not ask.

    Two sub-assemblies can be joined if they leave each other straight and two hands, one at each, pass the cheap tests
    of the full setting. As nothing stands on the ground, there are no ways up: either all `w` are possible or none.
    """

    def __init__(self, task: FullTask) -> None:
        super().__init__(ObjectCentricTask(task.furniture))
        self.full = task
        self._held: dict[tuple[Parts, Parts], bool] = {}
        self._worked: dict[frozenset[End], tuple[int, int]] = {}
        """Of two points the hands that joined them last, at the part that comes first."""

    def feasible_w(self, moving: Parts, waiting: Parts) -> Bool[np.ndarray, "6"]:
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
        if any(self._again(state, one, two) for one, two in pairs):
            return True
        found = next(fitting(self.full, state, pairs, in_turn=True), None)
        if found is not None:
            u, v, k, m, g_a, g_b = found
            self._worked[frozenset(((u, k), (v, m)))] = (g_a, g_b) if u < v else (g_b, g_a)
        return found is not None

    def _again(self, state: TaskState, one: End, two: End) -> bool:
        """Whether the hands that joined two points before do so here: a hand that has room in one group mostly has in
        its like."""
        worked = self._worked.get(frozenset((one, two)))
        if worked is None:
            return False
        g_a, g_b = worked if one[0] < two[0] else worked[::-1]
        return isinstance(self.full.mate_grasp(state, (one[0], two[0], one[1], two[1], g_a, g_b)), MateGrasp)

    def _group(self, slots: Parts) -> Group:
        """Parts in their own slots."""
        parts = tuple(sorted(slots))
        return Group(parts, parts, tuple(self.furniture.assembled[p] for p in parts), SE3.Identity())
