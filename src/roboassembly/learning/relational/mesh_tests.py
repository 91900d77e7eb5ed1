"""Tests on the parts' meshes: whether groups of a layout overlap, and whether one can leave another along a line.

A layout follows from connection points, so parts lie some tenths of a millimetre beside their places in it. The tests
take meshes whose faces are moved inward by `SHRUNK`, and so do not see such errors, nor rims and overlaps below 2 mm.

Results are cached. Relative poses are rounded before a test, so a result does not depend on which pose was tested
first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float

from roboassembly.geometry.meshes import Mesh, collision_request
from roboassembly.planning.world import leave_boxes

SHRUNK = 0.001
"""Distance by which the faces of meshes are moved inward [m]."""
_NEAR_STEPS, _STEP = (0.0015, 0.004, 0.01), 0.006
"""Travels that are tested on the way out first, and the step between further ones [m]."""
_TRANSLATION, _ANGLE, _COSINE = 1e-4, 2e-4, 1e-3
"""Steps to which translations [m], rotation vectors [rad] and directions are rounded."""
_MANY_FACES, _MOST_FACES = 5_000, 20_000
"""Numbers of faces above which a mesh is simplified, and above which it is not tested at all."""
_SIMPLER = 2e-4
"""Tolerance of the simplification [m]."""
_LEAST_LEFT = 0.3
"""Least share of a part's volume that is left of its shrunk mesh; below it the part is too thin to be shrunk."""
_MOST_KNOWN = 100_000
"""Number of results at which all are dropped."""

Pose = tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]
"""Rotation and translation [m]."""


class PartMeshes:
    """Shrunk meshes of the parts of one piece of furniture, and what is known of any two of them.

    Args:
        meshes: mesh of each part, in the frame in which the observations describe it.
    """

    def __init__(self, meshes: Sequence[Mesh]) -> None:
        self._meshes = tuple(meshes)
        self._known: dict[tuple[object, ...], bool] = {}

    def overlap(self, p: int, q: int, q_from_p: Pose) -> bool:
        """Return whether part `p` overlaps part `q` by more than is lost by shrinking.

        Meshes are surfaces: a part wholly inside the solid of another one does not count.
        """
        a, b = _shrunk(self._meshes[p]), _shrunk(self._meshes[q])
        if a is None or b is None:
            return False
        rotation, translation = rounded(q_from_p)
        if not _boxes_meet(a, b, rotation, translation):
            return False
        key = (p, q, rotation.tobytes(), translation.tobytes())
        return self.known(key, lambda: _Pair(a, b, rotation).touch(translation))

    def blocked(self, p: int, q: int, q_from_p: Pose, directions: Float[np.ndarray, "d 3"]) -> Bool[np.ndarray, "d"]:
        """Return along which lines part `q` is in the way of part `p`, however far it moves.

        Args:
            p: the part that moves.
            q: the part that stays.
            q_from_p: pose of `p` at the start.
            directions: unit vectors in the frame of `q`.
        """
        out = np.zeros(len(directions), bool)
        a, b = _shrunk(self._meshes[p]), _shrunk(self._meshes[q])
        if a is None or b is None:
            return out
        rotation, translation = rounded(q_from_p)
        along = np.rint(directions / _COSINE) * _COSINE + 0.0
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        travel = _travel_to_clear(a, b, rotation, translation, along)
        pose = rotation.tobytes() + translation.tobytes()
        for index in np.flatnonzero(travel).tolist():
            ends = partial(_is_blocked, a, b, rotation, translation, along[index], float(travel[index]))
            out[index] = self.known((p, q, pose, along[index].tobytes()), ends)
        return out

    def known(self, key: tuple[object, ...], test: Callable[[], bool]) -> bool:
        """Return the result of a test, from the cache if it is there."""
        if key not in self._known:
            if len(self._known) >= _MOST_KNOWN:
                self._known.clear()
            self._known[key] = test()
        return self._known[key]


@dataclass(frozen=True, eq=False)
class GroupMeshes:
    """Meshes of the groups of a state."""

    parts: PartMeshes
    """Meshes of all parts."""
    members: Sequence[tuple[int, ...]]
    """Parts of each group."""
    rotation: Float[np.ndarray, "P 3 3"]
    """`group_from_part` of each part."""
    translation: Float[np.ndarray, "P 3"]
    """`group_from_part` of each part [m]."""

    def overlap(self, a: int, layout_from_a: Pose, b: int, layout_from_b: Pose) -> bool:
        """Return whether two groups of a layout overlap."""
        b_from_a = rounded(_relative(layout_from_b, layout_from_a))
        pose = b_from_a[0].tobytes() + b_from_a[1].tobytes()
        own = [
            (self.rotation[p].tobytes(), self.translation[p].tobytes()) for p in (*self.members[a], *self.members[b])
        ]
        return self.parts.known(
            (self.members[a], self.members[b], *own, pose),
            lambda: any(self.parts.overlap(p, q, q_from_p) for p, q, q_from_p, _ in self._pairs(a, b, b_from_a)),
        )

    def blocked(
        self, a: int, layout_from_a: Pose, b: int, layout_from_b: Pose, directions: Float[np.ndarray, "d 3"]
    ) -> Bool[np.ndarray, "d"]:
        """Return along which unit vectors of the layout group `b` is in the way of group `a`."""
        out = np.zeros(len(directions), bool)
        of_b = directions @ layout_from_b[0]
        for p, q, q_from_p, turn in self._pairs(a, b, _relative(layout_from_b, layout_from_a)):
            free = np.flatnonzero(~out)
            if not len(free):
                break
            out[free] = self.parts.blocked(p, q, q_from_p, of_b[free] @ turn)
        return out

    def _pairs(self, a: int, b: int, b_from_a: Pose) -> Iterator[tuple[int, int, Pose, Float[np.ndarray, "3 3"]]]:
        """Yield for each part `p` of `a` and `q` of `b`: both, `q_from_p`, and the rotation of `b_from_q`."""
        for p in self.members[a]:
            turn, shift = b_from_a[0] @ self.rotation[p], b_from_a[0] @ self.translation[p] + b_from_a[1]
            for q in self.members[b]:
                yield p, q, _relative((self.rotation[q], self.translation[q]), (turn, shift)), self.rotation[q]


