"""Rules of both settings: free connection points, existing pairs, right pairs, and retreats from a joint."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from roboassembly.furniture.model import Furniture
from roboassembly.task.rules.groups import Group, TaskState
from roboassembly.task.rules.pairs import PairRule
from roboassembly.task.rules.paper_pair_rule import paper_accepts

UP_AXES: Float[np.ndarray, "6 3"] = np.array(
    [[0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], dtype=float
)
"""Axis of the furniture's frame that points up while v's group waits, for each `w`."""
OBJECT_CENTRIC_BRANCHES = (len(UP_AXES),)
"""Number of values of each component of an action after its pair, without robots: of `w`."""
GRASPS = 8
"""Number of grasps of a part: two regions, each from four directions."""
FULL_BRANCHES = (GRASPS, GRASPS)
"""The same with robots: of `g_a` and `g_b`."""
_SLIDES = 0.1
"""Largest absolute cosine between a contact's normal and a direction that slides along the contact."""
_LEAST_LIFT = 0.3
"""Cosine at least between the normal of a contact and the mean normal along which a sliding part is lifted off."""
_SLOPES = (0.03, 0.06)
"""Slopes by which a sliding part is lifted."""
_AGAINST = -0.2
"""Cosine between a retreat and a contact's normal at least. It is negative because a patch's normal is only a mean."""


class Rules:
    """Rules about pairs for one piece of furniture."""

    def __init__(self, furniture: Furniture) -> None:
        self.furniture = furniture

    @cached_property
    def pairs(self) -> PairRule:
        """Rule that judges whether a pair is right."""
        return PairRule(self.furniture)

    def free_points(self, state: TaskState, max_parts: int = 0, max_points: int = 0) -> Bool[np.ndarray, "P K"]:
        """Return the mask of connection points that exist and touch nothing yet.

        Args:
            state: the state.
            max_parts: padding P; the furniture's own number of parts if that is larger.
            max_points: padding K; the largest number of points of a part if that is larger.
        """
        parts, points = len(self.furniture.parts), self.furniture.most_points
        free = np.zeros((max(parts, max_parts), max(points, max_points)), dtype=bool)
        for group in state.groups:
            for part in group.parts:
                free[part, : len(group.points_of(self.furniture, part))] = True
        for part, point in state.occupied(self.furniture):
            free[part, point] = False
        return free

    def existing_pairs(self, state: TaskState, max_parts: int = 0, max_points: int = 0) -> Bool[np.ndarray, "P P K K"]:
        """Return the mask of pairs `(u, v, k, l)` that name free points of parts in different groups.

        The arguments are those of `free_points`.
        """
        free = self.free_points(state, max_parts, max_points)
        group = np.full(len(free), -1)
        for part, index in state.group_of.items():
            group[part] = index
        separate = group[:, None] != group[None]
        return separate[:, :, None, None] & free[:, None, :, None] & free[None, :, None, :]

    def pair_exists(self, state: TaskState, u: int, v: int, k: int, l: int) -> bool:  # noqa: E741
        """Whether `k` and `l` are free points of the parts `u` and `v`, and these are in different groups."""
        n = len(self.furniture.parts)
        if not (0 <= u < n and 0 <= v < n):
            return False
        if state.group_of[u] == state.group_of[v]:
            return False
        for part, point in ((u, k), (v, l)):
            if not 0 <= point < len(state.groups[state.group_of[part]].points_of(self.furniture, part)):
                return False
        return not {(u, k), (v, l)} & state.occupied(self.furniture)

    def paper_accepts(self, state: TaskState, u: int, v: int, k: int, l: int) -> bool:  # noqa: E741
        """Whether the paper's own test accepts a pair of a state; `pairs` is the rule that the environments use."""
        return paper_accepts(self.furniture, state, u, v, k, l)

    def retreats(
        self, u_group: Group, v_group: Group, merged: Group, turn: Float[np.ndarray, "3 3"]
    ) -> list[Float[np.ndarray, "3"]]:
        """Return directions in the furniture's frame along which u's group may leave v's, the most promising first.

        Candidates are the contact normals and their mean, the long axes of the parts that meet, and the axes of the
        furniture; those against a contact's normal are left out. Candidates that slide along a contact come lifted off
        it, too: surfaces of real parts are not exactly parallel.

        Args:
            u_group: group that moves.
            v_group: group that waits.
            merged: both groups, mated.
            turn: `world_from_furniture` while they are joined; of equally good directions the rising one comes first.
        """
        slot_of = dict(zip(merged.parts, merged.slots, strict=True))
        u_slots = {slot_of[p] for p in u_group.parts}
        v_slots = {slot_of[p] for p in v_group.parts}
        normals: list[Float[np.ndarray, "3"]] = []
        axes: list[Float[np.ndarray, "3"]] = [*UP_AXES]
        for slot in sorted(v_slots):
            for k, point in enumerate(self.furniture.parts[slot].points):
                other = self.furniture.mate_of.get((slot, k))
                if other is not None and other[0] in u_slots:
                    normals.append(self.furniture.assembled[slot].rotation @ point.normal)
                    for meeting in (slot, other[0]):
                        own = self.furniture.assembled[meeting].rotation @ self.furniture.parts[meeting].mesh.long_axis
                        axes.extend([own, -own])
        along = np.array(normals)
        mean = along.sum(axis=0)
        if np.linalg.norm(mean) > 1e-6:
            axes.append(mean / np.linalg.norm(mean))
        candidates = np.concatenate([along, np.array(axes)])
        lifted = [lift for d in candidates for lift in lifted_directions(d, along)]
        candidates = np.concatenate([candidates, np.reshape(lifted, (-1, 3))])
        against = (candidates @ along.T).min(axis=1)
        rising = (candidates @ turn.T)[:, 2]
        order = np.argsort(-(against + 0.3 * rising).round(3), kind="stable")
        return [candidates[i] for i in order if against[i] > _AGAINST]


def lifted_directions(
    direction: Float[np.ndarray, "3"], normals: Float[np.ndarray, "c 3"]
) -> list[Float[np.ndarray, "3"]]:
    """Return a direction turned a little away from the contacts that it slides along; none where they are opposed.

    Args:
        direction: unit vector.
        normals: unit vectors along which the contacts separate.
    """
    along = normals @ direction
    slid = normals[np.abs(along) < _SLIDES]
    if not len(slid) or along.min() < -_SLIDES:
        return []
    away = slid.sum(axis=0)
    away /= max(float(np.linalg.norm(away)), 1e-9)
    if (slid @ away).min() < _LEAST_LIFT:
        return []
    turned = [direction + slope * away for slope in _SLOPES]
    return [d / np.linalg.norm(d) for d in turned]
