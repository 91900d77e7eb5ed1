"""`RoboAssembly/ObjectCentric-v0`: the paper's object-centric setting as a Gymnasium environment."""

from __future__ import annotations

from collections.abc import Iterable

from roboassembly.datasets import catalogue
from roboassembly.envs.assembly import AssemblyEnv, FurnitureLike, pieces_of
from roboassembly.envs.observation import CloudsName, ObservationConfig
from roboassembly.furniture.model import PAPER_PARTS, PAPER_POINTS
from roboassembly.planning.problem import Budget
from roboassembly.task.object_centric.task import ObjectCentricOutcome, ObjectCentricTask
from roboassembly.task.part_frames import FramesName
from roboassembly.task.rules.groups import TaskState


class ObjectCentricEnv(AssemblyEnv[ObjectCentricTask, TaskState, ObjectCentricOutcome]):
    """Join parts until the furniture stands; one wrong or infeasible choice ends the episode.

    **Observation**: the `Dict` described in `roboassembly.envs.observation`.

    **Action** `(u, v, k, l, w)`, `MultiDiscrete([P, P, K, K, 6])`: point `k` of part `u` moves to point `l` of
    part `v`, whose group waits with axis `w` up: 0 +z, 1 -z, 2 +x, 3 -x, 4 +y, 5 -y; of the furniture's frame, or with
    `frames="own"` of part `v`.

    **Reward**: 1 for a merge, 4 more for the last one, else 0 and the episode ends.

    **Info**: `verdict` (a value of `ObjectCentricVerdict`: the outcome of the step), `success`, `planning_steps`
    of the step, `groups` (number of groups left), `furniture` (its name), and `action_mask`, the mask of the actions
    that exist; it does not mark right actions. All values are reproducible; `last_outcome` has the planning time.

    **Errors**: an action of the action space that does not exist is a wrong choice: the episode ends with the verdict
    `not_an_action`. An action outside the action space raises `gymnasium.error.InvalidAction`. A
    step before `reset` or after the end of an episode raises `gymnasium.error.ResetNeeded`.

    **Masks**: `info["action_mask"]`. Learners that ask for `action_masks()`, like sb3-contrib's `MaskablePPO`, need
    `roboassembly.envs.wrappers.DiscreteActions` around the environment.

    Args:
        furniture: what to assemble: furniture, or a name or folder as in `roboassembly assemble`. With several, each
            episode draws one, or takes the one that `reset(options={"furniture": index})` asks for.
        max_parts: padding P of spaces, 20 as in the paper by default. Smaller spaces suit small furniture.
        max_points: padding K, 10 as in the paper by default.
        cloud_points: points C of each part's cloud.
        budget: budget of the planner for each step.
        render_mode: None, or `"rgb_array"`: `render` returns a picture of the present state.
        width: width of pictures [pixels].
        height: height of pictures [pixels].
        frames: `aligned`: part frames are parallel to the furniture's, as in the paper. `own`: they are the principal
            axes of each part, in an order and with signs drawn for each episode, and `w` names axes of part `v`.
        clouds: `shared`: equal parts have equal clouds. `resampled`: each part has points of its own, drawn for each
            episode.
        noise: standard deviation of each coordinate of the clouds [m].

    Raises:
        TypeError: furniture that is None or something else that is no furniture, or a padding that is no integer.
        ArgumentError: a value out of range (it is a `ValueError`), or furniture that exceeds the paddings.
        InputError: furniture that is not there.
        gymnasium.error.UnsupportedMode: an unknown render mode.
    """

    components = ("u", "v", "k", "l", "w")

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
        tasks = [ObjectCentricTask(piece, budget) for piece in pieces_of(furniture)]
        super().__init__(
            tasks, ObjectCentricTask.action_branches, max_parts, max_points, cloud_points, render_mode, width, height,
            ObservationConfig(frames, clouds, noise),
        )  # fmt: skip
