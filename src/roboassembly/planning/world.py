"""Exact collision checks of one rigid body moving in SE(3) among still ones, for whole edges.

There are two tests. The *box test* covers a stretch of an edge: if the volume swept by the boxes around the moving
shapes meets no box of a still shape, every configuration of the stretch is free, also between samples. Where boxes
meet, *exact tests* follow: Coal on the triangle meshes, one configuration every `RESOLUTION`. Each test counts as one
state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float

from roboassembly.errors import InputError
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, interpolate, poses_to_configurations, rotation_angle
from roboassembly.geometry.scene import Scene
from roboassembly.planning.pools import ScenePool

RESOLUTION = 0.002
"""Largest travel of the body's fastest point between two exact tests [m]."""
ANGULAR_RESOLUTION = np.deg2rad(1.0)
"""Largest rotation of the body between two exact tests [rad]."""
_STRETCH = 0.03
"""Approximate length of the stretches for box tests, after the test of the whole edge has failed [m]."""
_FEW = 20
"""Number of still shapes up to which all are part of every exact test; of more, only those that may be in the way."""
_ENLARGED = 3
"""Number of times that the shapes of exact tests become more before all are taken."""


class ExactChecks:
    """Exact collision checks of a scene, which count the configurations tested."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.states: int = 0
        """Number of configurations tested so far."""

    @cached_property
    def _pool(self) -> ScenePool:
        return ScenePool(self._scene)

    def first_collision(self, configurations: Float[np.ndarray, "q n"]) -> int | None:
        """Return the index of the first configuration in collision by exact tests; None if all are free."""
        pool = self._pool_for(configurations).ready()
        hits = pin.computeCollisionsInParallel(1, pool, np.asfortranarray(configurations), True, True)
        first = int(np.argmax(hits)) if hits.any() else None
        self.states += configurations.shape[1] if first is None else first + 1
        return first

    def _pool_for(self, configurations: Float[np.ndarray, "q n"]) -> ScenePool:
        """Return geometry with everything that the configurations may collide with."""
        return self._pool


class CollisionWorld(ExactChecks):
    """Planning model of a scene in which exactly one body moves.

    Args:
        scene: bodies and ground.
        box_axes: axes of the boxes around shapes, as a rotation; the world's if None. Boxes are tight when the axes
            follow the furniture.

    Raises:
        InputError: not exactly one body moves.
    """

    def __init__(self, scene: Scene, box_axes: Float[np.ndarray, "3 3"] | None = None) -> None:
        movers = [body for body in scene.bodies if body.moves]
        if len(movers) != 1:
            raise InputError(f"the scene has {len(movers)} moving bodies; planning takes exactly one")
        super().__init__(scene)
        self._mover = movers[0]
        self._axes = np.eye(3) if box_axes is None else np.asarray(box_axes, dtype=float)
        self._ground = scene.ground
        placed: list[tuple[SE3, Mesh]] = []
        owners: list[str] = []
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
        self._near = np.full(len(placed), len(placed) <= _FEW)
        self._near_pool: ScenePool | None = None
        self._enlarged = 0
        self.top = max([0.0, *(float(points[:, 2].max()) for points in corners)])
        """Height of the highest still point [m]."""
        self._hulls = [shape.mesh.hull_vertices @ shape.body_from_mesh.rotation.T + shape.body_from_mesh.translation
                       for shape in self._mover.shapes]  # fmt: skip
        self.points = np.concatenate(self._hulls)
        """Hull vertices of the moving shapes in the moving body's frame [m]."""
        self._starts = np.cumsum([0, *(len(h) for h in self._hulls[:-1])])
        self.radius = float(np.linalg.norm(self.points, axis=1).max())
        """Distance of the farthest moving point from the origin of the moving body's frame [m]."""
        meshes = [shape.mesh for shape in self._mover.shapes] + [mesh for _, mesh in placed]
        self.resolution = min(RESOLUTION, 0.9 * min(mesh.thickness for mesh in meshes))
        """Distance between exact tests, less than the thickness of every part, so that none slips into another [m]."""

    def is_free(self, pose: SE3) -> bool:
        """Return whether one pose of the moving body is free, by an exact test that also finds parts inside others."""
        return self.are_free([pose])

    def are_free(self, poses: Sequence[SE3]) -> bool:
        """Return whether all of several poses of the moving body are free; see `is_free`."""
        return self.first_collision(poses_to_configurations(poses)) is None and not any(map(self._nested, poses))

    def _pool_for(self, configurations: Float[np.ndarray, "q n"]) -> ScenePool:
        if self._near.all():
            return self._pool
        place = configurations[:3].T @ self._axes
        low, high = place.min(axis=0) - self.radius, place.max(axis=0) + self.radius
        needed = ((low <= self._still_high) & (high >= self._still_low)).all(axis=1)
        if self._near_pool is None or (needed & ~self._near).any():
            self._near |= needed
            self._enlarged += 1
            if self._enlarged > _ENLARGED or self._near.all():
                self._near[:] = True
                return self._pool
            self._near_pool = ScenePool(self._scene_of(self._near))
        return self._near_pool

    def _scene_of(self, kept: Bool[np.ndarray, "s"]) -> Scene:
        """Return the scene with some of the still shapes only."""
        left = iter(kept.tolist())
        bodies = (
            b if b.moves else replace(b, shapes=tuple(s for s in b.shapes if next(left))) for b in self._scene.bodies
        )
        return Scene(tuple(bodies), self._scene.ground)

    def _nested(self, pose: SE3) -> bool:
        """Return whether a shape lies inside another whose surface it does not meet.

        Edges need no such test, since a shape has to pass the surface to get in.
        """
        if not self._still:
            return False
        turned = self.points @ (self._axes.T @ pose.rotation).T + pose.translation @ self._axes
        low = np.minimum.reduceat(turned, self._starts, axis=0)[:, None]
        high = np.maximum.reduceat(turned, self._starts, axis=0)[:, None]
        # A shape inside another has its box in the other's box.
        meets = np.asarray(((low <= self._still_high) & (high >= self._still_low)).all(axis=2))
        for shape, near in zip(self._mover.shapes, meets, strict=True):
            own_vertex: Float[np.ndarray, "3"] = shape.mesh.vertices[0]
            world_from_shape = pose * shape.body_from_mesh
            for index in np.flatnonzero(near).tolist():
                world_from_still, still = self._still[index]
                still_from_shape = world_from_still.actInv(world_from_shape)
                still_vertex: Float[np.ndarray, "3"] = still.vertices[0]
                if still.contains(still_from_shape.act(own_vertex)):
                    return True
                if shape.mesh.contains(still_from_shape.actInv(still_vertex)):
                    return True
        return False

    def edge_is_free(self, start: SE3, end: SE3) -> bool:
        """Return whether every configuration from `start` (assumed free) to `end` is free."""
        return self.free_fraction(start, end) == 1.0

    def free_fraction(self, start: SE3, end: SE3) -> float:
        """Return the free fraction of the edge from `start` to `end`: 1, or the last free fraction tested."""
        travel = float(np.linalg.norm(end.translation - start.translation))
        angle = rotation_angle(start.rotation.T @ end.rotation)
        length = travel + angle * self.radius
        if length < 1e-9:
            return 1.0
        whole = np.array([0.0, 1.0])
        if self.boxes_free(start, end, whole, angle)[0]:
            return 1.0
        cuts = np.linspace(0.0, 1.0, max(2, int(np.ceil(length / _STRETCH)) + 1))
        free = self.boxes_free(start, end, cuts, angle)
        steps = max(1, int(np.ceil(max(length / self.resolution, angle / ANGULAR_RESOLUTION))))
        for first, last in _runs(~free):
            low, high = int(np.floor(cuts[first] * steps)), int(np.ceil(cuts[last + 1] * steps))
            fractions = np.arange(max(low, 1), high + 1) / steps
            hit = self.first_collision(interpolate(start, end, fractions))
            if hit is not None:
                return float((fractions[hit] * steps - 1) / steps)
        return 1.0

    def lowest_point(self, pose: SE3) -> float:
        """Return the height of the lowest moving point at `pose` [m]."""
        return float((self.points @ pose.rotation[2]).min() + pose.translation[2])

    def boxes_free(self, start: SE3, end: SE3, cuts: Float[np.ndarray, "k"], angle: float) -> Bool[np.ndarray, "k-1"]:
        """Return whether each stretch between successive fractions passes the box test."""
        self.states += len(cuts) - 1
        origin = np.outer(1.0 - cuts, start.translation) + np.outer(cuts, end.translation)
        if angle < 1e-9:
            turned = self.points @ (self._axes.T @ start.rotation).T
            low = np.minimum.reduceat(turned, self._starts, axis=0)
            high = np.maximum.reduceat(turned, self._starts, axis=0)
            floor = float((self.points @ start.rotation[2]).min())
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
        """Return the straight travel until no moving box meets a box of the named still body [m].

        Farther motion along `direction` does not meet that body again.

        Args:
            pose: `world_from_body` at the start.
            direction: unit vector of the world.
            body: name of the still body.
            up: unit vector of the world along which the body has to be free to continue from there, rounded to the
                nearest axis of the boxes; not required if None.
        """
        own = self._owners == body
        if not own.any():
            return 0.0
        turned = self.points @ (self._axes.T @ pose.rotation).T + pose.translation @ self._axes
        low = np.minimum.reduceat(turned, self._starts, axis=0)[:, None]
        high = np.maximum.reduceat(turned, self._starts, axis=0)[:, None]
        still_low, still_high = self._still_low[own], self._still_high[own]
        d = direction @ self._axes
        leave, separate = leave_boxes(low, high, still_low, still_high, d)
        if up is not None:
            axis = int(np.argmax(np.abs(up @ self._axes)))
            rises = float(np.sign((up @ self._axes)[axis]))
            # Passing under a box does not help, and a box below is permanently out of the way.
            if rises * d[axis] <= 1e-9:
                leave[..., axis] = np.inf
            below = still_high < low if rises > 0 else still_low > high
            separate[..., axis] = below[..., axis] & (rises * d[axis] >= -1e-9)
        distance = np.where(separate.any(axis=2), 0.0, leave.min(axis=2))
        return float(np.maximum(distance, 0.0).max())


