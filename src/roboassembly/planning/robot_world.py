"""Collision checks of a mobile Franka, with or without a load in its hand, among still bodies, for whole edges.

Edges are certified coarsely first. A configuration with all distances at least `m` certifies every configuration in
which no point of the robot has moved farther than `m`, so one test covers a stretch of `2 m` of motion. Stretches with
smaller distances are subdivided and tested with smaller `m`, finally by exact tests every `RESOLUTION`. Self-collision
is tested in the same way, where only the arm's own motion counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float

from roboassembly.geometry.poses import SE3, transform_points
from roboassembly.geometry.scene import Body, Shape
from roboassembly.planning.world import RESOLUTION, Pool
from roboassembly.robots.body import HAND, hand_links, links
from roboassembly.robots.kinematics import JOINTS, arm
from roboassembly.robots.platform import PLATFORM_FROM_MOUNT

_OUTER_MARGINS = (0.06, 0.015)
"""Margins of tests against the surroundings [m]."""
_OWN_MARGINS = (0.02, 0.005)
"""Margins of tests of self-collision [m]."""
CLEARANCE = 0.004
"""Clearance from everything else on transfer motions, as physical robots deviate a little from their paths [m]."""
_GROUND = (200.0, 200.0, 1.0)
"""Dimensions of the box that models the ground [m]."""
_SAMPLES = 2_000
"""Number of random configurations that determine which links always overlap."""
_SPAN_SAMPLES, _SPAN_SLACK = 100_000, 1.02
"""Number of random configurations, and safety factor, of the largest distances from axes to links."""
_ALWAYS = 0.5
"""Share of random configurations from which an overlap of two links is taken to be built in."""
_CHUNK = 8
"""Size of the first batch of tests that end at the first hit."""
Configurations = Float[np.ndarray, "n 10"]


@dataclass(eq=False)
class _Test:
    """Test whether any pair of shapes is nearer than a margin, first by convex hulls, then exactly."""

    model: pin.Model
    geometry: pin.GeometryModel
    hulls: pin.GeometryModel
    margin: float

    @cached_property
    def _hulls(self) -> Pool:
        return self._pool(self.hulls)

    @cached_property
    def _exact(self) -> Pool:
        return self._pool(self.geometry)

    def _pool(self, geometry: pin.GeometryModel) -> Pool:
        pool = Pool(self.model, geometry, 1)
        for data in pool.getGeometryDatas():
            for request in data.collisionRequests:
                request.break_distance = 0.0
                request.security_margin = self.margin
        return pool

    def hits(self, q: Configurations, *, first_only: bool = False) -> Bool[np.ndarray, "n"]:
        """Return whether any pair is nearer in each configuration; with `first_only`, tests end at the first hit."""
        out = np.zeros(len(q), bool)
        sizes = _growing(len(q)) if first_only else [len(q)]
        for begin, end in pairwise(np.cumsum([0, *sizes]).tolist()):
            near = begin + np.flatnonzero(_collisions(self._hulls, q[begin:end]))
            if len(near):
                out[near] = _collisions(self._exact, q[near], first_only)
            if first_only and out.any():
                break
        return out


def _collisions(pool: Pool, q: Configurations, first_only: bool = False) -> Bool[np.ndarray, "n"]:
    return np.array(pin.computeCollisionsInParallel(1, pool, np.asfortranarray(q.T), True, first_only), dtype=bool)


def _growing(count: int) -> list[int]:
    """Return sizes of batches that add up to a count, each twice the one before."""
    out: list[int] = []
    while (rest := count - sum(out)) > 0:
        out.append(min(rest, _CHUNK << len(out)))
    return out


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
    """

    def __init__(
        self,
        still: Sequence[Body],
        opening: float,
        load: Sequence[Shape] = (),
        lands: bool = False,
        tally: Tally | None = None,
    ) -> None:
        self.tally = tally or Tally()
        model, carriers = _model()
        tips = SE3(*arm().tips)
        geometry = pin.GeometryModel()

        def add(name: str, carrier: int, placement: SE3, shape: coal.CollisionGeometry) -> int:
            return geometry.addGeometryObject(pin.GeometryObject(name, carrier, placement, shape))

        own = [add(link.name, carriers[link.carrier], SE3.Identity(), link.mesh.convex) for link in links()]
        hand = [add(link.name, carriers[HAND], pose, link.mesh.convex) for link, pose in hand_links(opening)]
        loads = [add(f"load{i}", carriers[HAND], tips * s.body_from_mesh, s.geometry) for i, s in enumerate(load)]
        others = [
            add(f"{b.name}/{i}", 0, b.pose * s.body_from_mesh, s.geometry)
            for b in still
            for i, s in enumerate(b.shapes)
        ]
        ground = add("ground", 0, SE3(np.eye(3), np.array([0.0, 0.0, -0.5 * _GROUND[2]])), coal.Box(*_GROUND))
        outer, inner = geometry, geometry.copy()
        for a in [*own, *hand, *loads]:
            for b in others:
                outer.addCollisionPair(pin.CollisionPair(a, b))
            if a != own[0] and not (lands and a in loads):
                outer.addCollisionPair(pin.CollisionPair(a, ground))
        both = outer.copy()
        # Links carried by the last joint do not move relative to the load: one test suffices.
        still_links = [a for a, link in zip(own, links(), strict=True) if link.carrier == HAND]
        self._hopeless = any(_touch(geometry, a, b) for a in still_links for b in loads)
        loaded = [(a, b) for a in own if a not in still_links for b in loads]
        for a, b in (*_own_pairs(), *loaded):
            inner.addCollisionPair(pin.CollisionPair(a, b))
            both.addCollisionPair(pin.CollisionPair(a, b))
        meshes = [*load, *(s for b in still for s in b.shapes)]
        hulls = {i: s.mesh.convex for i, s in zip([*loads, *others], meshes, strict=True) if not s.convex}

        def tests(pairs: pin.GeometryModel, margins: Sequence[float]) -> list[_Test]:
            hulled = pairs.copy()
            for index, hull in hulls.items():
                hulled.geometryObjects[index].geometry = hull
            return [_Test(model, pairs, hulled, margin) for margin in margins]

        # Setting up a test takes a millisecond, so the exact one is shared.
        (self._all,) = tests(both, (0.0,))
        *around, clear = tests(outer, (*_OUTER_MARGINS, CLEARANCE))
        self._outer, self._clear = (*around, self._all), (*around, clear)
        self._inner = (*tests(inner, _OWN_MARGINS), self._all)
        near = [transform_points(pose, link.mesh.hull_vertices) for link, pose in hand_links(opening)]
        near += [transform_points(tips * s.body_from_mesh, s.mesh.hull_vertices) for s in load]
        self._reach = _reach(np.concatenate(near))

    @property
    def states(self) -> int:
        """Number of configurations tested so far."""
        return self.tally.states

    def free(self, q: Configurations) -> Bool[np.ndarray, "n"]:
        """Return whether each configuration is free, by exact tests."""
        self.tally.states += len(q)
        return ~self._all.hits(q) & (not self._hopeless)

    def clear(self, q: Configurations) -> Bool[np.ndarray, "n"]:
        """Return whether each configuration is free with at least `CLEARANCE` from the surroundings."""
        self.tally.states += len(q)
        return self.free(q) & ~self._clear[-1].hits(q)

    def clearance(self, q: Configurations) -> Float[np.ndarray, "n"]:
        """Return the largest of a few margins that each configuration keeps from the surroundings; 0 if none [m]."""
        out = np.zeros(len(q))
        for test in self._outer[:-1]:
            self.tally.states += len(q)
            out = np.maximum(out, np.where(test.hits(q), 0.0, test.margin))
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
        return self._ladder_free(self._clear if clear else self._outer, a, b, moved) and self._ladder_free(
            self._inner, a, b, float(step[3:] @ self._reach[1:])
        )

    def _ladder_free(self, ladder: Sequence[_Test], a: np.ndarray, b: np.ndarray, moved: float) -> bool:
        """Return whether an edge passes the last test of a ladder; earlier tests with larger margins save work."""
        if moved < 1e-9:
            return True
        stretches: Float[np.ndarray, "s 2"] = np.array([[0.0, 1.0]])
        for test in ladder:
            last = test is ladder[-1]
            spacing = RESOLUTION if last else 2.0 * test.margin
            counts = np.maximum(1, np.ceil((stretches[:, 1] - stretches[:, 0]) * moved / spacing)).astype(int)
            cuts: list[np.ndarray] = [
                np.linspace(low, high, n + 1) for (low, high), n in zip(stretches, counts, strict=True)
            ]
            low, high = np.concatenate([c[:-1] for c in cuts]), np.concatenate([c[1:] for c in cuts])
            if last:
                return not self._any_hit(test, a + np.outer(high, b - a))
            middle = a + np.outer(0.5 * (low + high), b - a)
            # Coarse exact tests for obvious collisions come before certification.
            if test is ladder[0] and self._any_hit(ladder[-1], _middle_first(np.concatenate([middle, b[None]]))):
                return False
            self.tally.states += len(middle)
            near = test.hits(middle)
            if not near.any():
                return True
            stretches = np.stack([low[near], high[near]], axis=1)
        return True

    def _any_hit(self, test: _Test, q: Configurations) -> bool:
        hits = test.hits(q, first_only=True)
        self.tally.states += int(np.argmax(hits)) + 1 if hits.any() else len(q)
        return bool(hits.any())


