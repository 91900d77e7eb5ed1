"""Directional blocking graphs: the parts that block each other, and the sub-assemblies that can be removed.

Wilson and Latombe 1994, "Geometric Reasoning about Mechanical Assembly". For a direction d there is an arc from part
i to part j if i, moved a little along d, would hit j. A set of parts may leave along d (locally) if no arc leads out
of it. The graphs test neighbours only; the planner judges the rest.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import cached_property
from itertools import groupby

import numpy as np
from jaxtyping import Bool, Float

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.mating import distinct_directions
from roboassembly.geometry.poses import SE3, poses_to_configurations, shifted, transform_points
from roboassembly.geometry.scene import Body, Scene, Shape
from roboassembly.planning.world import CollisionWorld, leave_boxes
from roboassembly.task.rules.connections import UP_AXES

_SAMPLES = (0.0015, 0.004, 0.01)
"""Test displacements [m]: larger than the clearance of any connection, smaller than its depth."""
_TOWARD, _AWAY = 0.3, -0.95
"""Cosines with a contact's normal above and below which no test is needed: into the mate, away from it."""
_BEYOND = 0.005
"""Travel of a part beyond the point where it is clear of another one [m]."""
_SAME = 0.9998
"""Cosine above which two directions count as equal: 1.1°, the tolerance of a 20 mm tenon with 0.4 mm of play."""

Parts = frozenset[int]
"""Slots of the furniture. Solvers reason about slots, because equal parts may have swapped theirs."""


