"""Which part holds which: directional blocking graphs, and the sub-assemblies that can leave along a direction.

Wilson and Latombe 1994, "Geometric Reasoning about Mechanical Assembly". For a direction d there is an arc from part
i to part j if i, moved a little along d, would hit j. A set of parts may leave along d (locally) if no arc leads out
of it. Only neighbours are looked at; the planner judges the rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture
from roboassembly.planning.world import CollisionWorld
from roboassembly.poses import SE3, poses_to_configurations
from roboassembly.scene import Body, Scene, Shape
from roboassembly.task.object_centric import UP_AXES

_SAMPLES = (0.0015, 0.004, 0.01)
"""Metres: beyond any clearance of a joint, and within any depth of one."""
_TOWARD, _AWAY = 0.3, -0.95
"""Cosines with a contact's normal that need no test: plainly into the mate, plainly away from it."""
_SAME = 0.9998
"""Cosine above which two directions are one: 1.1°, what a tenon of 20 mm with 0.4 mm of play forgives."""


class BlockingGraphs:
    """Blocking arcs among the parts of one piece of furniture, for a fixed set of directions, found when asked for."""

    def __init__(self, furniture: Furniture) -> None:
        self._furniture = furniture
        self.states = 0
        """Configurations tested for collision so far."""
        self._worlds: dict[tuple[int, int], CollisionWorld] = {}
        self._known_candidates: dict[frozenset[int], list[tuple[frozenset[int], int]]] = {}

    @cached_property
    def directions(self) -> Float[np.ndarray, "d 3"]:
        """Unit vectors in the furniture's frame: its axes, the parts' long axes, and the contacts' normals."""
        f = self._furniture
        candidates = list(UP_AXES)
        for part, slot in enumerate(f.assembled):
            axis = slot.rotation @ f.parts[part].mesh.long_axis
            candidates.extend([axis, -axis])
        for c in f.connections:
            normal = f.assembled[c.part_a].rotation @ f.parts[c.part_a].points[c.point_a].normal
            candidates.extend([normal, -normal])
        kept: list[Float[np.ndarray, "3"]] = []
        for d in candidates:
            if not any(float(d @ other) > _SAME for other in kept):
                kept.append(d)
        return np.array(kept)

    @cached_property
    def arcs(self) -> list[dict[int, set[int]]]:
        """For each direction: part to the parts that it would hit."""
        out: list[dict[int, set[int]]] = [
            {p: set() for p in range(len(self._furniture.parts))} for _ in self.directions
        ]
        seen: set[tuple[int, int]] = set()
        for c in self._furniture.connections:
            pair = (c.part_a, c.part_b)
            if pair in seen:
                continue
            seen.add(pair)
            blocked = self._blocked(c.part_a, c.part_b)
            for index, d in enumerate(self.directions):
                if blocked[index]:
                    out[index][c.part_a].add(c.part_b)
                # b along d is a along -d, seen from the other side.
                opposite = int(np.argmin(self.directions @ d))
                if blocked[opposite]:
                    out[index][c.part_b].add(c.part_a)
        return out

    def _blocked(self, a: int, b: int) -> list[bool]:
        """Whether `a` hits `b`, for each direction."""
        f = self._furniture
        normals = np.array(
            [
                f.assembled[c.part_a].rotation @ f.parts[c.part_a].points[c.point_a].normal
                for c in f.connections
                if (c.part_a, c.part_b) == (a, b)
            ]
        )
        mover = Body("a", (Shape(f.parts[a].mesh, SE3.Identity()),), f.assembled[a], moves=True)
        mate = Body("b", (Shape(f.parts[b].mesh, SE3.Identity()),), f.assembled[b])
        world = CollisionWorld(Scene((mover, mate), ground=False))
        out = []
        for d in self.directions:
            toward = normals @ d
            if toward.max() > _TOWARD:
                out.append(True)
            elif toward.max() < _AWAY:
                out.append(False)
            else:
                poses = [SE3(mover.pose.rotation, mover.pose.translation + s * d) for s in _SAMPLES]
                out.append(world.first_collision(poses_to_configurations(poses)) is not None)
        self.states += world.states
        return out

    def removable(self, among: frozenset[int], straight: bool) -> Iterator[frozenset[int]]:
        """Sub-assemblies of `among` that no neighbour holds back; small ones and upward ones first.

        Both the sub-assembly and the rest hold together. With `straight`, only those that can go all the way out
        along their direction (no ground, nothing else around).
        """
        given: set[frozenset[int]] = set()
        for closed, direction in self._candidates(among):
            if closed in given or among - closed in given:
                continue
            if straight and not self.leaves(closed, among - closed, direction):
                continue
            given.add(closed)
            yield closed

    def _candidates(self, among: frozenset[int]) -> list[tuple[frozenset[int], int]]:
        """Closed sets with a direction's index each: for every part, the smallest that holds it."""
        if among not in self._known_candidates:
            directions_of: dict[frozenset[int], list[int]] = {}
            for index, arcs in enumerate(self.arcs):
                for closed in {_closure(part, arcs, among) for part in among}:
                    directions_of.setdefault(closed, []).append(index)
            found = [
                (closed, index)
                for closed, indices in directions_of.items()
                if len(closed) < len(among) and self._whole(closed) and self._whole(among - closed)
                for index in indices
            ]
            found.sort(key=lambda item: (len(item[0]), -round(float(self.directions[item[1], 2]), 3), sorted(item[0])))
            self._known_candidates[among] = found
        return self._known_candidates[among]

    def leaves(self, moving: frozenset[int], still: frozenset[int], direction: int) -> bool:
        """Whether `moving` can go straight out of `still`, all the way, along one of `directions`.

        A set leaves straight if each of its parts passes each of the others: far fewer tests than sets.
        """
        stay = _mask(still)
        blocked, free = self._blocks[direction], self._passes[direction]
        if any(blocked[p] & stay for p in moving):
            return False
        unknown = [(p, q) for p in moving if stay & ~free[p] for q in still if not free[p] >> q & 1]
        # Neighbours first: they are the likeliest to be in the way.
        unknown.sort(key=lambda pair: (pair[1] not in self._furniture.neighbours[pair[0]], pair))
        for p, q in unknown:
            passes = self._try_to_pass(p, q, self.directions[direction])
            (free if passes else blocked)[p] |= 1 << q
            if not passes:
                return False
        return True

    @cached_property
    def _blocks(self) -> list[list[int]]:
        """For each direction and part, a bit for each part that it is known to run into on its way out."""
        return [[0] * len(self._furniture.parts) for _ in self.directions]

    @cached_property
    def _passes(self) -> list[list[int]]:
        """As `_blocks`, for parts that it is known to pass."""
        return [[0] * len(self._furniture.parts) for _ in self.directions]

    def _try_to_pass(self, p: int, q: int, d: Float[np.ndarray, "3"]) -> bool:
        if (p, q) not in self._worlds:
            f = self._furniture
            mover, rest = (
                Body(name, (Shape(f.parts[part].mesh, f.assembled[part]),), SE3.Identity(), moves)
                for name, part, moves in (("mover", p, True), ("rest", q, False))
            )
            self._worlds[p, q] = CollisionWorld(Scene((mover, rest), ground=False))
        world = self._worlds[p, q]
        before = world.states
        clear = world.distance_to_clear(SE3.Identity(), d, "rest")
        free = clear == 0.0 or world.edge_is_free(SE3.Identity(), SE3(np.eye(3), (clear + 0.005) * d))
        self.states += world.states - before
        return free

    def _whole(self, parts: frozenset[int]) -> bool:
        return len(self._furniture.connected_components(parts)) == 1


def _mask(parts: frozenset[int]) -> int:
    return sum(1 << p for p in parts)


def _closure(part: int, arcs: dict[int, set[int]], among: frozenset[int]) -> frozenset[int]:
    """The part and all that would have to move with it."""
    closed, stack = {part}, [part]
    while stack:
        for other in arcs[stack.pop()] & among - closed:
            closed.add(other)
            stack.append(other)
    return frozenset(closed)
