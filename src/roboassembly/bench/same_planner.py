"""Our planner with a peer's collision checks, one state at a time; it measures the effect of the collision engine.

A tree search in a tight connection spends its whole budget, so a ratio of planning times depends on the planner as much
as on the checks. Here the planner is the same, including retreats, and only the checks differ: the peers have no box
tests over stretches and no batches.
"""

from __future__ import annotations

import time

import numpy as np
from jaxtyping import Bool, Float
from ompl import base

from roboassembly.bench.merges import BenchMerge
from roboassembly.bench.peers import IsFree, Peer, Run, SE3State
from roboassembly.geometry.poses import SE3
from roboassembly.geometry.scene import Scene
from roboassembly.planning.mating import plan_mating
from roboassembly.planning.problem import Budget
from roboassembly.planning.world import CollisionWorld


class PeerWorld(CollisionWorld):
    """Collision world that tests every state with a peer."""

    def __init__(self, scene: Scene, box_axes: Float[np.ndarray, "3 3"], is_free: IsFree) -> None:
        super().__init__(scene, box_axes)
        self._is_free = is_free
        self._state: SE3State = base.SE3StateSpace().allocState()

    def first_collision(self, configurations: Float[np.ndarray, "7 n"]) -> int | None:
        """Return the index of the first configuration in collision, testing one state at a time."""
        state, rotation, is_free = self._state, self._state.rotation(), self._is_free
        for index, (x, y, z, qx, qy, qz, qw) in enumerate(configurations.T.tolist()):
            state.setXYZ(x, y, z)
            rotation.x, rotation.y, rotation.z, rotation.w = qx, qy, qz, qw
            if not is_free(state):
                self.states += index + 1
                return index
        self.states += configurations.shape[1]
        return None

    def boxes_free(self, start: SE3, end: SE3, cuts: Float[np.ndarray, "k"], angle: float) -> Bool[np.ndarray, "k-1"]:
        """Return False for every stretch, so that the peer tests every state."""
        return np.zeros(len(cuts) - 1, dtype=bool)


def plan_over_peer(peer: Peer, merge: BenchMerge, budget: Budget) -> Run:
    """Run `plan_mating` with the peer's checks; the time includes building the scene."""
    begun = time.perf_counter()
    world = PeerWorld(merge.scene, merge.box_axes, peer.set_up(merge.scene))
    result = plan_mating(world, merge.problem, budget, merge.seed)
    return Run(result.solved, result.states, time.perf_counter() - begun)
