"""Which part holds which: directional blocking graphs, and the sub-assemblies that can leave along a direction.

Wilson and Latombe 1994, "Geometric Reasoning about Mechanical Assembly". For a direction d there is an arc from part
i to part j if i, moved a little along d, would hit j. A set of parts may leave along d (locally) if no arc leads out
of it. Only neighbours are looked at; the planner judges the rest.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import cached_property

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, poses_to_configurations
from roboassembly.geometry.scene import Body, Scene, Shape
from roboassembly.planning.world import CollisionWorld
from roboassembly.task.rules.connections import UP_AXES

_SAMPLES = (0.0015, 0.004, 0.01)
"""Metres: beyond any clearance of a joint, and within any depth of one."""
_TOWARD, _AWAY = 0.3, -0.95
"""Cosines with a contact's normal that need no test: plainly into the mate, plainly away from it."""
_SAME = 0.9998
"""Cosine above which two directions are one: 1.1°, what a tenon of 20 mm with 0.4 mm of play forgives."""

Parts = frozenset[int]
"""Slots of the furniture, which is what is reasoned about: equal parts may have swapped theirs."""


class BlockingGraphs:
    """Blocking arcs among the parts of one piece of furniture, for a fixed set of directions, found when asked for."""

    def __init__(self, furniture: Furniture) -> None:
        self._furniture = furniture
        self.states = 0
        """Configurations tested for collision so far."""
        self._worlds: dict[tuple[int, int], CollisionWorld] = {}
        self._known_candidates: dict[int, list[tuple[int, int]]] = {}
        self._lowest: dict[Parts, Float[np.ndarray, "6"]] = {}

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

    def removable(
        self, among: frozenset[int], straight: bool, whole: Collection[frozenset[int]] = ()
    ) -> Iterator[frozenset[int]]:
        """Sub-assemblies of `among` that no neighbour holds back; small ones and upward ones first.

        Both the sub-assembly and the rest hold together. With `straight`, only those that can go all the way out
        along their direction (no ground, nothing else around).

        Args:
            among: parts.
            straight: as said.
            whole: groups that are not to be taken apart.
        """
        kept = [_mask(group) for group in whole]
        everything = _mask(among)
        given: set[int] = set()
        for closed, direction in self._candidates(everything):
            if closed in given or everything - closed in given or any(0 != g & closed != g for g in kept):
                continue
            if straight and not self._leaves(closed, everything - closed, direction):
                continue
            given.add(closed)
            yield frozenset(_bits(closed))

    def _candidates(self, among: int) -> list[tuple[int, int]]:
        """Closed sets with a direction's index each: for every part, the smallest that holds it."""
        if among not in self._known_candidates:
            directions_of: dict[int, list[int]] = {}
            for index, arcs in enumerate(self._arcs):
                for closed in {_closure(1 << part, arcs, among) for part in _bits(among)}:
                    directions_of.setdefault(closed, []).append(index)
            found = [
                (closed, index)
                for closed, indices in directions_of.items()
                if closed != among and self._whole(closed) and self._whole(among - closed)
                for index in indices
            ]
            up = self.directions[:, 2].round(3)
            found.sort(key=lambda item: (item[0].bit_count(), -up[item[1]], _bits(item[0])))
            self._known_candidates[among] = found
        return self._known_candidates[among]

    @cached_property
    def _arcs(self) -> list[list[int]]:
        """`arcs`, a bit for each part that would be hit."""
        return [[_mask(arcs[p]) for p in range(len(self._furniture.parts))] for arcs in self.arcs]

    def leaves(self, moving: frozenset[int], still: frozenset[int], direction: int) -> bool:
        """Whether `moving` can go straight out of `still`, all the way, along one of `directions`.

        A set leaves straight if each of its parts passes each of the others: far fewer tests than sets.
        """
        return self._leaves(_mask(moving), _mask(still), direction)

    def _leaves(self, moving: int, still: int, direction: int) -> bool:
        blocked, free = self._blocks[direction], self._passes[direction]
        movers = _bits(moving)
        if any(blocked[p] & still for p in movers):
            return False
        unknown = [(p, q) for p in movers for q in _bits(still & ~free[p])]
        # Neighbours first: they are the likeliest to be in the way.
        unknown.sort(key=lambda pair: (not self._near[pair[0]] >> pair[1] & 1, pair))
        for p, q in unknown:
            passes = self._try_to_pass(p, q, self.directions[direction])
            (free if passes else blocked)[p] |= 1 << q
            if not passes:
                return False
        return True

    @cached_property
    def _near(self) -> list[int]:
        """For each part, a bit for each that touches it."""
        return [_mask(parts) for parts in self._furniture.neighbours]

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

    def lowest(self, parts: Parts) -> Float[np.ndarray, "6"]:
        """How far the parts reach down when each of the six axes points up, in the furniture's frame."""
        if parts not in self._lowest:
            f = self._furniture
            points = np.concatenate(
                [
                    f.parts[p].mesh.hull_vertices @ f.assembled[p].rotation.T + f.assembled[p].translation
                    for p in sorted(parts)
                ]
            )
            self._lowest[parts] = (points @ UP_AXES.T).min(axis=0)
        return self._lowest[parts]

    def _whole(self, parts: int) -> bool:
        """Whether connections hold the parts together."""
        return _closure(parts & -parts, self._near, parts) == parts


def _mask(parts: Iterable[int]) -> int:
    """A bit for each part."""
    return sum(1 << p for p in parts)


def _bits(mask: int) -> list[int]:
    """The parts of a mask, ascending."""
    out = []
    while mask:
        lowest = mask & -mask
        out.append(lowest.bit_length() - 1)
        mask -= lowest
    return out


def _closure(parts: int, arcs: Sequence[int], among: int) -> int:
    """The parts and all of `among` to which arcs lead from them."""
    closed = fresh = parts
    while fresh:
        lowest = fresh & -fresh
        new = arcs[lowest.bit_length() - 1] & among & ~closed
        closed |= new
        fresh = (fresh - lowest) | new
    return closed