def _middle_first(q: Configurations) -> Configurations:
    """Return configurations with the middle first, so that a collision is found early."""
    n = len(q)
    order = sorted(range(n), key=lambda i: (-(i & -i).bit_length() if i else 0, i))
    return q[order]


def _touch(geometry: pin.GeometryModel, a: int, b: int) -> bool:
    """Return whether two shapes of one carrier touch."""
    first, second = geometry.geometryObjects[a], geometry.geometryObjects[b]
    return bool(
        coal.collide(
            first.geometry, _transform(first.placement), second.geometry, _transform(second.placement),
            coal.CollisionRequest(), coal.CollisionResult(),
        )
    )  # fmt: skip


def _transform(pose: SE3) -> coal.Transform3s:
    return coal.Transform3s(pose.rotation, pose.translation)


@cache
def _model() -> tuple[pin.Model, tuple[int, ...]]:
    """Return the model of platform and arm, and the joint of each carrier."""
    model = pin.Model()
    drive = pin.JointModelComposite()
    for joint in (pin.JointModelPX(), pin.JointModelPY(), pin.JointModelRZ()):
        drive.addJoint(joint)
    carriers = [model.addJoint(0, drive, SE3.Identity(), "platform")]
    chain = arm().placements
    for j in range(JOINTS):
        placement = SE3(chain.rotation[j], chain.translation[j])
        placement = PLATFORM_FROM_MOUNT * placement if j == 0 else placement
        carriers.append(model.addJoint(carriers[-1], pin.JointModelRZ(), placement, f"joint{j + 1}"))
    return model, tuple(carriers)


