"""One rigid body moving in SE(3) among still ones: exact collision checks, whole edges at a time.

Two tests decide. A *box test* looks at a stretch of an edge at once: if the volume swept by the boxes around the
moving shapes meets no box of a still shape, every configuration of the stretch is free, in between samples too.
Where boxes meet, *exact tests* follow: Coal on the triangle meshes, one configuration every `RESOLUTION`. Both count
as states, one each.
"""

from __future__ import annotations

from functools import cached_property

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float

from roboassembly.errors import InputError
from roboassembly.geometry.poses import SE3, interpolate, poses_to_configurations, rotation_angle
from roboassembly.geometry.scene import Scene

RESOLUTION = 0.002
"""Metres that the fastest point of the moving body travels between two exact tests, at most."""
ANGULAR_RESOLUTION = np.deg2rad(1.0)
"""Radians that the body turns between two exact tests, at most."""
_STRETCH = 0.03
"""Metres: an edge is handed to the box test in stretches of about this length, once the whole has failed it."""
_GROUND_THICKNESS = 1.0
_GROUND_SIZE = 200.0


Pool = pin.TreeBroadPhaseManagerPool_DynamicAABBTreeCollisionManager


def collision_pool(scene: Scene) -> Pool:
    """Exact geometry of a scene for batches of configurations.

    Each moving body has a free joint, in the scene's order: seven numbers `(x, y, z, qx, qy, qz, qw)`. Moving bodies
    are tested against still ones, the ground and each other.
    """
    model, geometry = pin.Model(), pin.GeometryModel()
    owners: list[list[int]] = []
    still: list[int] = []
    for b, body in enumerate(scene.bodies):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), SE3.Identity(), f"b{b}") if body.moves else 0
        own = []
        for s, shape in enumerate(body.shapes):
            placement = shape.body_from_mesh if body.moves else body.pose * shape.body_from_mesh
            own.append(geometry.addGeometryObject(pin.GeometryObject(f"b{b}/{s}", joint, placement, shape.geometry)))
        (owners.append if body.moves else still.extend)(own)
    if scene.ground:
        slab = coal.Box(_GROUND_SIZE, _GROUND_SIZE, _GROUND_THICKNESS)
        below = SE3(np.eye(3), np.array([0.0, 0.0, -0.5 * _GROUND_THICKNESS]))
        still.append(geometry.addGeometryObject(pin.GeometryObject("ground", 0, below, slab)))
    for index, own in enumerate(owners):
        others = [*still, *(g for other in owners[index + 1 :] for g in other)]
        for a in own:
            for b in others:
                geometry.addCollisionPair(pin.CollisionPair(a, b))
    pool = Pool(model, geometry, 1)
    for data in pool.getGeometryDatas():
        for request in data.collisionRequests:
            # By default Coal goes on to find how near two meshes are once they are within 1 mm, and in a joint they
            # always are. Only hit or no hit is asked for.
            request.break_distance = 0.0
    return pool


def first_hit(pool: Pool, configurations: Float[np.ndarray, "q n"]) -> int | None:
    """Index of the first column in collision, tested in order and no farther; None if all are free."""
    hits = pin.computeCollisionsInParallel(1, pool, np.asfortranarray(configurations), True, True)
    return int(np.argmax(hits)) if hits.any() else None


