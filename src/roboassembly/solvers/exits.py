"""Ways of sub-assemblies out of each other, planned once for all merges of the same sub-assemblies.

Whether two sub-assemblies come apart depends on their shapes alone: not on the ground, on other groups, on which of the
two moves or on the axis that points up. One plan among the two of them therefore answers for up to twelve merges, and
what holds them together holds larger sub-assemblies around them as well. A plan that fails within its budget proves
nothing; a later round of the search asks again with a larger one, and the last rounds do not ask.
"""

from __future__ import annotations

import zlib
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, align_axis
from roboassembly.geometry.scene import Scene
from roboassembly.planning.mating import MatingProblem, plan_mating
from roboassembly.planning.problem import Budget
from roboassembly.planning.world import CollisionWorld
from roboassembly.solvers.blocking import BlockingGraphs, Parts, contained_in
from roboassembly.task.rules.connections import UP_AXES, Rules
from roboassembly.task.rules.groups import body, center_of_mass, group_in_place, hull_points

Motions = tuple[SE3, ...]
"""Successive motions of a sub-assembly from its place, in the furniture's frame; the first is the identity."""
_MARGIN = 0.1
"""Distance between sub-assemblies that have come apart [m]."""


class ExitPlanner:
    """Ways out among the sub-assemblies of one piece of furniture.

    Args:
        rules: rules about pairs of the furniture.
        graphs: blocking graphs of the furniture.
        seed: seed of the planner.
    """

    def __init__(self, rules: Rules, graphs: BlockingGraphs, seed: int) -> None:
        self._furniture: Furniture = rules.furniture
        self._rules = rules
        self._graphs = graphs
        self._seed = seed
        self._motions: dict[tuple[Parts, Parts], Motions] = {}
        self._stuck: list[tuple[tuple[Parts, Parts], int]] = []
        """Sub-assemblies for which no way was found, and the states that the planner had."""
        self.states = 0
        """Configurations tested for collision so far."""

    def separable(self, u_parts: Parts, v_parts: Parts, budget: int) -> bool:
        """Return whether a way of one of two sub-assemblies out of the other one is found.

        Args:
            u_parts: slots of a sub-assembly.
            v_parts: slots of a sub-assembly that touches it.
            budget: states that the planner may test.
        """
        moving, still = sorted((u_parts, v_parts), key=lambda parts: (len(parts), self._volume(parts), sorted(parts)))
        if (moving, still) in self._motions:
            return True
        if any(had >= budget and contained_in(pair, (moving, still)) for pair, had in self._stuck):
            return False
        if self._leaves_straight(moving, still):
            self._motions[moving, still] = ()
            return True
        # The parts that touch the moving one decide in most cases, and hold it in many larger sub-assemblies, too.
        touching = still & frozenset[int]().union(*(self._furniture.neighbours[p] for p in moving))
        if touching != still and not self.separable(moving, touching, budget):
            return False
        motions = self._planned(moving, still, budget)
        if motions is None:
            self._stuck.append(((moving, still), budget))
            return False
        self._motions[moving, still] = motions
        return True

    def motions(self, moving: Parts, waiting: Parts) -> Motions:
        """Return the motions that take one sub-assembly out of another; empty if none are known, or straight ones."""
        if (moving, waiting) in self._motions:
            return self._motions[moving, waiting]
        return tuple(motion.inverse() for motion in self._motions.get((waiting, moving), ()))

    def _volume(self, parts: Parts) -> float:
        return sum(self._furniture.parts[p].mesh.volume for p in sorted(parts))

    def _leaves_straight(self, moving: Parts, still: Parts) -> bool:
        """Return whether a sub-assembly moves straight out along one of the graphs' directions."""
        return any(self._graphs.leaves(moving, still, index) for index in self._open(moving, still))

    def _open(self, moving: Parts, still: Parts) -> list[int]:
        """Return the indices of the directions along which nothing that touches a sub-assembly blocks it."""
        return [i for i, arcs in enumerate(self._graphs.arcs) if not any(arcs[p] & still for p in moving)]

    def _planned(self, moving: Parts, still: Parts, budget: int) -> Motions | None:
        """Plan a way, with nothing there but the two sub-assemblies; None if the planner finds none.

        Retreats end upward, so they are tried with each axis up before the tree search, as long as they cost less.
        """
        begun = self.states
        for up in UP_AXES:
            if self.states - begun > budget // 2:
                break
            motions = self._planned_upright(moving, still, align_axis(up, UP_AXES[0]), 0)
            if motions is not None:
                return motions
        return self._planned_upright(moving, still, np.eye(3), budget)

    def _planned_upright(
        self, moving: Parts, still: Parts, turn: Float[np.ndarray, "3 3"], budget: int
    ) -> Motions | None:
        """Plan a way with `world_from_furniture` turned as given; without states by retreats and known ways alone."""
        u_group, v_group, merged = (group_in_place(self._furniture, parts) for parts in (moving, still, moving | still))
        origin = center_of_mass(self._furniture, u_group)
        size = float(np.linalg.norm(hull_points(self._furniture, merged) - origin, axis=1).max())
        # The planner stays above the height 0, so there is room below, too.
        lift = SE3(turn, np.array([0.0, 0.0, 3.0 * size + _MARGIN]) - turn @ origin)
        mover = body(self._furniture, u_group.moved_to(lift), "moving", origin=origin, moves=True)
        scene = Scene((mover, body(self._furniture, v_group.moved_to(lift), "waiting")), ground=False)
        world = CollisionWorld(scene, box_axes=turn)
        motions = self._known(moving, still, world, mover.pose, lift)
        if motions is None:
            aside = SE3(np.eye(3), np.array([2.0 * size + _MARGIN, 0.0, 0.0]))
            retreats = (
                *self._rules.retreats(u_group, v_group, merged, turn),
                *self._graphs.directions[self._open(moving, still)],
            )
            problem = MatingProblem(
                start=aside * mover.pose, goal=mover.pose, partner="waiting", retreats=tuple(turn @ d for d in retreats)
            )  # fmt: skip
            path = plan_mating(world, problem, Budget(budget), self._seed_of(moving, still)).path
            motions = tuple(lift.actInv(pose * mover.pose.inverse() * lift) for pose in reversed(path)) or None
        self.states += world.states
        return motions

    def _known(self, moving: Parts, still: Parts, world: CollisionWorld, placed: SE3, lift: SE3) -> Motions | None:
        """Return a way of other sub-assemblies that is free for these, too; None if there is none.

        Args:
            moving: slots that move.
            still: slots that stay.
            world: collision checks of the two.
            placed: pose of the moving body in its place.
            lift: pose of both sub-assemblies in the world.
        """
        for (other, around), motions in self._motions.items():
            if motions and (other == moving or (other >= moving and around >= still)):
                poses = [lift * motion * lift.actInv(placed) for motion in motions]
                if all(world.edge_is_free(a, b) for a, b in pairwise(poses)):
                    return motions
        return None

    def _seed_of(self, moving: Parts, still: Parts) -> int:
        """Return the planner's seed for two sub-assemblies; it does not depend on what was planned before."""
        text = repr((sorted(moving), sorted(still)))
        return int(np.random.SeedSequence([self._seed, zlib.crc32(text.encode())]).generate_state(1)[0])
