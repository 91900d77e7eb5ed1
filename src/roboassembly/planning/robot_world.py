"""Collision checks of a mobile Franka, with or without a load in its hand, among still bodies, for whole edges.

Edges are certified coarsely first. A configuration in which all pairs of shapes are at least as far apart as they can
approach each other on the way to any point of a stretch certifies the whole stretch. Stretches that fail are cut and
tested with smaller margins, finally by exact tests every `RESOLUTION`. Each pair has its own margin, since the base
moves little where the hand moves far.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise

import coal
import numpy as np
from jaxtyping import Bool, Float, Int

from roboassembly.geometry.poses import SE3, transform_points
from roboassembly.geometry.scene import Body, Shape
from roboassembly.planning.motion_bounds import MotionBounds
from roboassembly.planning.robot_shapes import Arrangement, Configurations, Margins, WorldCache, growing_batches
from roboassembly.planning.world import RESOLUTION
from roboassembly.robots.body import HAND, hand_links, links
from roboassembly.robots.kinematics import arm

_LEVELS = ((0.06, True), (0.015, False))
"""Largest margins of successive tests [m], and whether they test hulls alone."""


@dataclass
class Tally:
    """Count of tested configurations, which outlives the world that it counts for, as worlds occupy megabytes."""

    states: int = 0


class RobotWorld:
    """Planning model of one robot among still bodies.

    Args:
        still: bodies that do not move, including those of the other robot.
        opening: distance between the finger pads [m].
        load: shapes in the hand, with `tips_from_mesh` as their `body_from_mesh`; not tested against the hand, whose
            pads touch it.
        lands: whether the load may touch the ground.
        tally: count of tested configurations; a new one if None.
        cache: shapes of other worlds; none if None.
    """

    def __init__(
        self,
        still: Sequence[Body],
        opening: float,
        load: Sequence[Shape] = (),
        lands: bool = False,
        tally: Tally | None = None,
        cache: WorldCache | None = None,
    ) -> None:
        self.tally = tally or Tally()
        tips = SE3(*arm().tips)
        hand = hand_links(opening)
        loads = [(s, tips * s.body_from_mesh) for s in load]
        around = [(s, b.pose * s.body_from_mesh) for b in still for s in b.shapes]
        self._tests = Arrangement([pose for _, pose in hand], loads, around, lands, cache)
        wrist = [link.mesh.convex for link in links() if link.carrier == HAND]
        self._hopeless = any(_touch(a, s.geometry, pose) for a in wrist for s, pose in loads)
        self._carried = [(x.mesh, pose) for x, pose in (*hand, *loads)]

    @cached_property
    def _bounds(self) -> MotionBounds:
        points = [link.mesh.hull_vertices for link in links()]
        points += [transform_points(pose, mesh.hull_vertices) for mesh, pose in self._carried]
        return MotionBounds(self._tests.carriers, points, self._tests.own_pairs)

    @property
    def states(self) -> int:
        """Number of configurations tested so far."""
        return self.tally.states

    def free(self, q: Configurations, *, clearance: float = 0.0) -> Bool[np.ndarray, "n"]:
        """Return whether each configuration is free, by exact tests.

        Args:
            q: configurations.
            clearance: distance that the surroundings keep [m].
        """
        self.tally.states += len(q)
        return ~self._tests.hits(self._tests.contact_margins(clearance), q) & (not self._hopeless)

    def each_free(self, q: Configurations) -> Iterator[Float[np.ndarray, "10"]]:
        """Yield the configurations that are free, in their order; those after the last one taken are not all tested."""
        for begin, end in pairwise(np.cumsum([0, *growing_batches(len(q))]).tolist()):
            yield from q[begin:end][self.free(q[begin:end])]

    def edge_is_free(self, a: Float[np.ndarray, "10"], b: Float[np.ndarray, "10"], *, clearance: float = 0.0) -> bool:
        """Return whether every configuration from `a` (assumed free) to `b` is free; see `path_is_free`."""
        return self.path_is_free((a, b), clearance=clearance)

    def path_is_free(self, path: Sequence[Float[np.ndarray, "10"]], *, clearance: float = 0.0) -> bool:
        """Return whether every configuration of a path is free; its edges are linear.

        Args:
            path: way-points; the first is assumed free.
            clearance: distance that the surroundings keep [m].
        """
        ends = np.array(path)
        steps = np.diff(ends, axis=0)
        around, own = self._bounds.along(steps)
        moved = np.maximum(around.max(axis=1, initial=0.0), own.max(axis=1, initial=0.0))
        exact = self._tests.contact_margins(clearance)
        some = np.flatnonzero(moved > 1e-9)
        pieces = _Pieces(some, np.zeros(len(some)), np.ones(len(some)))
        for margin, coarse in _LEVELS:
            if not len(pieces.edge):
                return True
            pieces = pieces.cut(moved, 2.0 * margin)
            half = np.zeros((len(steps), 1))
            np.maximum.at(half[:, 0], pieces.edge, 0.5 * (pieces.high - pieces.low))
            margins = self._tests.margins(
                (half * around).max(axis=0) + clearance, (half * own).max(axis=0, initial=0.0)
            )
            near = self._near(margins, coarse, exact, pieces.at(ends, 0.5))
            if near is None:
                return False
            pieces = pieces.chosen(near)
        return not self._any_hit(exact, pieces.cut(moved, RESOLUTION).at(ends, 1.0))

    def _near(self, margins: Margins, coarse: bool, exact: Margins, q: Configurations) -> Bool[np.ndarray, "n"] | None:
        """Return which configurations fail a test with margins; None as soon as one fails the exact test.

        The middle of the path comes first, so that a collision is found early.
        """
        near, order = np.zeros(len(q), bool), _middle_first(len(q))
        for begin, end in pairwise(np.cumsum([0, *growing_batches(len(q))]).tolist()):
            some = order[begin:end]
            self.tally.states += len(some)
            near[some] = self._tests.hits(margins, q[some], coarse=coarse)
            if near[some].any() and self._any_hit(exact, q[some[near[some]]]):
                return None
        return near

    def _any_hit(self, margins: Margins, q: Configurations) -> bool:
        hits = self._tests.hits(margins, q, first_only=True)
        self.tally.states += int(np.argmax(hits)) + 1 if hits.any() else len(q)
        return bool(hits.any())


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Pieces of the edges of a path."""

    edge: Int[np.ndarray, "n"]
    low: Float[np.ndarray, "n"]
    """Fraction of the edge at which each begins."""
    high: Float[np.ndarray, "n"]
    """Fraction of the edge at which each ends."""

    def cut(self, moved: Float[np.ndarray, "e"], spacing: float) -> _Pieces:
        """Return equal parts of the pieces, none of which moves more than a spacing.

        Args:
            moved: largest motion along each edge [m].
            spacing: largest motion along a part [m].
        """
        length = self.high - self.low
        counts = np.maximum(1, np.ceil(length * moved[self.edge] / spacing)).astype(int)
        which = np.repeat(np.arange(len(counts)), counts)
        part = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
        size = (length / counts)[which]
        low = self.low[which] + part * size
        return _Pieces(self.edge[which], low, np.where(part + 1 == counts[which], self.high[which], low + size))

    def chosen(self, which: Bool[np.ndarray, "n"]) -> _Pieces:
        """Return some of the pieces."""
        return _Pieces(self.edge[which], self.low[which], self.high[which])

    def at(self, path: Float[np.ndarray, "k 10"], fraction: float) -> Configurations:
        """Return the configuration at a fraction of each piece."""
        along = (1.0 - fraction) * self.low + fraction * self.high
        start = path[self.edge]
        return start + along[:, None] * (path[self.edge + 1] - start)


@cache
def _middle_first(n: int) -> Int[np.ndarray, "n"]:
    """Return the numbers below n with the middle first, then those between."""
    return np.array(sorted(range(n), key=lambda i: (-(i & -i).bit_length() if i else 0, i)), int)


def _touch(link: coal.CollisionGeometry, shape: coal.CollisionGeometry, placement: SE3) -> bool:
    """Return whether a link of the last joint touches a shape of the load."""
    return bool(
        coal.collide(
            link, coal.Transform3s(), shape, _transform(placement), coal.CollisionRequest(), coal.CollisionResult()
        )
    )


def _transform(pose: SE3) -> coal.Transform3s:
    return coal.Transform3s(pose.rotation, pose.translation)
