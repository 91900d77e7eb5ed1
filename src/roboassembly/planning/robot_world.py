"""Collision checks of a mobile Franka, with or without a load in its hand, among still bodies, for whole edges.

Edges are certified coarsely first. A configuration with all distances at least `m` certifies every configuration in
which no point of the robot has moved farther than `m`, so one test covers a stretch of `2 m` of motion. Stretches with
smaller distances are subdivided and tested with smaller `m`, finally by exact tests every `RESOLUTION`. Self-collision
is tested in the same way, where only the arm's own motion counts.
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
from roboassembly.planning.robot_shapes import (
    CollisionTest,
    Configurations,
    Placements,
    WorldCache,
    growing_batches,
)
from roboassembly.planning.world import RESOLUTION
from roboassembly.robots.body import HAND, hand_links, links
from roboassembly.robots.kinematics import JOINTS, arm
from roboassembly.robots.platform import PLATFORM_FROM_MOUNT

_SPAN_SAMPLES, _SPAN_SLACK = 10_000, 1.03
"""Number of random configurations, and safety factor, of the largest distances from axes to links."""
_FIRST_FREE = 4
"""Size of the first batch of tests that end at enough free configurations."""


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
        cache: shapes of earlier worlds; none if None.
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
        around = [(b.pose * s.body_from_mesh, s) for b in still for s in b.shapes]
        hand, loads = hand_links(opening), [tips * s.body_from_mesh for s in load]
        self._placements: Placements = (*(pose for _, pose in hand), *loads, *(pose for pose, _ in around))
        self._tests = (cache or WorldCache()).shapes(load, [s for _, s in around], lands)
        wrist = [link.mesh.convex for link in links() if link.carrier == HAND]
        self._hopeless = any(_touch(a, s.geometry, pose) for a in wrist for s, pose in zip(load, loads, strict=True))
        self._carried = [(link.mesh, pose) for link, pose in hand] + [
            (s.mesh, pose) for s, pose in zip(load, loads, strict=True)
        ]

    @cached_property
    def _reach(self) -> Float[np.ndarray, "8"]:
        return _reach(np.concatenate([transform_points(pose, mesh.hull_vertices) for mesh, pose in self._carried]))

    @property
    def states(self) -> int:
        """Number of configurations tested so far."""
        return self.tally.states

    def free(self, q: Configurations) -> Bool[np.ndarray, "n"]:
        """Return whether each configuration is free, by exact tests."""
        self.tally.states += len(q)
        return ~self._tests.all.hits(self._placements, q) & (not self._hopeless)

    def each_free(self, q: Configurations) -> Iterator[Float[np.ndarray, "10"]]:
        """Yield the configurations that are free, in their order; those after the last one taken are not all tested."""
        for begin, end in pairwise(np.cumsum([0, *growing_batches(len(q), _FIRST_FREE)]).tolist()):
            yield from q[begin:end][self.free(q[begin:end])]

    def clear(self, q: Configurations) -> Bool[np.ndarray, "n"]:
        """Return whether each configuration is free with at least `CLEARANCE` from the surroundings."""
        self.tally.states += len(q)
        return self.free(q) & ~self._tests.clear[-1].hits(self._placements, q)

    def clearance(self, q: Configurations) -> Float[np.ndarray, "n"]:
        """Return the largest of a few margins that each configuration keeps from the surroundings; 0 if none [m]."""
        out = np.zeros(len(q))
        for test in self._tests.outer[:-1]:
            self.tally.states += len(q)
            out = np.maximum(out, np.where(test.hits(self._placements, q), 0.0, test.margin))
        return out

    def edge_is_free(self, a: Float[np.ndarray, "10"], b: Float[np.ndarray, "10"], *, clear: bool = False) -> bool:
        """Return whether every configuration from `a` (assumed free) to `b` is free; the edge is linear.

        Args:
            a: first configuration.
            b: last configuration.
            clear: whether `CLEARANCE` is required too.
        """
        step = np.abs(b - a)
        moved = float(np.linalg.norm((b - a)[:2]) + step[2:] @ self._reach)
        outer = self._tests.clear if clear else self._tests.outer
        if moved < 1e-9:
            return True
        if self._any_hit(self._tests.all, b[None]):
            return False
        arm_moved = float(step[3:] @ self._reach[1:])
        return self._ladder_free(outer, a, b, moved) and self._ladder_free(self._tests.inner, a, b, arm_moved)

    def _ladder_free(self, ladder: Sequence[CollisionTest], a: np.ndarray, b: np.ndarray, moved: float) -> bool:
        """Return whether an edge passes the last test of a ladder; earlier tests with larger margins save work."""
        if moved < 1e-9:
            return True
        *certain, exact = ladder
        stretches: Float[np.ndarray, "s 2"] = np.array([[0.0, 1.0]])
        for test in certain:
            low, high = _cut(stretches, moved, 2.0 * test.margin)
            near = self._near(test, exact, a + np.outer(0.5 * (low + high), b - a))
            if near is None:
                return False
            if not near.any():
                return True
            stretches = np.stack([low[near], high[near]], axis=1)
        _, high = _cut(stretches, moved, RESOLUTION)
        return not self._any_hit(exact, a + np.outer(high, b - a))

    def _near(self, test: CollisionTest, exact: CollisionTest, q: Configurations) -> Bool[np.ndarray, "n"] | None:
        """Return which configurations fail a test with a margin; None as soon as one fails the exact test.

        The middle of the edge comes first, so that a collision is found early.
        """
        near, order = np.zeros(len(q), bool), _middle_first(len(q))
        for begin, end in pairwise(np.cumsum([0, *growing_batches(len(q))]).tolist()):
            some = order[begin:end]
            self.tally.states += len(some)
            near[some] = test.hits(self._placements, q[some])
            if near[some].any() and self._any_hit(exact, q[some[near[some]]]):
                return None
        return near

    def _any_hit(self, test: CollisionTest, q: Configurations) -> bool:
        hits = test.hits(self._placements, q, first_only=True)
        self.tally.states += int(np.argmax(hits)) + 1 if hits.any() else len(q)
        return bool(hits.any())


def _cut(
    stretches: Float[np.ndarray, "s 2"], moved: float, spacing: float
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Return the first and last fractions of equal pieces of stretches, none of which moves more than a spacing."""
    counts = np.maximum(1, np.ceil((stretches[:, 1] - stretches[:, 0]) * moved / spacing)).astype(int)
    cuts: list[np.ndarray] = [np.linspace(low, high, n + 1) for (low, high), n in zip(stretches, counts, strict=True)]
    return np.concatenate([c[:-1] for c in cuts]), np.concatenate([c[1:] for c in cuts])


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