class BlockingGraphs:
    """Blocking arcs among the parts of one piece of furniture, for a fixed set of directions; computed on demand."""

    def __init__(self, furniture: Furniture) -> None:
        self._furniture = furniture
        self.states = 0
        """Configurations tested for collision so far."""
        self._worlds: dict[tuple[int, int], CollisionWorld] = {}
        self._known_candidates: dict[int, list[tuple[int, int]]] = {}
        self._clear_of: dict[tuple[int, int], tuple[Bool[np.ndarray, "n"], Bool[np.ndarray, "n"]]] = {}
        self._exits: dict[tuple[Parts, Parts], Float[np.ndarray, "n 3"]] = {}
        self._lowest: dict[Parts, Float[np.ndarray, "6"]] = {}
        self._hull_points: dict[Parts, Float[np.ndarray, "n 3"]] = {}

    @cached_property
    def directions(self) -> Float[np.ndarray, "d 3"]:
        """Unit vectors in the furniture's frame: its axes, the long axes of its parts, and the contact normals."""
        f = self._furniture
        candidates = list(UP_AXES)
        for part, slot in enumerate(f.assembled):
            axis = slot.rotation @ f.parts[part].mesh.long_axis
            candidates.extend([axis, -axis])
        for c in f.connections:
            normal = f.assembled[c.part_a].rotation @ f.parts[c.part_a].points[c.point_a].normal
            candidates.extend([normal, -normal])
        return np.array(distinct_directions(candidates, _SAME))

    @cached_property
    def arcs(self) -> list[dict[int, set[int]]]:
        """Mapping of each part to the parts that it would hit, one mapping per direction."""
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
                # Moving b along d is the same as moving a along -d.
                opposite = int(np.argmin(self.directions @ d))
                if blocked[opposite]:
                    out[index][c.part_b].add(c.part_a)
        return out

    def _blocked(self, a: int, b: int) -> list[bool]:
        """Return for each direction whether `a` hits `b`."""
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
        out: list[bool] = []
        for d in self.directions:
            toward = normals @ d
            if toward.max() > _TOWARD:
                out.append(True)
            elif toward.max() < _AWAY:
                out.append(False)
            else:
                poses = [shifted(mover.pose, s * d) for s in _SAMPLES]
                out.append(world.first_collision(poses_to_configurations(poses)) is not None)
        self.states += world.states
        return out

    def removable(
        self, among: frozenset[int], straight: bool, whole: Collection[frozenset[int]] = ()
    ) -> Iterator[frozenset[int]]:
        """Yield the sub-assemblies of `among` that no neighbour blocks; small ones and upward ones first.

        Both the sub-assembly and the rest are connected.

        Args:
            among: parts that are joined.
            straight: yield only sub-assemblies that can move all the way out along their direction, with no ground
                and no other parts present.
            whole: groups that must not be split.
        """
        kept = [_mask(group) for group in whole if len(group) > 1]
        everything = _mask(among)
        given: set[int] = set()
        for closed, direction in self._candidates(everything):
            if closed in given or everything - closed in given or any(0 != g & closed != g for g in kept):
                continue
            if not (self._whole(closed) and self._whole(everything - closed)):
                continue
            if straight and not self._leaves(closed, everything - closed, direction):
                continue
            given.add(closed)
            yield frozenset(_bits(closed))

    def _candidates(self, among: int) -> Iterator[tuple[int, int]]:
        """Yield for every part and direction the smallest closed set with that part, and the direction's index.

        Smaller sets come first, of one size those that move up. The sets and their complements need not be connected.
        """
        up = (-self.directions[:, 2].round(3)).tolist()
        parts = _bits(among)
        for _, same in groupby(sorted(range(len(up)), key=up.__getitem__), key=up.__getitem__):
            alike = list(same)
            for part in parts if len(parts) > 1 else ():
                yield from ((1 << part, index) for index in alike if not self._arcs[index][part] & among)
        if among not in self._known_candidates:
            found = [
                (closed, index)
                for index, arcs in enumerate(self._arcs)
                for closed in _closures(arcs, among)
                if closed != among and closed & (closed - 1)
            ]
            digits = len(self._furniture.parts)
            # Sets of one size are in the order of their parts: their masks read from the lowest bit are decreasing.
            found.sort(key=lambda item: (item[0].bit_count(), up[item[1]], -int(f"{item[0]:0{digits}b}"[::-1], 2)))
            self._known_candidates[among] = found
        yield from self._known_candidates[among]

    @cached_property
    def _arcs(self) -> list[list[int]]:
        """`arcs` as bit masks of the parts that would be hit."""
        return [[_mask(arcs[p]) for p in range(len(self._furniture.parts))] for arcs in self.arcs]

    def straight_exits(self, moving: Parts, still: Parts) -> Float[np.ndarray, "n 3"]:
        """Return those of `directions` in which `moving` can move straight and completely out of `still`."""
        key = (moving, still)
        if key not in self._exits:
            found = [
                d
                for index, (d, arcs) in enumerate(zip(self.directions, self.arcs, strict=True))
                if not any(arcs[p] & still for p in moving) and self.leaves(moving, still, index)
            ]
            self._exits[key] = np.array(found).reshape(-1, 3)
            self._exits[still, moving] = -self._exits[key]
        return self._exits[key]

    def leaves(self, moving: frozenset[int], still: frozenset[int], direction: int) -> bool:
        """Return whether `moving` can move straight out of `still`, all the way, along one of `directions`.

        A set can leave if each of its parts passes each part of the other set, so the tests are shared among sets.
        """
        return self._leaves(_mask(moving), _mask(still), direction)

    def _leaves(self, moving: int, still: int, direction: int) -> bool:
        blocked, free = self._blocks[direction], self._passes[direction]
        movers = _bits(moving)
        if any(blocked[p] & still for p in movers):
            return False
        unknown = [(p, q) for p in movers for q in _bits(still & ~free[p])]
        # Neighbours come first: they are most likely to block.
        unknown.sort(key=lambda pair: (not self._near[pair[0]] >> pair[1] & 1, pair))
        for p, q in unknown:
            passes = self._boxes_pass(p, q, direction) or self._try_to_pass(p, q, self.directions[direction])
            (free if passes else blocked)[p] |= 1 << q
            if not passes:
                return False
        return True

    def _boxes_pass(self, p: int, q: int, direction: int) -> bool:
        """Return whether the box around `p`, on its way out along a direction, stays clear of the box around `q`."""
        if (p, direction) not in self._clear_of:
            self._clear_of[p, direction] = self._clear_boxes(p, self.directions[direction])
        away, aside = self._clear_of[p, direction]
        # The planner counts one box test as a state, unless the boxes are apart without motion.
        self.states += bool(aside[q] and not away[q])
        return bool(aside[q])

    def _clear_boxes(self, p: int, d: Float[np.ndarray, "3"]) -> tuple[Bool[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
        """Return of which boxes the box around `p` is clear as it leaves along `d`: without motion, and on the way."""
        low, high = self._boxes
        leave, separate = leave_boxes(low[p], high[p], low, high, d)
        distance = np.where(separate.any(axis=1), 0.0, np.maximum(leave.min(axis=1), 0.0))
        way = (distance + _BEYOND)[:, None] * d
        swept_low, swept_high = low[p] + np.minimum(way, 0.0), high[p] + np.maximum(way, 0.0)
        away = distance == 0.0
        return away, away | ~((swept_low <= high) & (swept_high >= low)).all(axis=1)

    @cached_property
    def _boxes(self) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Lowest and highest corners of the boxes around the parts, furniture frame [m]."""
        f = self._furniture
        corners = [
            transform_points(slot, part.mesh.hull_vertices) for slot, part in zip(f.assembled, f.parts, strict=True)
        ]
        return np.array([c.min(axis=0) for c in corners]), np.array([c.max(axis=0) for c in corners])

    @cached_property
    def _near(self) -> list[int]:
        """Bit masks of the parts that touch each part."""
        return [_mask(parts) for parts in self._furniture.neighbours]

    @cached_property
    def _blocks(self) -> list[list[int]]:
        """Bit masks, per direction and part, of the parts that are known to block its exit."""
        return [[0] * len(self._furniture.parts) for _ in self.directions]

    @cached_property
    def _passes(self) -> list[list[int]]:
        """Bit masks, per direction and part, of the parts that it is known to pass."""
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
        free = clear == 0.0 or world.edge_is_free(SE3.Identity(), SE3(np.eye(3), (clear + _BEYOND) * d))
        self.states += world.states - before
        return free

    def lowest(self, parts: Parts) -> Float[np.ndarray, "6"]:
        """Return the height of the parts' lowest point for each of the six axes as up [m], furniture frame."""
        if parts not in self._lowest:
            self._lowest[parts] = self.lowest_along(parts, UP_AXES)
        return self._lowest[parts]

    def lowest_along(self, parts: Parts, axes: Float[np.ndarray, "w 3"]) -> Float[np.ndarray, "w"]:
        """Return the height of the parts' lowest point with each of some axes as up [m], furniture frame."""
        if parts not in self._hull_points:
            f = self._furniture
            points = [transform_points(f.assembled[p], f.parts[p].mesh.hull_vertices) for p in sorted(parts)]
            self._hull_points[parts] = np.concatenate(points)
        return (self._hull_points[parts] @ axes.T).min(axis=0)

    def _whole(self, parts: int) -> bool:
        """Return whether the parts are connected."""
        return _closure(parts & -parts, self._near, parts) == parts


def contained_in(inner: tuple[Parts, Parts], outer: tuple[Parts, Parts]) -> bool:
    """Return whether each of two sub-assemblies is part of another one of two."""
    (a, b), (u, v) = inner, outer
    return (a <= u and b <= v) or (a <= v and b <= u)


def _mask(parts: Iterable[int]) -> int:
    """Return the bit mask of some parts."""
    return sum(1 << p for p in parts)


def _bits(mask: int) -> list[int]:
    """Return the parts of a mask, ascending."""
    out: list[int] = []
    while mask:
        lowest = mask & -mask
        out.append(lowest.bit_length() - 1)
        mask -= lowest
    return out


def _closure(parts: int, arcs: Sequence[int], among: int) -> int:
    """Return the parts and all parts of `among` that arcs reach from them."""
    closed = fresh = parts
    while fresh:
        lowest = fresh & -fresh
        new = arcs[lowest.bit_length() - 1] & among & ~closed
        closed |= new
        fresh = (fresh - lowest) | new
    return closed


def _closures(arcs: Sequence[int], among: int) -> list[int]:
    """Return the distinct closures of the single parts of `among`, by Tarjan's strongly connected components."""
    order: dict[int, int] = {}
    low: dict[int, int] = {}
    closure: dict[int, int] = {}
    path: list[int] = []
    found: dict[int, None] = {}
    for root in _bits(among):
        if root in order:
            continue
        order[root] = low[root] = len(order)
        path.append(root)
        work = [(root, arcs[root] & among)]
        while work:
            part, left = work.pop()
            while left:
                lowest = left & -left
                left -= lowest
                other = lowest.bit_length() - 1
                if other not in order:
                    work.append((part, left))
                    order[other] = low[other] = len(order)
                    path.append(other)
                    part, left = other, arcs[other] & among
                elif other not in closure:
                    low[part] = min(low[part], order[other])
            if low[part] == order[part]:
                start = path.index(part)
                closed = 0
                for member in path[start:]:
                    closed |= 1 << member
                    for other in _bits(arcs[member] & among):
                        closed |= closure.get(other, 0)
                closure.update(dict.fromkeys(path[start:], closed))
                del path[start:]
                found[closed] = None
            if work:
                parent = work[-1][0]
                low[parent] = min(low[parent], low[part])
    return list(found)
