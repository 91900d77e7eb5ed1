"""Pair rule: whether two groups, mated at two connection points, make a sub-assembly of the furniture.

The merged group, at the relative pose that the two connection frames dictate, must be congruent to a sub-assembly in
which equivalent parts may swap slots. The paper's own test looks at two parts only (`paper_pair_rule`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from roboassembly.furniture.model import Furniture, mate
from roboassembly.geometry.poses import SE3, rotation_angle, rotations_and_translations
from roboassembly.task.rules.groups import Group, TaskState

POSITION_TOLERANCE = 3e-3
"""Distance between a part's centre and its slot's at most [m]. Gaps at the joints of real furniture differ by as much:
four equal legs under a top that is not quite level."""
ANGLE_TOLERANCE = float(np.deg2rad(2.0))
"""Angle between a part and its slot at most, after the best symmetry of its shape [rad]."""
_COSINE = 1.0 + 2.0 * np.cos(ANGLE_TOLERANCE)
_STIFF_POSITION, _STIFF_ANGLE = 1e-5, 1e-4
"""Distance and angle by which parts of one group may move against each other as the group takes other slots [m, rad].
The larger tolerances are for what is not joined yet; a joined group must not be bent into slots that are equal within
tolerance only."""


@dataclass(frozen=True, eq=False)
class Merge:
    """Result of a right pair: the merged group, and the poses of both groups in it."""

    merged: Group
    """Merged group; its `world_from_furniture` is the identity."""
    furniture_from_u: SE3
    """Motion that takes u's group from its own frame into the merged group's frame."""
    furniture_from_v: SE3


class PairRule:
    """Judges pairs for one piece of furniture."""

    def __init__(self, furniture: Furniture) -> None:
        self._furniture = furniture
        self._class_of: Int[np.ndarray, "n"] = np.array(furniture.class_of)
        self._slot_rotations, self._slot_positions = rotations_and_translations(furniture.assembled)
        self._turns: list[Float[np.ndarray, "s 3 3"]] = [c.symmetries for c in furniture.classes]
        self._members: list[Int[np.ndarray, "m"]] = [np.array(c.members) for c in furniture.classes]
        # All rotations of a part of a class in all slots of the class, and the slot of each.
        self._rotations: list[Float[np.ndarray, "r 3 3"]] = [
            (self._slot_rotations[m][:, None] @ t[None]).reshape(-1, 3, 3)
            for m, t in zip(self._members, self._turns, strict=True)
        ]
        self._slots: list[Int[np.ndarray, "r"]] = [
            np.repeat(m, len(t)) for m, t in zip(self._members, self._turns, strict=True)
        ]
        self._places: dict[tuple[object, ...], list[tuple[tuple[int, ...], tuple[SE3, ...]]]] = {}

    def judge_in(self, state: TaskState, u: int, k: int, v: int, l: int) -> Merge | None:  # noqa: E741
        """Return the merge of two groups of a state, with all other groups in mind; see `judge`."""
        u_group, v_group = state.groups[state.group_of[u]], state.groups[state.group_of[v]]
        return self.judge(u_group, v_group, u, k, v, l, state.others(u, v))

    def judge(
        self, u_group: Group, v_group: Group, u: int, k: int, v: int, l: int,  # noqa: E741
        others: Sequence[Group] = (),
    ) -> Merge | None:  # fmt: skip
        """Return the merge that point `k` of part `u` on point `l` of part `v` makes; None if the pair is wrong.

        Args:
            u_group: group of `u`.
            v_group: group of `v`.
            u: part that moves.
            k: its connection point.
            v: part that waits.
            l: its connection point.
            others: groups that need slots of their own. A second side like one of them takes the other slots, or is
                wrong if it does not fit there.
        """
        v_group_from_u_group = self.dictated(u_group, v_group, u, k, v, l)
        frame_of_u = u_group.furniture_from_part[u_group.parts.index(u)]
        frame_of_v = v_group.furniture_from_part[v_group.parts.index(v)]
        members = (*v_group.parts, *u_group.parts)
        poses = (*v_group.furniture_from_part, *(v_group_from_u_group * p for p in u_group.furniture_from_part))
        joined = (range(len(v_group.parts)), range(len(v_group.parts), len(members)))
        order: list[int] = np.argsort(members).tolist()
        joined_others = [g for g in others if len(g.parts) > 1]
        for slots, placed in self._embeddings(members, poses, joined):
            merged = Group(
                tuple(members[i] for i in order),
                tuple(int(slots[i]) for i in order),
                tuple(placed[i] for i in order),
                SE3.Identity(),
            )
            if next(self._disjoint([merged, *joined_others], frozenset()), None) is not None:
                break
        else:
            return None
        # Both groups are exact already; the tolerance is taken up between them.
        exact_u = placed[members.index(u)] * frame_of_u.inverse()
        exact_v = placed[members.index(v)] * frame_of_v.inverse()
        return Merge(merged, exact_u, exact_v)

    def dictated(self, u_group: Group, v_group: Group, u: int, k: int, v: int, l: int) -> SE3:  # noqa: E741
        """Return `v_group_from_u_group` with point `k` of part `u` on point `l` of part `v`, right or wrong."""
        v_from_u = mate(v_group.points_of(self._furniture, v)[l], u_group.points_of(self._furniture, u)[k])
        points_of_u = self._furniture.assembled[u_group.slots[u_group.parts.index(u)]]
        points_of_v = self._furniture.assembled[v_group.slots[v_group.parts.index(v)]]
        return points_of_v * v_from_u * points_of_u.inverse()

    def placements(self, group: Group) -> Iterator[Group]:
        """Yield the group where it is, described by every set of slots that it could take, its own set first."""
        yield group
        for slots, placed in self._other_places(group):
            world = group.world_from_furniture * group.furniture_from_part[0] * placed[0].inverse()
            yield Group(group.parts, slots, placed, world)

    def furniture_frames(self, poses: Sequence[SE3]) -> Iterator[SE3]:
        """Yield each `world_from_furniture` in which parts at `poses` are the assembled furniture.

        There are several if the furniture is symmetric.

        Args:
            poses: `world_from_part` of every part.
        """
        whole = range(len(poses))
        for _, placed in self._embeddings(tuple(whole), tuple(poses), (whole,)):
            yield poses[0] * placed[0].inverse()

    def _other_places(self, group: Group) -> list[tuple[tuple[int, ...], tuple[SE3, ...]]]:
        """Return other sets of slots that a group could take, and the poses of its parts there. Results are cached."""
        turns = np.round([p.rotation for p in group.furniture_from_part], 3) + 0.0
        key = (group.parts, group.slots, turns.tobytes())
        if key not in self._places:
            found: dict[frozenset[int], tuple[tuple[int, ...], tuple[SE3, ...]]] = {}
            joined = (range(len(group.parts)),)
            for slots, placed in self._embeddings(group.parts, group.furniture_from_part, joined):
                other = tuple(slots.tolist())
                found.setdefault(frozenset(other), (other, tuple(placed)))
            found.pop(frozenset(group.slots), None)
            self._places[key] = list(found.values())
        return self._places[key]

    def slot_assignments(self, state: TaskState) -> Iterator[TaskState]:
        """Yield the state described so that every slot is taken once, in each way that its joined groups allow.

        Loose parts take the slots that joined parts of their class leave, their own slot if they can.
        """
        joined = [g for g in state.groups if len(g.parts) > 1]
        loose = [g for g in state.groups if len(g.parts) == 1]
        for described in self._disjoint(joined, frozenset()):
            used = {slot for g in described for slot in g.slots}
            homeless = [g for g in loose if g.parts[0] in used]
            used.update(g.parts[0] for g in loose if g not in homeless)
            moved: dict[Group, Group] = {}
            for group in homeless:
                part = group.parts[0]
                slot = next(m for m in self._furniture.classes[self._furniture.class_of[part]].members if m not in used)
                used.add(slot)
                pose = self._furniture.assembled[slot]
                moved[group] = Group((part,), (slot,), (pose,), group.part_poses()[0] * pose.inverse())
            moved.update(zip(joined, described, strict=True))
            yield TaskState(tuple(moved.get(g, g) for g in state.groups))

    def assign_slots(self, state: TaskState) -> TaskState | None:
        """Return the first of `slot_assignments`; None if the groups share slots in every one."""
        return next(self.slot_assignments(state), None)

    def _disjoint(self, groups: Sequence[Group], used: frozenset[int]) -> Iterator[list[Group]]:
        """Yield placements of several groups that share no slot."""
        if not groups:
            yield []
            return
        for group in self.placements(groups[0]):
            if not used & set(group.slots):
                for others in self._disjoint(groups[1:], used | set(group.slots)):
                    yield [group, *others]

    def _embeddings(
        self, members: tuple[int, ...], poses: tuple[SE3, ...], joined: Sequence[range]
    ) -> Iterator[tuple[Int[np.ndarray, "m"], list[SE3]]]:
        """Yield distinct slots for parts at `poses` after one common motion, the motion with the smallest angle first.

        Args:
            members: indices of the parts.
            poses: pose of each part.
            joined: ranges of `members` that are rigidly joined.
        """
        classes = [self._furniture.class_of[member] for member in members]
        choices = [len(self._slots[c]) for c in classes]
        rotations, positions = rotations_and_translations(poses)
        alike = np.array(classes)[:, None] == self._class_of[None]
        # One part of each joined range in turn fits exactly, so the order of the ranges does not matter.
        anchors = [min(some, key=lambda i: choices[i]) for some in joined]
        for anchor in sorted(anchors, key=lambda i: choices[i]):
            motions = self._rotations[classes[anchor]] @ rotations[anchor].T
            shifts = self._slot_positions[self._slots[classes[anchor]]] - motions @ positions[anchor]
            placed = np.einsum("cij,pj->cpi", motions, positions) + shifts[:, None]
            distance = np.linalg.norm(placed[:, :, None] - self._slot_positions[None, None], axis=3)
            fits = (distance < POSITION_TOLERANCE) & alike[None]
            hopeful = np.flatnonzero(fits.any(axis=2).all(axis=1))
            turned = np.trace(motions[hopeful], axis1=1, axis2=2)
            moved = np.linalg.norm(shifts[hopeful], axis=1)
            for candidate in hopeful[np.lexsort((moved.round(6), -turned.round(6)))].tolist():
                slots = np.argmax(fits[candidate], axis=1)
                if len(set(slots.tolist())) < len(slots):
                    continue
                exact = self._in_slots(classes, slots, motions[candidate] @ rotations)
                if exact is not None and all(_is_rigid([(poses[i], exact[i]) for i in some]) for some in joined):
                    yield slots, exact

    def _in_slots(
        self, classes: Sequence[int], slots: Int[np.ndarray, "m"], rotations: Float[np.ndarray, "m 3 3"]
    ) -> list[SE3] | None:
        """Return each part exactly in its slot, turned by the symmetry nearest to its rotation; None if none fits."""
        out: list[SE3] = []
        for c, slot, rotation in zip(classes, slots.tolist(), rotations, strict=True):
            candidates = self._slot_rotations[slot] @ self._turns[c]
            closeness = np.einsum("wij,ij->w", candidates, rotation)
            best = int(np.argmax(closeness))
            if closeness[best] < _COSINE:
                return None
            out.append(SE3(candidates[best], self._slot_positions[slot]))
        return out


def _is_rigid(moved: Sequence[tuple[SE3, SE3]]) -> bool:
    """Whether one motion takes all first poses to the second poses."""
    motion = moved[0][1] * moved[0][0].inverse()
    for before, after in moved[1:]:
        there = motion * before
        if np.linalg.norm(there.translation - after.translation) > _STIFF_POSITION:
            return False
        if rotation_angle(there.rotation.T @ after.rotation) > _STIFF_ANGLE:
            return False
    return True
