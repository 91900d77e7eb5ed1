"""Lookahead with robots: a depth-first search over the merges that a policy expects, down to the finished furniture.

Two hands need room at each joint, so a merge may make another one impossible that comes much later. The values of a
state say so too late, when only bad actions are left. The search takes the best action of each expected state. Where no
action is likely to work, it goes back: only a merge of parts that the dead end keeps apart can help, since all others
lead to the same groups, so it tries such a merge in the last state that has one (conflict-directed backjumping, Prosser
1993, "Hybrid algorithms for the constraint satisfaction problem").
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Float32, Int

from roboassembly.learning.layers import Params
from roboassembly.learning.policy import TIE
from roboassembly.learning.relational.grasps import network as grasping
from roboassembly.learning.relational.grasps.features import GraspedGroups, grasp_features
from roboassembly.learning.relational.policy_view import PolicyView

CLOSE = 0.03
"""Margin by which the value of another pair must be able to exceed the best one, or its grasps are not valued."""
MAX_GRASPED_PAIRS = 12
"""Largest number of pairs whose grasps are valued for one choice."""
_LIKELY = -1.0
"""Log-probability from which on an action is likely to work."""

Groups = frozenset[int]
"""Two groups, each as the number of its first part."""


class GraspValues:
    """Values of grasps; those of two groups that are the same as in another state are computed once.

    Args:
        params: weights of `grasps.network`.
    """

    def __init__(self, params: Params) -> None:
        self._params = params
        self._groups = GraspedGroups()
        self._known: dict[tuple[object, ...], Float32[np.ndarray, "8 8"]] = {}

    def __call__(self, view: PolicyView, u: int, v: int, k: int, l: int) -> Float32[np.ndarray, "8 8"]:  # noqa: E741
        """Return the log-probability that two grasps can carry out a pair; -inf where a grasp does not exist."""
        key: list[object] = [u, v, k, l]
        for part in (u, v):
            members = np.flatnonzero(view.group == view.group[part])
            key += [view.connections[np.ix_(members, members)].tobytes(), view.poses[part].tobytes()]
        if tuple(key) not in self._known:
            self._known[tuple(key)] = grasping.log_probability(
                self._params, grasp_features(view, u, k, v, l, self._groups)
            )
        return self._known[tuple(key)]


@dataclass(frozen=True)
class LikelyAction:
    """Action that is likely to work."""

    action: tuple[int, ...]
    """`(u, v, k, l, g_a, g_b)`."""
    groups: Groups
    """Groups that it joins."""


class RankedActions:
    """Actions of a state that are likely to work. Grasps are valued pair by pair, as far as needed.

    Args:
        view: the state.
        pairs: (P, P, K, K) log-probability of each pair; -inf where it does not exist.
        values: of grasps.
    """

    def __init__(self, view: PolicyView, pairs: Float[np.ndarray, "P P K K"], values: GraspValues) -> None:
        self.view, self.pairs, self._values = view, pairs, values
        likely = np.argwhere(pairs >= _LIKELY)
        order = np.argsort(-pairs[tuple(likely.T)], kind="stable")
        self._likely: list[list[int]] = likely[order].tolist()
        self._valued: dict[tuple[int, ...], tuple[float, LikelyAction]] = {}
        """Best grasps of each pair, as value and action."""

    def best(self, allowed: Callable[[Groups], bool]) -> LikelyAction | None:
        """Return the best action that joins two groups that are allowed; None if none is likely to work."""
        group: list[int] = self.view.group.tolist()
        some = [pair for pair in self._likely if allowed(frozenset((group[pair[0]], group[pair[1]])))]
        new, best = 0, -np.inf
        for pair in some:
            # Pairs come in order, and no action is more probable than its pair.
            if best > self.pairs[tuple(pair)] - CLOSE:
                break
            if tuple(pair) not in self._valued:
                if new == MAX_GRASPED_PAIRS:
                    break
                new += 1
                self._valued[tuple(pair)] = self._value(pair, frozenset((group[pair[0]], group[pair[1]])))
            best = max(best, self._valued[tuple(pair)][0])
        if best < _LIKELY:
            return None
        valued = [self._valued[tuple(pair)] for pair in some if tuple(pair) in self._valued]
        return min((choice for value, choice in valued if value >= best - TIE), key=lambda choice: choice.action)

    def _value(self, pair: Sequence[int], groups: Groups) -> tuple[float, LikelyAction]:
        u, v, k, l = pair  # noqa: E741
        values = self._values(self.view, u, v, k, l)
        best = float(values.max())
        grasps: list[int] = np.array(np.unravel_index(int(np.argmax(values >= best - TIE)), values.shape)).tolist()
        return float(self.pairs[u, v, k, l]) + best, LikelyAction((*pair, *grasps), groups)


Ranking = Callable[[PolicyView], RankedActions]
"""Returns the ranked actions of an expected state."""


class _Node:
    """State on the way that is looked at."""

    def __init__(self, ranked: RankedActions) -> None:
        self.ranked = ranked
        self.choice: LikelyAction | None = None
        self.dead_ends: list[Int[np.ndarray, "P"]] = []
        """Group of each part in the dead ends that followed."""
        self._tried: set[Groups] = set()

    def next_choice(self) -> LikelyAction | None:
        self.choice = self.ranked.best(self._may_help)
        if self.choice is not None:
            self._tried.add(self.choice.groups)
        return self.choice

    def _may_help(self, groups: Groups) -> bool:
        a, b = groups
        return groups not in self._tried and all(end[a] != end[b] for end in self.dead_ends)


def foresee(start: RankedActions, rank: Ranking, limit: int) -> list[Groups] | None:
    """Return the groups that each merge joins on a way to the finished furniture; None if none is found.

    Args:
        start: actions of the present state.
        rank: ranks the actions of expected states.
        limit: largest number of states that are looked at.
    """
    path, states = [_Node(start)], 1
    dead: dict[bytes, list[Int[np.ndarray, "P"]]] = {}
    while path:
        node = path[-1]
        choice = node.next_choice()
        if choice is None:
            group = node.ranked.view.group
            dead[group.tobytes()] = node.dead_ends = node.dead_ends or [group]
            path.pop()
            if path:
                path[-1].dead_ends += node.dead_ends
            continue
        u, v, k, l = choice.action[:4]  # noqa: E741
        after = node.ranked.view.after_merge(u, k, v, l)
        if after.complete:
            return [n.choice.groups for n in path if n.choice is not None]
        if after.group.tobytes() in dead:
            node.dead_ends += dead[after.group.tobytes()]
            continue
        if states == limit:
            return None
        states += 1
        path.append(_Node(rank(after)))
    return None


@dataclass(eq=False)
class ForeseenMerges:
    """Merges that were foreseen, and are followed as long as the states of an episode are those that were expected."""

    _state: tuple[object, ...] | None = field(default=None, init=False)
    """State that is expected next."""
    _merges: list[Groups] | None = field(default=None, init=False)
    """Groups that each merge from there on joins; None if none could be foreseen."""

    def next(self, start: RankedActions, rank: Ranking, limit: int) -> LikelyAction | None:
        """Return the action for the present state; None if no way to the finished furniture is foreseen.

        Args:
            start: see `foresee`, as the others.
            rank: see there.
            limit: see there.
        """
        as_expected = _state_of(start.view, start.view.group) == self._state
        merges = self._merges if as_expected else []
        if merges is None:
            return None
        choice = start.best(lambda _: True)
        # Values of the actual state are better than those that were expected, so what they prefer is looked at first.
        if choice is None or choice.groups not in merges[:1]:
            merges = foresee(start, rank, limit)
            choice = start.best(merges[0].__eq__) if merges else None
        self._merges = merges[1:] if merges else None
        return choice

    def expect(self, view: PolicyView, action: Sequence[int]) -> None:
        """Record which action is taken in a state."""
        joined = view.group[list(action[:2])]
        self._state = _state_of(view, np.where(np.isin(view.group, joined), joined.min(), view.group))


def _state_of(view: PolicyView, group: Int[np.ndarray, "P"]) -> tuple[object, ...]:
    return tuple(view.digests), group.tobytes()
