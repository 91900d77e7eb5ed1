"""Shapes of a mobile Franka, its load and what stands around it, ready for collision tests in batches."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise, product

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float, Int

from roboassembly.geometry.poses import SE3
from roboassembly.geometry.scene import Shape
from roboassembly.planning.pools import MovablePool, Placements, ground_object, kept
from roboassembly.robots.body import HAND, hand_links, joint_placements, links
from roboassembly.robots.kinematics import arm

CLEARANCE = 0.004
"""Clearance from everything else on transfer motions, as physical robots deviate a little from their paths [m]."""
_SAMPLES = 2_000
"""Number of random configurations that determine which links always overlap."""
_ALWAYS = 0.5
"""Share of random configurations from which an overlap of two links is taken to be built in."""
_CHUNK = 16
"""Size of the first batch of tests that end at the first hit."""
_CACHED = 24
"""Number of worlds whose shapes are cached; each occupies some megabytes."""
Configurations = Float[np.ndarray, "n 10"]
Margins = Float[np.ndarray, "g g"]
"""Largest distance that counts as a hit, for each pair of shapes; above the diagonal [m]."""


@dataclass(eq=False)
class _Checker:
    """Shapes ready for batches of configurations; all worlds with these shapes share them."""

    model: pin.Model
    geometry: pin.GeometryModel
    movable: Sequence[int]
    """Shapes whose placements differ from world to world."""

    @cached_property
    def _pool(self) -> MovablePool:
        return MovablePool(self.model, self.geometry, self.movable)

    def hits(
        self,
        margins: Margins,
        pairs: Bool[np.ndarray, "g g"],
        placements: Placements,
        q: Configurations,
        first_only: bool = False,
    ) -> Bool[np.ndarray, "n"]:
        """Return whether any pair is nearer than its margin in each configuration."""
        pool = self._pool.at(placements)
        for data in pool.getGeometryDatas():
            data.setSecurityMargins(self.geometry, margins)
            data.setActiveCollisionPairs(self.geometry, pairs)
        hits = pin.computeCollisionsInParallel(1, pool, np.asfortranarray(q.T), True, first_only)
        return np.array(hits, dtype=bool)


class RobotShapes:
    """Shapes of a robot, its load and the still bodies, wherever they are, and the tests of them.

    Args:
        load: shapes in the hand.
        still: shapes that do not move.
        lands: whether the load may touch the ground.
    """

    def __init__(self, load: Sequence[Shape], still: Sequence[Shape], lands: bool) -> None:
        model, carriers = robot_model()
        geometry, nowhere = pin.GeometryModel(), SE3.Identity()

        def add(name: str, carrier: int, shape: coal.CollisionGeometry) -> int:
            return geometry.addGeometryObject(pin.GeometryObject(name, carrier, nowhere, shape))

        own = [add(link.name, carriers[link.carrier], link.mesh.convex) for link in links()]
        hand = [add(link.name, carriers[HAND], link.mesh.convex) for link, _ in hand_links(0.0)]
        loads = [add(f"load{i}", carriers[HAND], s.geometry) for i, s in enumerate(load)]
        others = [add(f"still{i}", 0, s.geometry) for i, s in enumerate(still)]
        ground = geometry.addGeometryObject(ground_object())
        count = len(geometry.geometryObjects)
        pairs = np.zeros((count, count), bool)
        pairs[np.ix_([*own, *hand, *loads], others)] = True
        # The platform drives on the ground.
        pairs[[*own[1:], *hand, *([] if lands else loads)], ground] = True
        # Links carried by the last joint do not move relative to the load: one test suffices.
        moving = [a for a, link in zip(own, links(), strict=True) if link.carrier != HAND]
        self.own_pairs: Int[np.ndarray, "p 2"] = np.array([*own_pairs(), *product(moving, loads)])
        """Pairs of the robot's own shapes and its load that are tested against each other."""
        pairs[tuple(self.own_pairs.T)] = True
        self.carriers = [*(link.carrier for link in links()), *[HAND] * (len(hand) + len(loads))]
        """Joint that carries each moving shape; 0 is the platform. Moving shapes come before still ones."""
        self._pairs = pairs
        for a, b in np.argwhere(pairs).tolist():
            geometry.addCollisionPair(pin.CollisionPair(a, b))
        hulled = geometry.copy()
        for index, shape in zip([*loads, *others], (*load, *still), strict=True):
            if not shape.convex:
                hulled.geometryObjects[index].geometry = shape.mesh.convex
        movable = [*hand, *loads, *others]
        self._hulls, self._exact = _Checker(model, hulled, movable), _Checker(model, geometry, movable)

    def margins(self, around: float | Float[np.ndarray, "s"], own: float | Float[np.ndarray, "p"]) -> Margins:
        """Return margins of pairs.

        Args:
            around: margin of each moving shape from the surroundings [m].
            own: margin of each of `own_pairs` [m].
        """
        out = np.zeros(self._pairs.shape)
        out[: len(self.carriers)] = np.reshape(around, (-1, 1))
        out[tuple(self.own_pairs.T)] = own
        return out

    def hits(
        self,
        margins: Margins,
        placements: Placements,
        q: Configurations,
        *,
        first_only: bool = False,
        coarse: bool = False,
    ) -> Bool[np.ndarray, "n"]:
        """Return whether any pair is nearer than its margin in each configuration, first by hulls, then exactly.

        Args:
            margins: of `margins`.
            placements: where all shapes are.
            q: configurations.
            first_only: end at the first hit.
            coarse: test hulls alone; they hit more.
        """
        out = np.zeros(len(q), bool)
        sizes = growing_batches(len(q)) if first_only else [len(q)]
        for begin, end in pairwise(np.cumsum([0, *sizes]).tolist()):
            near = begin + np.flatnonzero(self._hulls.hits(margins, self._pairs, placements, q[begin:end]))
            if len(near):
                out[near] = coarse or self._exact.hits(margins, self._pairs, placements, q[near], first_only)
            if first_only and out.any():
                break
        return out


