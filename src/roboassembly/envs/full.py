"""`RoboAssembly/Full-v0`: two mobile Frankas assemble furniture, as a Gymnasium environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool

from roboassembly.envs.assembly import AssemblyEnv, existing_pairs, pieces_of
from roboassembly.furniture import catalogue
from roboassembly.furniture.model import MAX_PARTS, MAX_POINTS, Furniture
from roboassembly.planning.problem import Budget
from roboassembly.task.full import FullOutcome, FullTask
from roboassembly.task.full_plan import FullState
from roboassembly.task.rules import GRASPS


class FullEnv(AssemblyEnv[FullTask, FullState, FullOutcome]):
    """Join parts with two robots until the furniture stands; one wrong or infeasible choice ends the episode.

    **Observation**: the `Dict` described in `roboassembly.envs.observation`.

    **Action** `(u, v, k, l, g_a, g_b)`, `MultiDiscrete([P, P, K, K, 8, 8])`: robot R_a takes part `u` by grasp `g_a`,
    R_b takes part `v` by grasp `g_b`, and point `k` of `u` is brought onto point `l` of `v`. Grasps 0 to 3 are the
    four directions of the part's first grasp region, 4 to 7 those of its second.

    **Reward**: 1 for a merge, 4 more for the last one, else 0 and the episode ends.

    **Info**: as of `ObjectCentricEnv`, with `verdict` a value of `FullVerdict`; besides `leg`, in which the step
    failed (empty if it did not), and `density`, kg/m³, at which a robot can carry the whole.

    Args:
        furniture: what to assemble: furniture, or a name or folder as in `roboassembly assemble`. Of several, each
            episode draws one, or takes the one that `reset(options={"furniture": index})` asks for.
        max_parts: padding P of spaces, 20 as in the paper by default. Smaller spaces suit small furniture.
        max_points: padding K, 10 as in the paper by default.
        cloud_points: points C of each part's cloud.
        budget: of each path.

    Raises:
        InputError: furniture that exceeds the paddings, or none at all. `reset` raises it for furniture that does not
            suit the cell: a part that no hand can hold, or too large.
    """

    def __init__(
        self,
        furniture: Furniture | str | Sequence[Furniture | str] = catalogue.DEFAULT,
        *,
        max_parts: int = MAX_PARTS,
        max_points: int = MAX_POINTS,
        cloud_points: int = 128,
        budget: Budget | None = None,
    ) -> None:
        tasks = [FullTask(piece, budget) for piece in pieces_of(furniture)]
        super().__init__(tasks, FullTask.ways, max_parts, max_points, cloud_points)

    def _existing(self, task: FullTask, state: FullState) -> Bool[np.ndarray, "P P K K 8 8"]:
        return existing_actions(task, state, *self._padding)

    def _info(self, verdict: str, planning_steps: int) -> dict[str, Any]:
        told = super()._info(verdict, planning_steps)
        return {**told, "leg": self._outcome.leg if self._outcome else "", "density": self.state.cell.density}


def existing_actions(
    task: FullTask, state: FullState, max_parts: int = MAX_PARTS, max_points: int = MAX_POINTS
) -> Bool[np.ndarray, "P P K K 8 8"]:
    """The mask of actions that exist in a state, indexed by `(u, v, k, l, g_a, g_b)`."""
    pairs = existing_pairs(task.rules, state.groups, max_parts, max_points)
    grasps = np.zeros((max_parts, GRASPS), bool)
    for index, part in enumerate(task.furniture.parts):
        grasps[index, : 4 * len(part.grasps)] = True
    hands = grasps[:, None, :, None] & grasps[None, :, None, :]
    return pairs[..., None, None] & hands[:, :, None, None]
