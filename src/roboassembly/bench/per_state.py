"""Time of one collision test, on the same configurations for all: along edges that RRT-Connect tests."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.bench.merges import BenchMerge
from roboassembly.bench.peers import Peer, configuration_state, state_space
from roboassembly.geometry.poses import SE3, interpolate, rotation_angle
from roboassembly.planning.problem import Budget
from roboassembly.planning.rrt import rrt_connect
from roboassembly.planning.world import ANGULAR_RESOLUTION, RESOLUTION, CollisionWorld


@dataclass(frozen=True)
class StateTime:
    """Time for a number of configurations."""

    states: int
    seconds: float

    @property
    def microseconds(self) -> float:
        """Mean time of a configuration [µs]."""
        return 1e6 * self.seconds / max(1, self.states)


class _Recorder(CollisionWorld):
    """Collision world that records the tested edges."""

    def __init__(self, merge: BenchMerge) -> None:
        super().__init__(merge.scene, merge.box_axes)
        self.edges: list[tuple[SE3, SE3]] = []

    def edge_is_free(self, start: SE3, end: SE3) -> bool:
        self.edges.append((start, end))
        return super().edge_is_free(start, end)


def sampled_edges(merge: BenchMerge, states: int) -> list[Float[np.ndarray, "7 n"]]:
    """Return the configurations of edges, about `states` in total; an edge ends with its first collision."""
    recorder = _Recorder(merge)
    rrt_connect(
        recorder, merge.problem.start, [merge.problem.goal], merge.bounds, Budget(states=2 * states), merge.seed
    )
    edges: list[Float[np.ndarray, "7 n"]] = []
    total = 0
    for start, end in recorder.edges:
        angle = rotation_angle(start.rotation.T @ end.rotation)
        length = float(np.linalg.norm(end.translation - start.translation)) + angle * recorder.radius
        steps = max(1, int(np.ceil(max(length / RESOLUTION, angle / ANGULAR_RESOLUTION))))
        configurations = interpolate(start, end, np.arange(1, steps + 1) / steps)
        hit = recorder.first_collision(configurations)
        edges.append(np.asfortranarray(configurations if hit is None else configurations[:, : hit + 1]))
        total += edges[-1].shape[1]
        if total >= states:
            break
    return edges


def time_ours(merge: BenchMerge, edges: Sequence[Float[np.ndarray, "7 n"]]) -> StateTime:
    """Time `CollisionWorld.first_collision`, one call per edge."""
    world = merge.world()
    world.is_free(merge.problem.start)
    before = world.states
    begun = time.perf_counter()
    for edge in edges:
        world.first_collision(edge)
    return StateTime(world.states - before, time.perf_counter() - begun)


def time_peer(peer: Peer, merge: BenchMerge, edges: Sequence[Float[np.ndarray, "7 n"]]) -> StateTime:
    """Time the validity callback, one call per configuration."""
    is_free = peer.set_up(merge.scene)
    space = state_space(merge.bounds, (merge.problem.start, merge.problem.goal))
    states = [configuration_state(space, column) for edge in edges for column in edge.T]
    begun = time.perf_counter()
    for state in states:
        is_free(state)
    return StateTime(len(states), time.perf_counter() - begun)