class _Pair:
    """Two surfaces of which one has a fixed rotation."""

    def __init__(self, a: Mesh, b: Mesh, rotation: Float[np.ndarray, "3 3"]) -> None:
        self._a, self._b = a.bvh, b.bvh
        self._still, self._place = coal.Transform3s.Identity(), coal.Transform3s(rotation, np.zeros(3))
        self._request = collision_request()

    def touch(self, translation: Float[np.ndarray, "3"]) -> bool:
        """Return whether the surfaces touch."""
        self._place.setTranslation(translation)
        result = coal.CollisionResult()
        return bool(coal.collide(self._a, self._place, self._b, self._still, self._request, result))


@lru_cache(maxsize=512)
def _shrunk(mesh: Mesh) -> Mesh | None:
    """Return a mesh with its faces moved inward; the mesh itself if it is too thin, None if it cannot be tested."""
    # Not at the top: `assemble` with search loads no repair.
    from roboassembly.repair.cached import forget
    from roboassembly.repair.surface import Surface, to_manifold, to_surface
    from roboassembly.repair.trim import deflate

    body = to_manifold(Surface(mesh.vertices, mesh.faces))
    if body is None:
        return None
    if len(mesh.faces) > _MANY_FACES:
        body = body.simplify(_SIMPLER)
    if body.num_tri() > _MOST_FACES:
        return None
    smaller = deflate(body, SHRUNK)
    if smaller.num_tri() > _MANY_FACES:
        smaller = smaller.simplify(_SIMPLER)
    surface = to_surface(smaller if smaller.volume() > _LEAST_LEFT * body.volume() else body)
    # Solids that live when Python ends make nanobind complain.
    forget()
    return Mesh(surface.vertices, surface.faces)


def rounded(pose: Pose) -> Pose:
    """Return a pose rounded to fixed steps; rotations near those of a box are exact."""
    rotation, translation = pose
    turn = np.rint(rotation)
    if np.abs(rotation - turn).max() > _COSINE:
        turn = pin.exp3(np.rint(pin.log3(rotation) / _ANGLE) * _ANGLE)
    return turn + 0.0, np.rint(translation / _TRANSLATION) * _TRANSLATION + 0.0


def _relative(first: Pose, second: Pose) -> Pose:
    """Return the second pose in the frame of the first one."""
    return first[0].T @ second[0], (second[1] - first[1]) @ first[0]


def _boxes(
    a: Mesh, b: Mesh, rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3"], ...]:
    """Return the corners of the boxes around a placed mesh and a still one: low, high, low, high."""
    moved, still = a.hull_vertices @ rotation.T + translation, b.bounds
    return moved.min(axis=0), moved.max(axis=0), still[0], still[1]


def _boxes_meet(a: Mesh, b: Mesh, rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> bool:
    low, high, still_low, still_high = _boxes(a, b, rotation, translation)
    return bool((low <= still_high).all() and (high >= still_low).all())


def _travel_to_clear(
    a: Mesh, b: Mesh, rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"],
    directions: Float[np.ndarray, "d 3"],
) -> Float[np.ndarray, "d"]:  # fmt: skip
    """Return how far a mesh moves until its box has left that of a still one; 0 where the boxes never meet [m]."""
    low, high, still_low, still_high = _boxes(a, b, rotation, translation)
    still = (np.broadcast_to(corner, directions.shape) for corner in (low, high, still_low, still_high))
    low, high, still_low, still_high = still
    leave, clear = leave_boxes(low, high, still_low, still_high, directions)
    travel = np.where(clear.any(axis=1), 0.0, np.maximum(leave.min(axis=1), 0.0))
    way = travel[:, None] * directions
    passes = (low + np.minimum(way, 0.0) > still_high) | (high + np.maximum(way, 0.0) < still_low)
    return np.where(passes.any(axis=1), 0.0, travel)


def _is_blocked(
    a: Mesh, b: Mesh, rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"], travel: float,
) -> bool:  # fmt: skip
    """Return whether a still mesh is in the way of one that moves along a direction by `travel` metres."""
    pair = _Pair(a, b, rotation)
    travels = (*_NEAR_STEPS, *np.arange(_NEAR_STEPS[-1] + _STEP, travel, _STEP))
    return any(pair.touch(translation + distance * direction) for distance in travels)
