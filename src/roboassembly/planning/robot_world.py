"""One mobile Franka, perhaps with something in its hand, among still things: collision checks of whole edges.

An edge is certified coarsely first. A configuration that keeps everything at least `m` away from everything certifies
all configurations in which no point of the robot has moved farther than `m`; so stretches of `2 m` of motion take one
test. Where something is nearer, the stretch is cut up and looked at with less `m`, and at last by exact tests every
`RESOLUTION`. What the robot does to itself is looked at in the same way, but only the arm's own motion counts there.
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
_OWN_MARGINS = (0.02, 0.005)
"""Metres."""
CLEARANCE = 0.004
"""Metres from everything else that a robot keeps where it is not on its way to something: it strays a little."""
_GROUND = (200.0, 200.0, 1.0)
_SAMPLES = 2_000
_SPREAD_SAMPLES, _SPREAD_SLACK = 100_000, 1.02
_ALWAYS = 0.5
"""Share of random configurations from which on two links that overlap are taken to be made so."""
_CHUNK = 8
"""Configurations looked at first, where the first hit ends it."""
Configurations = Float[np.ndarray, "n 10"]


@dataclass(eq=False)
class _Test:
    """Pairs of shapes, nearer to each other than a margin or not; their convex hulls are looked at first."""

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
        """Whether any pair is nearer, in each configuration; none after the first that is, with `first_only`."""
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
    """Lengths that add up to a count, each twice the one before."""
    out: list[int] = []
    while (rest := count - sum(out)) > 0:
        out.append(min(rest, _CHUNK << len(out)))
    return out


@dataclass
class Tally:
    """Outlives the world whose states it counts: tests that are set up hold megabytes, to be used for the next."""

    states: int = 0


class RobotWorld:
    """The planning model of one robot among still things.

    Args:
        still: bodies that do not move, the other robot's included.
        opening: metres between the finger pads.
        held: what the hand holds, `body_from_mesh` being `tips_from_mesh`; its pads are meant to touch it and are not
            tested against it.
        lands: whether what is held may touch the ground.
        tally: counts the tested configurations; a new one if None.
    """

    def __init__(
        self,
        still: Sequence[Body],
        opening: float,
        held: Sequence[Shape] = (),
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
        load = [add(f"held{i}", carriers[HAND], tips * s.body_from_mesh, s.geometry) for i, s in enumerate(held)]
        others = [
            add(f"{b.name}/{i}", 0, b.pose * s.body_from_mesh, s.geometry)
            for b in still
            for i, s in enumerate(b.shapes)
        ]
        ground = add("ground", 0, SE3(np.eye(3), np.array([0.0, 0.0, -0.5 * _GROUND[2]])), coal.Box(*_GROUND))
        outer, inner = geometry, geometry.copy()
        for a in [*own, *hand, *load]:
            for b in others:
                outer.addCollisionPair(pin.CollisionPair(a, b))
            if a != own[0] and not (lands and a in load):
                outer.addCollisionPair(pin.CollisionPair(a, ground))
        both = outer.copy()
        # What the last joint carries does not move against the load: looked at once.
        still_links = [a for a, link in zip(own, links(), strict=True) if link.carrier == HAND]
        self._hopeless = any(_meet(geometry, a, b) for a in still_links for b in load)
        loaded = [(a, b) for a in own if a not in still_links for b in load]
        for a, b in (*_own_pairs(), *loaded):
            inner.addCollisionPair(pin.CollisionPair(a, b))
            both.addCollisionPair(pin.CollisionPair(a, b))
        meshes = [*held, *(s for b in still for s in b.shapes)]
        hulls = {i: s.mesh.convex for i, s in zip([*load, *others], meshes, strict=True) if not s.convex}

        def tests(pairs: pin.GeometryModel, margins: Sequence[float]) -> list[_Test]:
            hulled = pairs.copy()
            for index, hull in hulls.items():
                hulled.geometryObjects[index].geometry = hull
            return [_Test(model, pairs, hulled, margin) for margin in margins]

        # A test takes a millisecond to set up: the exact one is shared.
        (self._all,) = tests(both, (0.0,))
        *around, clear = tests(outer, (*_OUTER_MARGINS, CLEARANCE))
        self._outer, self._clear = (*around, self._all), (*around, clear)
        self._inner = (*tests(inner, _OWN_MARGINS), self._all)
        near = [transform_points(pose, link.mesh.hull_vertices) for link, pose in hand_links(opening)]
        near += [transform_points(tips * s.body_from_mesh, s.mesh.hull_vertices) for s in held]
        self._reach = _reach(np.concatenate(near))

    @property
    def states(self) -> int:
        """Configurations tested so far."""
        return self.tally.states

    def free(self, q: Configurations) -> Bool[np.ndarray, "n"]:
        """Exact test of each configuration."""
        self.tally.states += len(q)
        return ~self._all.hits(q) & (not self._hopeless)

    def clear(self, q: Configurations) -> Bool[np.ndarray, "n"]:
        """Whether each configuration is free, and at least `CLEARANCE` from all around."""
        self.tally.states += len(q)
        return self.free(q) & ~self._clear[-1].hits(q)

    def clearance(self, q: Configurations) -> Float[np.ndarray, "n"]:
        """The largest of a few margins that each configuration keeps from all around; zero of those that touch."""
        out = np.zeros(len(q))
        for test in self._outer[:-1]:
            self.tally.states += len(q)
            out = np.maximum(out, np.where(test.hits(q), 0.0, test.margin))
        return out

    def edge_is_free(self, a: Float[np.ndarray, "10"], b: Float[np.ndarray, "10"], *, clear: bool = False) -> bool:
        """Whether every configuration from `a` (taken as tested) to `b` is free; joints and platform move evenly.

        Args:
            a: where it begins.
            b: where it ends.
            clear: whether `CLEARANCE` is kept besides.
        """
        step = np.abs(b - a)
        moved = float(np.linalg.norm((b - a)[:2]) + step[2:] @ self._reach)
        return self._ladder_free(self._clear if clear else self._outer, a, b, moved) and self._ladder_free(
            self._inner, a, b, float(step[3:] @ self._reach[1:])
        )

    def _ladder_free(self, ladder: Sequence[_Test], a: np.ndarray, b: np.ndarray, moved: float) -> bool:
        """Whether an edge passes the last test of a ladder all along; the others, of falling margins, save work."""
        if moved < 1e-9:
            return True
        stretches = np.array([[0.0, 1.0]])
        for test in ladder:
            last = test is ladder[-1]
            spacing = RESOLUTION if last else 2.0 * test.margin
            counts = np.maximum(1, np.ceil((stretches[:, 1] - stretches[:, 0]) * moved / spacing)).astype(int)
            cuts = [np.linspace(low, high, n + 1) for (low, high), n in zip(stretches, counts, strict=True)]
            low, high = np.concatenate([c[:-1] for c in cuts]), np.concatenate([c[1:] for c in cuts])
            if last:
                return not self._any_hit(test, a + np.outer(high, b - a))
            middle = a + np.outer(0.5 * (low + high), b - a)
            # A coarse look for what is plainly in the way comes before certifying.
            if test is ladder[0] and self._any_hit(ladder[-1], _spread(np.concatenate([middle, b[None]]))):
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


def _spread(q: Configurations) -> Configurations:
    """The same, the middle first, so that a collision is found early."""
    n = len(q)
    order = sorted(range(n), key=lambda i: (-(i & -i).bit_length() if i else 0, i))
    return q[order]


def _meet(geometry: pin.GeometryModel, a: int, b: int) -> bool:
    """Whether two shapes of one carrier touch."""
    one, other = geometry.geometryObjects[a], geometry.geometryObjects[b]
    return bool(
        coal.collide(
            one.geometry, _transform(one.placement), other.geometry, _transform(other.placement),
            coal.CollisionRequest(), coal.CollisionResult(),
        )
    )  # fmt: skip


def _transform(pose: SE3) -> coal.Transform3s:
    return coal.Transform3s(pose.rotation, pose.translation)


@cache
def _model() -> tuple[pin.Model, tuple[int, ...]]:
    """A platform that drives, and seven joints; which joint carries what."""
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
    """Links of the robot that can collide: neighbours left out, and pairs whose hulls always overlap."""
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
    """Metres from the axis of the platform's turn, and of each joint, to the farthest point that it moves.

    Args:
        load: points of the hand and of what it holds, in the last joint's frame.
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
    """Metres from each axis to the origins of the carriers after it, at most; from many random configurations."""
    rng = np.random.default_rng(0)
    q = rng.uniform(arm().low, arm().high, (_SPREAD_SAMPLES, JOINTS))
    # An axis does not move when its own joint turns, so the extreme of each span is among these more than once.
    frames, origins = arm().frames(q)
    axes = frames[..., 2]
    mount = PLATFORM_FROM_MOUNT.translation
    axes = np.concatenate([np.broadcast_to([0.0, 0.0, 1.0], (len(q), 1, 3)), axes], axis=1)
    origins = np.concatenate([np.zeros((len(q), 1, 3)), origins + mount], axis=1)
    out = np.zeros((1 + JOINTS, 1 + JOINTS))
    for i in range(1 + JOINTS):
        off = origins[:, i + 1 :] - origins[:, i, None]
        out[i, i + 1 :] = np.linalg.norm(np.cross(off, axes[:, i, None]), axis=2).max(axis=0, initial=0.0)
    return _SPREAD_SLACK * out
