"""Exploration in place of epsilon-greedy: an episode is repeated with one change, and kept if it leads as far.

Joining right pairs at random nearly always ends with parts that no longer fit in. The agent therefore keeps the episode
that left the fewest groups over, and tries one of the left groups earlier in it (as in "squeaky wheel" optimisation,
Joslin and Clements 1999; returning to a state before exploring is from Go-Explore, Ecoffet et al. 2021). A plan is a
list of pairs of points in the order in which they are to be joined; which group moves and with which choice is what is
known to work, else what worked for these points in other groups, else anything.

It uses the outcomes of the agent's own steps alone, and only says which known or untried action to take next.
"""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Bool, Float

from roboassembly.learning.layers import Params
from roboassembly.learning.paper.dqn.memoized_env import Action, MemoizedEnv, State
from roboassembly.solvers.mate_checks import BLOCKED, FAILS, MERGES, UNKNOWN

Pair = tuple[int, int]
"""Rows of two points, the lower first."""
_PATIENCE = 40
"""Largest number of episodes until all merges of a plan are known."""
_RESTART = 6
"""Number of plans without progress after which a new one starts from nothing."""
_SHAKE = 0.4
"""Share of changes that also move another pair."""
_DEFERRED_SHARES = (0.4, 0.35, 0.15, 0.1)
"""Shares of plans that defer no part, one, two or three until nothing else can be joined. A part may end the episode if
it comes early (a seat across a ring of legs and rungs); where it came early in every plan, nothing else would show
that."""
_WORSE = 0.03
"""Share of plans that are kept although they led less far."""
_FEW = 3
"""Number of groups left with which more choices are tried."""
_SWAP = 4.0
"""Factor of the chance of an action if the same with swapped roles had a goal in collision; its inverse if that had no
path."""
_ORDERED = 0.6
"""Share of plans that close all mates along one axis of the furniture before those along the next: frames first, then
what goes between frames, then what closes them at once. A frame that is closed one mate at a time ends with a rail that
no longer goes in."""
_ORDERS = tuple(itertools.permutations(range(3)))
_NOVELTY_FACTOR, _LEAST_NOVELTY, _DECAY = 2.0, 0.03, 0.995
"""Chance of a novel action where nothing familiar is left: the recent success rate of novel actions times the factor,
and at least the least value; else the episode ends. The counts of successes decay with each episode."""
_MOSTLY_NOVEL, _UNRESTRICTED = 0.4, 0.1
"""Groups with a larger share of novel relative poses are joined in so few of the cases in which novel ones are."""
_STRICT = 0.97
"""Share of plans that first join groups only if the relative poses of their parts were seen before. Which points fit is
found out soon; most steps would otherwise go into pairs that are wrong in other groups because equal parts are in each
other's places."""
_CAREFUL = 0.8
"""Share of plans that first join groups between which nothing else belongs that would no longer go in: a rail goes to
one of its posts before the other."""
_CAUTION = (0.0, 2.0, 5.0, 10.0)
"""Weights against joining parts after which others were left over in earlier episodes; drawn for each plan."""


def pair_of(action: Action) -> Pair:
    """Return the points of an action, the lower number first."""
    return min(action[:2]), max(action[:2])