class CollisionWorld:
    """The planning model of a scene in which exactly one body moves.

    Args:
        scene: what is where.
        box_axes: rotation of the frame in which boxes are laid around shapes; the world's if None. Boxes are tight
            when it follows the furniture.

    Raises:
        InputError: not exactly one body moves.
    """

    def __init__(self, scene: Scene, box_axes: Float[np.ndarray, "3 3"] | None = None) -> None:
        movers = [body for body in scene.bodies if body.moves]
        if len(movers) != 1:
            raise InputError(f"the scene has {len(movers)} moving bodies; planning takes exactly one")
        self._scene = scene
        self._mover = movers[0]
        self._axes = np.eye(3) if box_axes is None else np.asarray(box_axes, dtype=float)
        self._ground = scene.ground
        self.states = 0
        """Configurations tested so far."""
        placed, owners = [], []
        for body in scene.bodies:
            if not body.moves:
                placed.extend((body.pose * shape.body_from_mesh, shape.mesh) for shape in body.shapes)
                owners.extend([body.name] * len(body.shapes))
        self._still = placed
        self._owners = np.array(owners)
        corners = [(mesh.hull_vertices @ pose.rotation.T + pose.translation) for pose, mesh in placed]
        turned = [points @ self._axes for points in corners]
        self._still_low = np.array([p.min(axis=0) for p in turned]).reshape(-1, 3)
        self._still_high = np.array([p.max(axis=0) for p in turned]).reshape(-1, 3)
        self.top = max([0.0, *(float(points[:, 2].max()) for points in corners)])
        """Height of the highest still point, metres."""
        self._hulls = [shape.mesh.hull_vertices @ shape.body_from_mesh.rotation.T + shape.body_from_mesh.translation
                       for shape in self._mover.shapes]  # fmt: skip
        self._points = np.concatenate(self._hulls)
        self._starts = np.cumsum([0, *(len(h) for h in self._hulls[:-1])])
        self.radius = float(np.linalg.norm(self._points, axis=1).max())
        """Distance of the farthest moving point from the origin of the moving body's frame, metres."""
        meshes = [shape.mesh for shape in self._mover.shapes] + [mesh for _, mesh in placed]
        self.resolution = min(RESOLUTION, 0.9 * min(mesh.thickness for mesh in meshes))
        """Metres between exact tests: no part is thin enough to slip into another from one to the next."""

    @cached_property
    def _pool(self) -> Pool:
        return collision_pool(self._scene)

    def first_collision(self, configurations: Float[np.ndarray, "7 n"]) -> int | None:
        """Index of the first configuration in collision, by exact test in order; None if all are free."""
        first = first_hit(self._pool, configurations)
        self.states += configurations.shape[1] if first is None else first + 1
        return first

    def is_free(self, pose: SE3) -> bool:
        """Exact test of one pose of the moving body, also for parts wholly inside others."""
        return self.first_collision(poses_to_configurations([pose])) is None and not self._nested(pose)

    def _nested(self, pose: SE3) -> bool:
        """Whether one of two shapes whose surfaces do not meet lies inside the other. Edges need not ask: what gets
        in has to pass the surface."""
        for shape in self._mover.shapes:
            world_from_shape = pose * shape.body_from_mesh
            for world_from_still, still in self._still:
                still_from_shape = world_from_still.actInv(world_from_shape)
                if still.contains(still_from_shape.act(shape.mesh.vertices[0])):
                    return True
                if shape.mesh.contains(still_from_shape.actInv(still.vertices[0])):
                    return True
        return False

    def edge_is_free(self, start: SE3, end: SE3) -> bool:
        """Whether every configuration from `start` (taken as tested) to `end` is free."""
        return self.free_fraction(start, end) == 1.0

    def free_fraction(self, start: SE3, end: SE3) -> float:
        """How far one can go from `start` toward `end`: 1 if all the way, else the last free tested fraction."""
        travel = float(np.linalg.norm(end.translation - start.translation))
        angle = rotation_angle(start.rotation.T @ end.rotation)
        length = travel + angle * self.radius
        if length < 1e-9:
            return 1.0
        whole = np.array([0.0, 1.0])
        if self._boxes_free(start, end, whole, angle)[0]:
            return 1.0
        cuts = np.linspace(0.0, 1.0, max(2, int(np.ceil(length / _STRETCH)) + 1))
        free = self._boxes_free(start, end, cuts, angle)
        steps = max(1, int(np.ceil(max(length / self.resolution, angle / ANGULAR_RESOLUTION))))
        for first, last in _runs(~free):
            low, high = int(np.floor(cuts[first] * steps)), int(np.ceil(cuts[last + 1] * steps))
            fractions = np.arange(max(low, 1), high + 1) / steps
            hit = self.first_collision(interpolate(start, end, fractions))
            if hit is not None:
                return float((fractions[hit] * steps - 1) / steps)
        return 1.0

    def lowest_point(self, pose: SE3) -> float:
        """Height of the lowest moving point at `pose`, metres."""
        return float((self._points @ pose.rotation[2]).min() + pose.translation[2])

    def _boxes_free(self, start: SE3, end: SE3, cuts: Float[np.ndarray, "k"], angle: float) -> Bool[np.ndarray, "k-1"]:
        """Box test of the stretches between successive fractions."""
        self.states += len(cuts) - 1
        origin = np.outer(1.0 - cuts, start.translation) + np.outer(cuts, end.translation)
        if angle < 1e-9:
            turned = self._points @ (self._axes.T @ start.rotation).T
            low = np.minimum.reduceat(turned, self._starts, axis=0)
            high = np.maximum.reduceat(turned, self._starts, axis=0)
            floor = float((self._points @ start.rotation[2]).min())
        else:
            low, high = np.full((1, 3), -self.radius), np.full((1, 3), self.radius)
            floor = -self.radius
        lifted = np.minimum(origin[:-1, 2], origin[1:, 2]) + floor > 0.0
        free = lifted if self._ground else np.ones(len(cuts) - 1, dtype=bool)
        if not len(self._still):
            return free
        place = origin @ self._axes
        place_low, place_high = np.minimum(place[:-1], place[1:]), np.maximum(place[:-1], place[1:])
        swept_low = place_low[:, None, None] + low[None, :, None]
        swept_high = place_high[:, None, None] + high[None, :, None]
        overlap = np.asarray(((swept_low <= self._still_high) & (swept_high >= self._still_low)).all(axis=-1))
        meets = overlap.reshape(len(overlap), -1).any(axis=-1)
        return free & ~meets

    def distance_to_clear(
        self, pose: SE3, direction: Float[np.ndarray, "3"], body: str, up: Float[np.ndarray, "3"] | None = None
    ) -> float:
        """Metres of straight travel along the unit vector until no moving box meets a box of the named still body.

        From there on, going farther along `direction` meets nothing of that body any more.

        Args:
            pose: `world_from_body` at the start.
            direction: unit vector of the world.
            body: the still one.
            up: unit vector of the world along which the body is to go on, freely, from where it has come; that of
                the boxes' axes which comes nearest to it counts.
        """
        own = self._owners == body
        if not own.any():
            return 0.0
        turned = self._points @ (self._axes.T @ pose.rotation).T + pose.translation @ self._axes
        low = np.minimum.reduceat(turned, self._starts, axis=0)[:, None]
        high = np.maximum.reduceat(turned, self._starts, axis=0)[:, None]
        still_low, still_high = self._still_low[own], self._still_high[own]
        d = direction @ self._axes
        with np.errstate(divide="ignore", invalid="ignore"):
            forward, backward = (still_high - low) / d, (still_low - high) / d
        leave = np.where(d > 1e-9, forward, np.where(d < -1e-9, backward, np.inf))
        apart = ((low > still_high) | (high < still_low)) & (np.abs(d) <= 1e-9)
        if up is not None:
            axis = int(np.argmax(np.abs(up @ self._axes)))
            rises = float(np.sign((up @ self._axes)[axis]))
            # Going under a box does not help any more, and one that is below is out of the way for good.
            if rises * d[axis] <= 1e-9:
                leave[..., axis] = np.inf
            below = still_high < low if rises > 0 else still_low > high
            apart[..., axis] = below[..., axis] & (rises * d[axis] >= -1e-9)
        distance = np.where(apart.any(axis=2), 0.0, leave.min(axis=2))
        return float(np.maximum(distance, 0.0).max())


def _runs(flags: Bool[np.ndarray, "n"]) -> list[tuple[int, int]]:
    """First and last index of each run of True."""
    edges = np.diff(np.concatenate([[0], flags.astype(np.int8), [0]]))
    return list(zip(np.flatnonzero(edges == 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist(), strict=True))
