"""Tests whether two hands can join two sub-assemblies: everything of a merge with robots but the arms.

The answer depends on the furniture alone, so it is worked out once for each pair of sub-assemblies.
"""

from __future__ import annotations

from collections import defaultdict

from roboassembly.solvers.blocking import Parts
from roboassembly.solvers.options import End, fitting
from roboassembly.task.full.failure import Failure
from roboassembly.task.full.task import FullTask
from roboassembly.task.rules.groups import TaskState, group_in_place

_MOST_TESTS = 400
"""Number of pairs of sub-assemblies at whose joints hands are tested before `may_join` tests no further pair."""
_MOST_TESTS_OF_ORDERS = 2_000
"""Number of such pairs before `can_join` tests no further pair."""


class HandJoints:
    """Memoized tests of two hands at the joints between sub-assemblies of one piece of furniture.

    Args:
        task: task of the piece.
    """

    def __init__(self, task: FullTask) -> None:
        self._task = task
        self._furniture = task.furniture
        self.tests = 0
        """Number of pairs of sub-assemblies tested so far; answers that follow from others do not count."""
        self._known: dict[tuple[Parts, Parts], bool] = {}
        self._last_grasps: dict[frozenset[End], tuple[int, int]] = {}
        """Grasps that joined two points last, the grasp at the part with the lower index first."""
        self._joined: defaultdict[tuple[End, End], list[tuple[Parts, Parts]]] = defaultdict(list)
        """Moving and waiting groups between which hands join two points."""
        self._not_joined: defaultdict[tuple[End, End], list[tuple[Parts, Parts]]] = defaultdict(list)
        """Moving and waiting groups between which no hands join two points."""

    def join(self, moving: Parts, waiting: Parts) -> bool:
        """Return whether R_a can bring `moving` straight to `waiting`, which R_b holds, if arms reach everywhere.

        Args:
            moving: slots of a sub-assembly.
            waiting: slots of the other one.
        """
        answer = self._known_answer(moving, waiting)
        if answer is None:
            answer = self._known[moving, waiting] = self._test(moving, waiting)
        return answer

    def may_join(self, first: Parts, second: Parts) -> bool:
        """Return whether `join` holds with either in the hand of R_a.

        After `_MOST_TESTS` it holds for all pairs but those whose answer is known or follows from others.
        """
        return self._either_joins(first, second, _MOST_TESTS)

    def can_join(self, first: Parts, second: Parts) -> bool:
        """Return whether `join` holds with either in the hand of R_a, by tests also where `may_join` makes none.

        After `_MOST_TESTS_OF_ORDERS` it makes none, either.
        """
        return self._either_joins(first, second, _MOST_TESTS_OF_ORDERS)

    def _either_joins(self, first: Parts, second: Parts, most_tests: int) -> bool:
        if self.tests < most_tests:
            return self.join(first, second) or self.join(second, first)
        return self._known_answer(first, second) is not False or self._known_answer(second, first) is not False

    def _known_answer(self, moving: Parts, waiting: Parts) -> bool | None:
        """Return `join` without a test; None if that takes one.

        Two hands that have room at a joint also have it with fewer parts around, so most answers follow from others.
        """
        key = (moving, waiting)
        if key not in self._known:
            joints = self._open_joints(moving, waiting)
            if not joints:
                self._known[key] = False
            elif any(moving <= u and waiting <= v for joint in joints for u, v in self._joined[joint]):
                self._known[key] = True
        return self._known.get(key)

    def _open_joints(self, moving: Parts, waiting: Parts) -> list[tuple[End, End]]:
        """Return the joints between two groups, less those that no hands join between some of their parts."""
        return [
            joint
            for joint in self._furniture.joints_between(moving, waiting)
            if not any(u <= moving and v <= waiting for u, v in self._not_joined[joint])
        ]

    def _test(self, moving: Parts, waiting: Parts) -> bool:
        joints = self._open_joints(moving, waiting)
        self.tests += 1
        state = TaskState((group_in_place(self._furniture, moving), group_in_place(self._furniture, waiting)))
        found = None
        if any(self._separates(state, *joint) for joint in joints):
            found = next((joint for joint in joints if self._same_grasps_join(state, *joint)), None)
            found = found or self._joint_of_any_grasps(state, joints)
        if found is None:
            for joint in joints:
                self._not_joined[joint].append((moving, waiting))
            return False
        self._joined[found].append((moving, waiting))
        return True

    def _separates(self, state: TaskState, u_end: End, v_end: End) -> bool:
        """Return whether the groups come straight apart if no hand holds them: without that, no grasps help."""
        merge = self._task.merge(state, (u_end[0], v_end[0], u_end[1], v_end[1]))
        u_group, v_group = state.groups
        return merge is not None and self._task.separates(u_group, v_group, merge)

    def _joint_of_any_grasps(self, state: TaskState, joints: list[tuple[End, End]]) -> tuple[End, End] | None:
        """Return a joint at which some grasps join two groups; None if there is none."""
        action = next(fitting(self._task, state, joints, lazy=True), None)
        if action is None:
            return None
        u, v, k, m, g_a, g_b = action
        self._last_grasps[frozenset(((u, k), (v, m)))] = (g_a, g_b) if u < v else (g_b, g_a)
        return (u, k), (v, m)

    def _same_grasps_join(self, state: TaskState, u_end: End, v_end: End) -> bool:
        """Return whether the grasps that joined two points before join them here too.

        A hand that has room in a group mostly has room in similar groups.
        """
        grasps = self._last_grasps.get(frozenset((u_end, v_end)))
        if grasps is None:
            return False
        g_a, g_b = grasps if u_end[0] < v_end[0] else grasps[::-1]
        action = (u_end[0], v_end[0], u_end[1], v_end[1], g_a, g_b)
        return not isinstance(self._task.hands_merge(state, action), Failure)