def _reach(load: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "8"]:
    """Return the distance from the platform's axis, and from each joint's, to the farthest point that it moves [m].

    Args:
        load: points of the hand and of its load, in the last joint's frame.
    """
    points: list[list[np.ndarray]] = [[] for _ in range(1 + JOINTS)]
    for link in links():
        points[link.carrier].append(link.mesh.hull_vertices)
    points[HAND].append(load)
    own = [np.concatenate(p) if p else np.zeros((1, 3)) for p in points]
    radius = [float(np.linalg.norm(p, axis=1).max()) for p in own]
    about = [float(np.linalg.norm(p[:, :2], axis=1).max()) for p in own]
    spans = _spans()
    return np.array(
        [max(about[i], *(spans[i, c] + radius[c] for c in range(i + 1, 1 + JOINTS)), 0.0) for i in range(1 + JOINTS)]
    )


@cache
def _spans() -> Float[np.ndarray, "8 8"]:
    """Return the largest distance from each axis to the origins of later carriers, by random configurations [m]."""
    rng = np.random.default_rng(0)
    q = rng.uniform(arm().low, arm().high, (_SPAN_SAMPLES, JOINTS))
    # A joint's own angle does not change its spans, so the samples cover the extreme of each span well.
    frames, origins = arm().frames(q)
    axes = frames[..., 2]
    mount = PLATFORM_FROM_MOUNT.translation
    axes = np.concatenate([np.broadcast_to([0.0, 0.0, 1.0], (len(q), 1, 3)), axes], axis=1)
    origins = np.concatenate([np.zeros((len(q), 1, 3)), origins + mount], axis=1)
    out = np.zeros((1 + JOINTS, 1 + JOINTS))
    for i in range(1 + JOINTS):
        off = origins[:, i + 1 :] - origins[:, i, None]
        out[i, i + 1 :] = np.linalg.norm(np.cross(off, axes[:, i, None]), axis=2).max(axis=0, initial=0.0)
    return _SPAN_SLACK * out
