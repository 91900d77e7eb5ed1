"""Shapes of a mobile Franka, its load and what stands around it, ready for collision tests in batches."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Sequence
from functools import cache
from itertools import pairwise, product
from weakref import ref

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float, Int

from roboassembly.geometry.meshes import Mesh
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
_FIRST = 4
"""Size of the first batch of tests that may end early."""
_LOADS = 20
"""Largest number of shapes that share geometry as loads: pairs slow tests down even if they are not active."""
_CACHED = 4
"""Number of loads whose shapes are cached; each occupies up to 30 MB."""
_POOLS = 2
"""Number of arrangements of one load that are ready at a time, as a stage of a step may test two in turn."""
PlacedShape = tuple[Shape, SE3]
Configurations = Float[np.ndarray, "n 10"]
Margins = Float[np.ndarray, "g g"]
"""Largest distance that counts as a hit, for each pair of shapes; above the diagonal [m]."""


class _Pool:
    """Geometry of a robot and its surroundings, where the world tested last has it."""

    def __init__(self, geometry: pin.GeometryModel, movable: Sequence[int]) -> None:
        self._geometry, self._pool = geometry, MovablePool(robot_model()[0], geometry, movable)
        # An arrangement has its pools: a strong reference would keep megabytes until Python looks for cycles.
        self._arrangement: ref[Arrangement] | None = None

    def has(self, arrangement: Arrangement) -> bool:
        """Return whether the last test was of an arrangement."""
        return self._arrangement is not None and self._arrangement() is arrangement

    def hits(
        self, arrangement: Arrangement, margins: Margins, q: Configurations, first_only: bool
    ) -> Bool[np.ndarray, "n"]:
        """Return whether any pair is nearer than its margin in each configuration."""
        pool = self._pool.at(arrangement.placements)
        for data in pool.getGeometryDatas():
            data.setSecurityMargins(self._geometry, margins)
            if not self.has(arrangement):
                data.setActiveCollisionPairs(self._geometry, arrangement.pairs)
        self._arrangement = ref(arrangement)
        hits = pin.computeCollisionsInParallel(1, pool, np.asfortranarray(q.T), True, first_only)
        return np.array(hits, dtype=bool)


class RobotShapes:
    """Shapes of a robot, of its load and of all that may stand around it. For one thread at a time.

    Args:
        load: shapes in the hand.
        still: shapes that may stand around the robot, each as often as it may.
    """

    def __init__(self, load: Sequence[Shape], still: Sequence[Shape]) -> None:
        carriers, geometry = robot_model()[1], pin.GeometryModel()

        def add(carrier: int, shape: coal.CollisionGeometry) -> int:
            name = f"shape{len(geometry.geometryObjects)}"
            return geometry.addGeometryObject(pin.GeometryObject(name, carrier, SE3.Identity(), shape))

        own = [add(carriers[link.carrier], link.mesh.convex) for link in links()]
        hand = [add(carriers[HAND], link.mesh.convex) for link, _ in hand_links(0.0)]
        loads = [add(carriers[HAND], shape.geometry) for shape in load]
        around = [add(0, shape.geometry) for shape in still]
        self.first_load = len(own) + len(hand)
        """Number of the first shape that is no link; the load comes before what stands around."""
        self.carriers = [*(link.carrier for link in links()), *[HAND] * len(hand)]
        """Joint that carries each link; 0 is the platform."""
        # Links carried by the last joint do not move relative to the load: one test suffices.
        before = [a for a, link in zip(own, links(), strict=True) if link.carrier != HAND]
        own_and_load = np.array([*own_pairs(), *product(before, loads)])
        ground = geometry.addGeometryObject(ground_object())
        pairs = np.zeros((ground + 1, ground + 1), bool)
        pairs[: self.first_load + len(loads), around] = True
        # The platform drives on the ground.
        pairs[[*own[1:], *hand, *loads], ground] = True
        pairs[tuple(own_and_load.T)] = True
        self.pairs: Bool[np.ndarray, "g g"] = pairs
        """Pairs of shapes that are tested if both are there; above the diagonal."""
        for a, b in np.argwhere(pairs).tolist():
            geometry.addCollisionPair(pin.CollisionPair(a, b))
        hulled = geometry.copy()
        for index, shape in zip([*loads, *around], [*load, *still], strict=True):
            if not shape.convex:
                hulled.geometryObjects[index].geometry = shape.mesh.convex
        self._loads, self._still = _Stock(load, loads), _Stock(still, around)
        self._geometry, self._movable = (hulled, geometry), range(len(own), ground)
        self._pools = (list[_Pool](), list[_Pool]())

    def numbers(self, load: Sequence[Shape], still: Sequence[Shape]) -> tuple[list[int], list[int]] | None:
        """Return the numbers of shapes in the hand and around, all different; None if some are not here."""
        loads, stills = self._loads.pick(load), self._still.pick(still)
        return None if loads is None or stills is None else (loads, stills)

    def pool(self, arrangement: Arrangement, exact: bool) -> _Pool:
        """Return a pool, one that is arranged already if there is one."""
        pools = self._pools[exact]
        ready = next((pool for pool in pools if pool.has(arrangement)), None)
        if ready is None:
            ready = pools[0] if len(pools) == _POOLS else _Pool(self._geometry[exact], self._movable)
        pools[:] = [*(pool for pool in pools if pool is not ready), ready]
        return ready


class WorldCache:
    """Shapes that worlds share. For one thread at a time.

    Args:
        load: shapes that may be in a hand, each as often as it may.
        still: shapes that may stand around a robot, likewise.
    """

    def __init__(self, load: Sequence[Shape], still: Sequence[Shape]) -> None:
        self._load, self._still = tuple(load), tuple(still)
        self._shapes: dict[Hashable, RobotShapes] = {}

    def shapes(self, load: Sequence[Shape]) -> RobotShapes:
        """Return the shapes of worlds with a load, or with more than that."""
        some = self._load if load and len(self._load) <= _LOADS else load
        key = tuple((shape.mesh, shape.convex) for shape in some)
        return kept(self._shapes, key, lambda: RobotShapes(some, self._still), _CACHED)


class Arrangement:
    """Load and surroundings of a robot, and their collision tests.

    Args:
        hand: placements of palm and fingers in the frame of the last joint.
        load: shapes in the hand, each with its placement in the frame of the last joint.
        still: shapes that do not move, each with its placement in the world.
        lands: whether the load may touch the ground.
        cache: shapes of other worlds; new ones are made if it is None or lacks some.
    """

    def __init__(
        self,
        hand: Sequence[SE3],
        load: Sequence[PlacedShape],
        still: Sequence[PlacedShape],
        lands: bool,
        cache: WorldCache | None,
    ) -> None:
        needed = [shape for shape, _ in load], [shape for shape, _ in still]
        shapes = RobotShapes(*needed) if cache is None else cache.shapes(needed[0])
        numbers = shapes.numbers(*needed)
        if numbers is None:
            shapes = RobotShapes(*needed)
            numbers = shapes.numbers(*needed)
            assert numbers is not None
        self._shapes = shapes
        loads, stills = numbers
        placed: list[SE3 | None] = [None] * (len(shapes.pairs) - 1)
        for number, (_, placement) in zip((*loads, *stills), (*load, *still), strict=True):
            placed[number] = placement
        self.placements: Placements = (*hand, *placed[shapes.first_load :])
        """Placements of all shapes but platform, arm and ground."""
        here = np.zeros(len(shapes.pairs), bool)
        self._moving = np.array([*range(shapes.first_load), *loads])
        here[[*self._moving, *stills, -1]] = True
        self.pairs = shapes.pairs & here & here[:, None]
        """Pairs of shapes that are tested; above the diagonal."""
        if lands:
            self.pairs[loads, -1] = False
        self.carriers = [*shapes.carriers, *[HAND] * len(loads)]
        """Joint that carries each moving shape; 0 is the platform."""
        self.own_pairs: Int[np.ndarray, "p 2"] = np.argwhere(self.pairs[np.ix_(self._moving, self._moving)])
        """Pairs of moving shapes, by their order among these, that are tested against each other."""
        self._contact: dict[float, Margins] = {}

    def margins(self, around: float | Float[np.ndarray, "s"], own: float | Float[np.ndarray, "p"]) -> Margins:
        """Return margins of pairs.

        Args:
            around: margin of each moving shape from the surroundings [m].
            own: margin of each of `own_pairs` [m].
        """
        out = np.zeros(self.pairs.shape)
        out[self._moving] = np.reshape(around, (-1, 1))
        out[tuple(self._moving[self.own_pairs].T)] = own
        return out

    def contact_margins(self, clearance: float) -> Margins:
        """Return margins with which contact is a hit, and so are surroundings nearer than a clearance [m]."""
        if clearance not in self._contact:
            self._contact[clearance] = self.margins(clearance, 0.0)
        return self._contact[clearance]

    def hits(
        self,
        margins: Margins,
        q: Configurations,
        *,
        first_only: bool = False,
        coarse: bool = False,
    ) -> Bool[np.ndarray, "n"]:
        """Return whether any pair is nearer than its margin in each configuration, first by hulls, then exactly.

        Args:
            margins: of `margins` or `contact_margins`.
            q: configurations.
            first_only: end at the first hit.
            coarse: test hulls alone; they hit more.
        """
        out = np.zeros(len(q), bool)
        sizes = growing_batches(len(q)) if first_only else [len(q)]
        for begin, end in pairwise(np.cumsum([0, *sizes]).tolist()):
            near = begin + np.flatnonzero(self._hits(margins, q[begin:end], exact=False))
            if len(near):
                out[near] = coarse or self._hits(margins, q[near], first_only, exact=True)
            if first_only and out.any():
                break
        return out

    def _hits(
        self, margins: Margins, q: Configurations, first_only: bool = False, *, exact: bool
    ) -> Bool[np.ndarray, "n"]:
        return self._shapes.pool(self, exact).hits(self, margins, q, first_only)


class _Stock:
    """Numbers of shapes of which some are needed at a time."""

    def __init__(self, shapes: Sequence[Shape], numbers: Sequence[int]) -> None:
        self._numbers = defaultdict[tuple[Mesh, bool], list[int]](list)
        for shape, number in zip(shapes, numbers, strict=True):
            self._numbers[shape.mesh, shape.convex].append(number)

    def pick(self, shapes: Sequence[Shape]) -> list[int] | None:
        """Return the numbers of shapes, all different; None if some are not here."""
        left = {key: iter(numbers) for key, numbers in self._numbers.items()}
        numbers = [next(left.get((shape.mesh, shape.convex), iter(())), None) for shape in shapes]
        found = [number for number in numbers if number is not None]
        return found if len(found) == len(numbers) else None


def growing_batches(count: int) -> list[int]:
    """Return sizes of batches that add up to a count, each twice the one before."""
    out: list[int] = []
    while (rest := count - sum(out)) > 0:
        out.append(min(rest, _FIRST << len(out)))
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
