"""Demonstrator: plans merge by merge from the present state, and turns each plan into actions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float32

from roboassembly.control.env import ControlEnv
from roboassembly.control.replay import commands_of
from roboassembly.solvers.full_search import MergePlanner
from roboassembly.task.plans.full_plan import FullStep


class Demonstrator:
    """Acts in an episode of an environment.

    It looks at the true state of the cell, which no observation of a policy has under noise. After each merge it plans
    the next one from where everything is by then, so that errors of execution do not add up.

    Args:
        env: environment that has been reset.
        seed: seed of the planner.
    """

    def __init__(self, env: ControlEnv, seed: int) -> None:
        self._env = env
        self._planner = MergePlanner(env.task, seed)
        self.failure = ""
        """Why it stopped acting; empty if it did not."""
        self.planned = 0
        """Number of merges planned so far."""

    def actions(self) -> Iterator[Float32[np.ndarray, "22"]]:
        """Yield one action after the other; the caller carries out each, and stops when the episode is over.

        It ends early with a `failure` if no merge can be planned, or if one that was carried out joined nothing.
        """
        env = self._env
        while True:
            step = self._next_step()
            if step is None:
                self.failure = "no_plan"
                return
            self.planned += 1
            groups = len(env.cell.groups)
            for targets, openings in commands_of(step.segments, env.cell):
                yield env.codec.encode(targets, openings, env.cell.physics.commands)
            if len(env.cell.groups) == groups:
                self.failure = "not_joined"
                return

    def _next_step(self) -> FullStep | None:
        env = self._env
        if any(env.cell.physics.grasped(robot) is not None for robot in (0, 1)):
            return None
        if env.merge is None:
            return self._planner.next_step(env.state)
        first, second = (frozenset(parts) for parts in env.merge.groups)
        return self._planner.step_that_joins(env.state, first, second)
