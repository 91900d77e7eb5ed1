"""`RoboAssembly/Full-v0`: two mobile Frankas assemble furniture, as a Gymnasium environment."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from roboassembly.datasets import catalogue
from roboassembly.envs.assembly import AssemblyEnv, FurnitureLike, pieces_of
from roboassembly.envs.observation import CloudsName, ObservationConfig
from roboassembly.envs.pictures import Item
from roboassembly.furniture.model import PAPER_PARTS, PAPER_POINTS
from roboassembly.geometry.poses import SE3
from roboassembly.planning.problem import Budget
from roboassembly.rendering.colors import Role
from roboassembly.robots.body import placed
from roboassembly.task.full.posts import post_mesh
from roboassembly.task.full.task import FullOutcome, FullTask
from roboassembly.task.part_frames import FramesName
from roboassembly.task.plans.full_plan import FullState


class FullEnv(AssemblyEnv[FullTask, FullState, FullOutcome]):
    """Join parts with two robots until the furniture stands; one wrong or infeasible choice ends the episode.

    **Observation**: the `Dict` described in `roboassembly.envs.observation`.

    **Action** `(u, v, k, l, g_a, g_b)`, `MultiDiscrete([P, P, K, K, 8, 8])`: robot R_a takes part `u` by grasp `g_a`,
    R_b takes part `v` by grasp `g_b`, and the robots bring point `k` of `u` to point `l` of `v`. Grasps 0 to 3 are the
    four directions of the part's first grasp region, 4 to 7 those of its second.

    **Reward**: 1 for a merge, 4 more for the last one, else 0 and the episode ends.

    **Info**: the keys of `ObjectCentricEnv`, with `verdict` a value of `FullVerdict`. In addition `stage`, the stage
    that failed (a value of `Stage`, "" if none); `robot`, the robot that failed (0, 1, or -1 if none); and `density`,
    the density at which a robot can carry the whole furniture [kg/m³].

    **Errors** and **masks**: see `ObjectCentricEnv`.

    Args:
        furniture: what to assemble: furniture, or a name or folder as in `roboassembly assemble`. With several, each
            episode draws one, or takes the one that `reset(options={"furniture": index})` asks for.
        max_parts: padding P of spaces, 20 as in the paper by default. Smaller spaces suit small furniture.
        max_points: padding K, 10 as in the paper by default.
        cloud_points: points C of each part's cloud.
        budget: budget of each path.
        render_mode: None, or `"rgb_array"`: `render` returns a picture of the present state.
        width: width of pictures [pixels].
        height: height of pictures [pixels].
        frames: `aligned`: part frames are parallel to the furniture's, as in the paper. `own`: they are the principal
            axes of each part, in an order and with signs drawn for each episode.
        clouds: `shared`: equal parts have equal clouds. `resampled`: each part has points of its own, drawn for each
            episode.
        noise: standard deviation of each coordinate of the clouds [m].

    Raises:
        TypeError: furniture that is None or something else that is no furniture, or a padding that is no integer.
        ArgumentError: a value out of range (it is a `ValueError`), or furniture that exceeds the paddings.
        InputError: furniture that is not there. `reset` raises it for furniture that does not suit the cell: a part
            that no hand can hold, or too large.
        gymnasium.error.UnsupportedMode: an unknown render mode.
    """

    components = ("u", "v", "k", "l", "g_a", "g_b")

    def __init__(
        self,
        furniture: FurnitureLike | Iterable[FurnitureLike] = catalogue.DEFAULT,
        *,
        max_parts: int = PAPER_PARTS,
        max_points: int = PAPER_POINTS,
        cloud_points: int = 128,
        budget: Budget | None = None,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        frames: FramesName = "aligned",
        clouds: CloudsName = "shared",
        noise: float = 0.0,
    ) -> None:
        tasks = [FullTask(piece, budget) for piece in pieces_of(furniture)]
        super().__init__(
            tasks, FullTask.action_branches, max_parts, max_points, cloud_points, render_mode, width, height,
            ObservationConfig(frames, clouds, noise),
        )  # fmt: skip

    def _items(self) -> list[Item]:
        """Return the parts, both robots, and the raised posts."""
        state, items = self.state.cell_state, super()._items()
        for robot, role in zip(state.robots, (Role.ROBOT_A, Role.ROBOT_B), strict=True):
            items += [Item(link.mesh, pose, role) for link, pose in placed(robot.at, robot.opening)]
        # The number of posts is constant, so that the renderer is not made anew when a post sinks.
        posts: list[SE3 | None] = [SE3(np.eye(3), stand.top) for stand in state.posts]
        posts += [None] * (-len(posts) % len(self.task.furniture.parts))
        return [*items, *(Item(post_mesh(), pose, Role.POST, framed=False) for pose in posts)]

    def _info(self, verdict: str, planning_steps: int) -> dict[str, Any]:
        info = super()._info(verdict, planning_steps)
        return {**info, **_failed(self._outcome), "density": self.state.cell.density}


def _failed(outcome: FullOutcome | None) -> dict[str, Any]:
    failure = None if outcome is None else outcome.failure
    if failure is None or failure.stage is None:
        return {"stage": "", "robot": -1}
    return {"stage": failure.stage.value, "robot": -1 if failure.robot is None else failure.robot}