class PlanExplorer:
    """Improves one plan by small changes."""

    def __init__(self, env: MemoizedEnv, rng: np.random.Generator) -> None:
        self.env, self.rng = env, rng
        self._plan: list[Pair] = []
        """Pairs in the order in which they are tried in this episode."""
        self._done: list[Pair] = []
        """Pairs joined in this episode."""
        self._last: Pair | None = None
        """Pair that is being tried."""
        self._kept: list[Pair] = []
        """Plan that is being improved."""
        self._left = len(env.start) + 1
        """Number of groups that it leaves over."""
        self._episodes = self._idle = 0
        self._caution = float(rng.choice(_CAUTION))
        self._deferred: list[int] = []
        """Parts that are deferred until nothing else can be joined, in the order in which they come then."""
        count = len(env.equal_part)
        self._axes: tuple[int, ...] | None = None
        """Order in which this plan closes mates, by their axes."""
        self._strict = self._careful = True
        self._tries_novel = False
        """Whether the last action joins groups in a novel relative pose."""
        self._novel_outcomes = np.zeros(2)
        """Decayed counts of novel actions that failed, and that merged."""
        self._merges: list[tuple[tuple[int, ...], tuple[int, ...]]] = []
        """Groups joined in this episode."""
        self._together = np.zeros((count, count, count), np.int32)
        """Number of times that two parts were joined before a third."""
        self._left_over = np.zeros((count, count, count), np.int32)
        """Number of times that the third part was then left over."""

    def choose(self, state: State) -> Action | None:
        """Return the next action; None if nothing is left that might work."""
        known = self.env.known(state)
        exists = self.env.exists(state)
        if len(state) == len(self.env.start):
            action = self._never_tried(exists)
            if action is not None:
                return action
        hopeful = self.hopeful(state, known, exists)
        for first in range(len(self._deferred) + 1):
            deferred = np.isin(self.env.part, self._deferred[first:])
            action = self._select(state, hopeful & ~(deferred[:, None] | deferred[None]), known)
            if action is not None:
                return action
        return None

    def _select(self, state: State, hopeful: Bool[np.ndarray, "m m"], known: np.ndarray) -> Action | None:
        """Return an action for the next pair of the plan, or any other pair; None if there is none."""
        self._tries_novel = False
        if self._strict:
            hopeful = self._familiar(state, hopeful, known)
        if self._careful:
            hopeful = self.least_locking(state, hopeful)
        if self._axes is not None:
            hopeful = self._first_axis(state, hopeful)
        for pair in self._plan:
            if hopeful[pair]:
                self._last = pair
                return self.action(pair, known)
        others = np.argwhere(np.triu(hopeful))
        if not len(others):
            return None
        risk = self._risk(state)[self.env.part[others[:, 0]], self.env.part[others[:, 1]]]
        weight = np.exp(-self._caution * (risk - risk.min()))
        row, column = others[self.rng.choice(len(others), p=weight / weight.sum())].tolist()
        self._last = (row, column)
        return self.action(self._last, known)

    def _familiar(self, state: State, hopeful: Bool[np.ndarray, "m m"], known: np.ndarray) -> Bool[np.ndarray, "m m"]:
        """Return the pairs without novel relative poses; if there are none, sometimes all pairs, else none."""
        share = np.zeros(hopeful.shape)
        works = (known == MERGES).any(axis=2)
        pairs = np.argwhere(np.triu(hopeful & ~(works | works.T)))
        rows, columns = pairs.T
        share[rows, columns] = share[columns, rows] = self.env.geometry.novelty(state, pairs)
        novel = share > 0.0
        failed_or_merged = self._novel_outcomes
        chance = max(_NOVELTY_FACTOR * (failed_or_merged[1] + 1.0) / (failed_or_merged.sum() + 2.0), _LEAST_NOVELTY)
        if (hopeful & ~novel).any() and (self._axes is None or not novel.any() or self.rng.random() > chance):
            return hopeful & ~novel
        self._tries_novel = bool(hopeful.any()) and self.rng.random() < chance
        if self._tries_novel and self.rng.random() > _UNRESTRICTED:
            hopeful = hopeful & (share <= _MOSTLY_NOVEL)
        return hopeful & self._tries_novel

    def least_locking(self, state: State, hopeful: Bool[np.ndarray, "m m"]) -> Bool[np.ndarray, "m m"]:
        """Return the pairs that lock the fewest groups out."""
        pairs = np.argwhere(np.triu(hopeful))
        if not len(pairs):
            return hopeful
        out = np.zeros_like(hopeful)
        locked = self.env.geometry.locked_out(state, pairs)
        rows, columns = pairs[locked == locked.min()].T
        out[rows, columns] = out[columns, rows] = True
        return out

    def _first_axis(self, state: State, hopeful: Bool[np.ndarray, "m m"]) -> Bool[np.ndarray, "m m"]:
        """Return the pairs that join along the axis that comes first in the plan's order."""
        pairs = np.argwhere(np.triu(hopeful))
        if not len(pairs):
            return hopeful
        axes = self._axes or ()
        rank = np.array([axes.index(self.env.geometry.axis(state, row, column)) for row, column in pairs.tolist()])
        out = np.zeros_like(hopeful)
        rows, columns = pairs[rank == rank.min()].T
        out[rows, columns] = out[columns, rows] = True
        return out

    def _risk(self, state: State) -> Float[np.ndarray, "P P"]:
        """Return for two parts how many third ones are likely to be left over if their groups are joined now."""
        groups = self.env.members(state)
        equal, together, left = self.env.equal_part, self._together, self._left_over
        mean = (left.sum() + 1.0) / (together.sum() + 2.0)
        excess = np.maximum((left + mean) / (together + 1.0) - mean, 0.0)[equal][:, equal][:, :, equal]
        out = np.zeros((len(equal), len(equal)))
        for i, u_group in enumerate(groups):
            for v_group in groups[:i]:
                rest = np.setdiff1d(np.arange(len(equal)), [*u_group, *v_group])
                risk = excess[list(u_group)][:, list(v_group)][:, :, rest].max(axis=(0, 1)).sum()
                out[np.ix_(u_group, v_group)] = out.T[np.ix_(u_group, v_group)] = risk
        return out

    def hopeful(self, state: State, known: np.ndarray, exists: Bool[np.ndarray, "m m"]) -> Bool[np.ndarray, "m m"]:
        """Return the pairs that were right before and are not given up here; symmetric."""
        works, blocked = (known == MERGES).any(axis=2), (known == BLOCKED).sum(axis=2)
        open_ = (known == UNKNOWN).any(axis=2)
        patience = self.env.check.patience[len(state) <= _FEW]
        open_ = works | works.T | ((open_ | open_.T) & (blocked + blocked.T < patience))
        out = exists & self.env.right_pairs & open_
        if not out.any():
            return out
        # Takes the way to bring two groups together in which most points meet.
        coincident = np.where(out, self.env.geometry.coincident(state), 0)
        owner = self.env.owners(state)
        order = np.argsort(owner, kind="stable")
        starts = np.flatnonzero(np.diff(owner[order], prepend=-2))
        most = np.maximum.reduceat(np.maximum.reduceat(coincident[order[:, None], order], starts, 0), starts, 1)
        at = np.empty(len(order), int)
        at[order] = np.cumsum(np.isin(np.arange(len(order)), starts)) - 1
        return out & (coincident == most[at[:, None], at])

    def _never_tried(self, exists: Bool[np.ndarray, "m m"]) -> Action | None:
        fresh = np.argwhere(np.triu(exists & (self.env.tried.sum(axis=0) == 0)))
        if not len(fresh):
            return None
        row, column = fresh[self.rng.integers(len(fresh))].tolist()
        return row, column, int(self.rng.integers(self.env.choices))

    def action(self, pair: Pair, known: np.ndarray) -> Action:
        """Return which point of a pair moves, and with which choice; `known` is the state's `MemoizedEnv.known`."""
        row, column = pair
        actions = [(a, b, w) for a, b in ((row, column), (column, row)) for w in range(self.env.choices)]
        works = [a for a in actions if known[a] == MERGES]
        if works:
            return works[self.rng.integers(len(works))]
        untried = [a for a in actions if known[a] == UNKNOWN]
        failed, merged = np.array([self.env.outcome_counts(a, b)[:, w] for a, b, w in untried]).T
        hope = ((merged + 0.5) / (failed + merged + 1.0)) ** 2
        if self.env.check.roles_matter:
            # A goal in collision is often one with the ground; then the group that waits should move.
            swapped = np.array([known[b, a, w] for a, b, w in untried])
            hope *= np.select([swapped == FAILS, swapped == BLOCKED], [_SWAP, 1.0 / _SWAP], 1.0)
        return untried[self.rng.choice(len(untried), p=hope / hope.sum())]

    def start_from(self, plan: list[Pair]) -> None:
        """Try a plan next, such as that of a near relative of the chair; its order comes before all caution."""
        self._plan, self._kept = list(plan), list(plan)
        self._strict = self._careful = False
        self._axes, self._deferred = None, []
        self._left, self._episodes, self._idle = len(self.env.start) + 1, 0, 0

    def record_merge(self, state: State, action: Action) -> None:
        """Record that an action merged in a state."""
        self._novel_outcomes[1] += self._tries_novel
        groups = self.env.members(state)
        u_group, v_group = (next(g for g in groups if self.env.part[row] in g) for row in action[:2])
        self._merges.append((u_group, v_group))
        self._done.append(pair_of(action))
        self._last = None

    def end_episode(self, state: State, stuck: bool) -> None:
        """Record that the episode ended in a state, because nothing was left to try or because a try failed."""
        self._episodes += 1
        self._novel_outcomes[0] += self._tries_novel and not stuck and len(state) > 1
        self._novel_outcomes *= _DECAY
        if stuck or self._episodes > _PATIENCE:
            self._judge(state)
            self._change(state)
            self._episodes = 0
        else:
            # The same plan again, as far as it went, now with one choice less to try.
            seen = [*self._done, *([] if self._last is None else [self._last])]
            self._plan = seen + [pair for pair in self._plan if pair not in seen]
        self._done, self._last, self._merges = [], None, []

    def _judge(self, state: State) -> None:
        group_of = np.zeros(len(self.env.equal_part), int)
        for i, parts in enumerate(self.env.members(state)):
            group_of[list(parts)] = i
        equal = self.env.equal_part
        for u_group, v_group in self._merges:
            rest = np.setdiff1d(np.arange(len(equal)), [*u_group, *v_group])
            left = group_of[rest] != group_of[u_group[0]]
            for a, b in ((u_group, v_group), (v_group, u_group)):
                at = np.ix_(equal[list(a)], equal[list(b)], equal[rest])
                np.add.at(self._together, at, 1)
                np.add.at(self._left_over, at, np.broadcast_to(left, (len(a), len(b), len(rest))))
        self._idle = 0 if len(state) < self._left else self._idle + 1
        if len(state) <= self._left or self.rng.random() < _WORSE:
            self._kept, self._left = list(self._done), len(state)
        if self._idle > _RESTART:
            self._kept, self._left, self._idle = [], len(self.env.start) + 1, 0

    def _change(self, state: State) -> None:
        """Make a new plan: the kept one with a pair of what was left over earlier in it."""
        rng, plan = self.rng, list(self._kept)
        self._caution = float(rng.choice(_CAUTION))
        self._strict = bool(rng.random() < _STRICT)
        self._careful = bool(rng.random() < _CAREFUL)
        self._axes = _ORDERS[rng.integers(len(_ORDERS))] if rng.random() < _ORDERED else None
        several = int(rng.choice(len(_DEFERRED_SHARES), p=_DEFERRED_SHARES))
        chances = self._deferral_chances(state)
        self._deferred = rng.choice(len(self.env.equal_part), several, replace=False, p=chances).tolist()
        if not plan:
            self._plan = []
            return
        if rng.random() < _SHAKE:
            plan.insert(int(rng.integers(len(plan))), plan.pop(int(rng.integers(len(plan)))))
        over = self._separated(plan)
        right = np.argwhere(np.triu(over & self.env.right_pairs))
        if len(right):
            row, column = right[rng.integers(len(right))].tolist()
            plan.insert(int(rng.integers(len(plan))), (row, column))
        self._plan = plan

    def _deferral_chances(self, state: State) -> Float[np.ndarray, "P"]:
        """Return the chance that each part is deferred, after an episode that ended in a state; sums to 1.

        Parts with many points, or parts that can be joined to several of the parts to which a group left over belongs,
        are likely: a seat that holds the legs between which a rung was to go.
        """
        part, equal = self.env.part, self.env.equal_part
        first = np.flatnonzero(np.diff(part, prepend=-1))
        fits = np.logical_or.reduceat(np.logical_or.reduceat(self.env.right_pairs, first, 0), first, 1)
        if self.rng.random() < 0.5:
            counts = np.bincount(part).astype(float) ** 2
            return counts / counts.sum()
        weight = np.ones(len(equal))
        groups = sorted(self.env.members(state), key=len)
        for group in groups[:-1]:
            mates = np.array(fits[list(group)].any(axis=0))
            mates[list(group)] = False
            links = (fits & mates).sum(axis=1)
            weight = weight + np.where((links >= 2) & ~mates, links, 0) ** 2
        return weight / weight.sum()

    def _separated(self, plan: list[Pair]) -> Bool[np.ndarray, "m m"]:
        """Return the pairs of points of parts that the plan leaves in different groups."""
        part = self.env.part
        group = np.arange(int(part.max()) + 1)
        for row, column in plan:
            group[group == group[part[row]]] = group[part[column]]
        return group[part][:, None] != group[part][None]

    def to_arrays(self) -> Params:
        """Return all that it takes to go on later."""
        return {
            "plan": np.array(self._plan, np.int32).reshape(-1, 2),
            "done": np.array(self._done, np.int32).reshape(-1, 2),
            "kept": np.array(self._kept, np.int32).reshape(-1, 2),
            "counts": np.array([self._left, self._episodes, self._idle], np.int64),
            "deferred": np.array(self._deferred, np.int64),
            "axes": np.array(self._axes or (), np.int64),
            "flags": np.array([self._strict, self._tries_novel, self._careful]),
            "novel_outcomes": self._novel_outcomes.copy(),
            "last": np.array([] if self._last is None else [self._last], np.int32).reshape(-1, 2),
            "together": self._together.copy(),
            "left_over": self._left_over.copy(),
            "caution": np.array(self._caution),
        }

    def restore(self, arrays: Params) -> None:
        """Go on from what `to_arrays` returned."""
        self._plan, self._done, self._kept = (
            [(a, b) for a, b in arrays[name].tolist()] for name in ("plan", "done", "kept")
        )
        self._together, self._left_over = arrays["together"].copy(), arrays["left_over"].copy()
        self._last = next(((a, b) for a, b in arrays["last"].tolist()), None)
        self._left, self._episodes, self._idle = arrays["counts"].tolist()
        self._deferred = arrays["deferred"].tolist()
        self._axes = tuple(arrays["axes"].tolist()) or None
        self._strict, self._tries_novel, self._careful = (bool(flag) for flag in arrays["flags"])
        self._novel_outcomes = arrays["novel_outcomes"].copy()
        self._caution = float(arrays["caution"])