class WorldCache:
    """Shapes of earlier worlds: a world with the same ones elsewhere only moves them. For one thread at a time."""

    def __init__(self) -> None:
        self._shapes: dict[Hashable, RobotShapes] = {}

    def shapes(self, load: Sequence[Shape], still: Sequence[Shape], lands: bool) -> RobotShapes:
        """Return the shapes of a world; for the arguments see `RobotShapes`."""
        key = lands, *(tuple((s.mesh, s.convex) for s in some) for some in (load, still))
        return kept(self._shapes, key, lambda: RobotShapes(load, still, lands), _CACHED)


def growing_batches(count: int, first: int = _CHUNK) -> list[int]:
    """Return sizes of batches that add up to a count, each twice the one before."""
    out: list[int] = []
    while (rest := count - sum(out)) > 0:
        out.append(min(rest, first << len(out)))
    return out


@cache
def robot_model() -> tuple[pin.Model, tuple[int, ...]]:
    """Return the model of platform and arm, and the joint of each carrier."""
    model = pin.Model()
    drive = pin.JointModelComposite()
    for joint in (pin.JointModelPX(), pin.JointModelPY(), pin.JointModelRZ()):
        drive.addJoint(joint)
    carriers = [model.addJoint(0, drive, SE3.Identity(), "platform")]
    for number, placement in enumerate(joint_placements(), 1):
        carriers.append(model.addJoint(carriers[-1], pin.JointModelRZ(), placement, f"joint{number}"))
    return model, tuple(carriers)


@cache
def own_pairs() -> tuple[tuple[int, int], ...]:
    """Return the pairs of links that can collide, without neighbours and pairs whose hulls always overlap."""
    model, carriers = robot_model()
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