def leave_boxes(
    low: Float[np.ndarray, "*n 3"],
    high: Float[np.ndarray, "*n 3"],
    still_low: Float[np.ndarray, "*n 3"],
    still_high: Float[np.ndarray, "*n 3"],
    direction: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "*n 3"], Bool[np.ndarray, "*n 3"]]:
    """Return, for each axis, the travel until moving boxes have left still ones, and whether they never meet along it.

    Args:
        low: lowest corners of the moving boxes [m].
        high: highest corners of the moving boxes [m].
        still_low: lowest corners of the still boxes [m].
        still_high: highest corners of the still boxes [m].
        direction: unit vector of the motion, in the axes of the boxes.

    Returns:
        Travel [m], infinite along axes without motion; and whether the boxes are apart along an axis without motion.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        forward, backward = (still_high - low) / direction, (still_low - high) / direction
    leave = np.where(direction > 1e-9, forward, np.where(direction < -1e-9, backward, np.inf))
    return leave, ((low > still_high) | (high < still_low)) & (np.abs(direction) <= 1e-9)


def _runs(flags: Bool[np.ndarray, "n"]) -> list[tuple[int, int]]:
    """Return first and last index of each run of True."""
    edges = np.diff(np.concatenate([[0], flags.astype(np.int8), [0]]))
    return list(zip(np.flatnonzero(edges == 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist(), strict=True))