@cache
def _own_pairs() -> tuple[tuple[int, int], ...]:
    """Return the pairs of links that can collide, without neighbours and pairs whose hulls always overlap."""
    model, carriers = _model()
    geometry = pin.GeometryModel()
    placed = [(link, SE3.Identity()) for link in links()] + list(hand_links(0.0))
    for link, pose in placed:
        geometry.addGeometryObject(pin.GeometryObject(link.name, carriers[link.carrier], pose, link.mesh.convex))
    # The platform carries two shapes, and so does the last joint.
    pairs = [
        (i, j)
        for i in range(len(placed))
        for j in range(i + 1, len(placed))
        if placed[j][0].carrier - placed[i][0].carrier > 1
    ]
    for a, b in pairs:
        geometry.addCollisionPair(pin.CollisionPair(a, b))
    data, geometry_data = model.createData(), pin.GeometryData(geometry)
    rng, hits = np.random.default_rng(0), np.zeros(len(pairs))
    for _ in range(_SAMPLES):
        q = np.concatenate([np.zeros(3), rng.uniform(arm().low, arm().high)])
        pin.computeCollisions(model, data, geometry, geometry_data, q, False)
        hits += [result.isCollision() for result in geometry_data.collisionResults]
    return tuple(pair for pair, count in zip(pairs, hits, strict=True) if count < _ALWAYS * _SAMPLES)


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
