"""Exploration by practice: a play is repeated with one thing changed, and kept if it leads at least as far.

Joining right pairs at random nearly always ends with parts that no longer fit in. So a learner holds on to the play
that left the fewest groups over, and tries one of the groups left over earlier in it (as in "squeaky wheel"
optimisation, Joslin and Clements 1999; returning to where one was before exploring is Go-Explore's, Ecoffet et al.
2021). A play is a list of pairs of points in the order in which they are to be joined; which group moves and with which
`w` is whatever is known to work, else what worked for these points in other groups, else anything.

It rests on outcomes of the learner's own steps alone, and only tells which known or untried action to take next.
"""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Bool, Float

from roboassembly.learning.layers import Params
from roboassembly.learning.paper.dqn.memoized_env import Action, Rehearsal, State
from roboassembly.learning.paper.dqn.trials import BLOCKED, FAILS, MERGES, UNKNOWN

Pair = tuple[int, int]
"""Rows of two points, the lower first."""
_PATIENCE = 40
"""Episodes that one play may take until all its merges are known."""
_RESTART = 6
"""Plays without progress after which an altogether new one is begun."""
_SHAKE = 0.4
"""Share of changes that also move some other pair."""
_DELAYED = (0.4, 0.35, 0.15, 0.1)
"""Shares of plays in which no part, one, two or three are left out until nothing else can be joined. Where a part ends
it all if it comes early (a seat across a ring of legs and rungs), and every play so far had it early, nothing else
would tell."""
_WORSE = 0.03
"""Share of plays that are kept although they led less far."""
_FEW = 3
"""Groups left with which it is worth it to try more ways."""
_SWAP = 4.0
"""How much more likely an action is tried whose roles, swapped, had no free goal; and less, if they had no path."""
_ORDERED = 0.6
"""Share of plays that close all joints along one axis of the furniture before those along the next: frames first, then
what goes between frames, then what closes them all at once. A frame that is closed one joint at a time ends with a rail
that no longer goes in."""
_ORDERS = tuple(itertools.permutations(range(3)))
_DARE, _LEAST, _FORGET = 2.0, 0.03, 0.995
"""With nothing familiar left, a strange action is tried as often as such have merged lately, times `_DARE`, and at
least so often; else the play is over. What is lately forgets so much an episode."""
_MOSTLY_STRANGE, _RECKLESS = 0.4, 0.1
"""Where more than this share of it is strange, groups are joined in so few of the cases in which strange ones are."""
_STRICT = 0.97
"""Share of plays that first join only groups whose parts then lie to each other as was seen before. Which points fit
has been found out soon; that the same points are a wrong pair in other groups, because equal parts are in each other's
places, is what most steps would otherwise go into."""
_CAREFUL = 0.8
"""Share of plays that first join groups between which nothing else belongs that would no longer go in: a rail goes to
one of its posts before the other."""
_CAUTION = (0.0, 2.0, 5.0, 10.0)
"""How much a play avoids joining parts after which others were left over in earlier plays; drawn for each play."""


class Practice:
    """Improves one play by small changes."""

    def __init__(self, rehearsal: Rehearsal, rng: np.random.Generator) -> None:
        self.rehearsal, self.rng = rehearsal, rng
        self._plan: list[Pair] = []
        """Pairs in the order in which they are tried in this play."""
        self._done: list[Pair] = []
        """Those joined in this episode."""
        self._last: Pair | None = None
        """The one that is being tried."""
        self._kept: list[Pair] = []
        """The play that is being improved, ..."""
        self._left = len(rehearsal.start) + 1
        """... and how many groups it leaves over."""
        self._episodes = self._idle = 0
        self._caution = float(rng.choice(_CAUTION))
        self._late: list[int] = []
        """Parts that are left out until nothing else can be joined, in the order in which they then come."""
        count = len(rehearsal.like)
        self._axes: tuple[int, ...] | None = None
        """The order in which this play closes joints, by their axes."""
        self._strict = self._careful = True
        self._daring = False
        """Whether the action that was told last joins groups in a strange way."""
        self._dared = np.zeros(2)
        """How often that failed, and merged, lately."""
        self._merges: list[tuple[tuple[int, ...], tuple[int, ...]]] = []
        """Groups joined in this episode."""
        self._together = np.zeros((count, count, count), np.int32)
        """How often two parts were joined before a third was, ..."""
        self._left_over = np.zeros((count, count, count), np.int32)
        """... and how often that was then left over."""

    def choose(self, state: State) -> Action | None:
        """The next action; None if nothing is left that might work."""
        known = self.rehearsal.known(state)
        exists = self.rehearsal.exists(state)
        if len(state) == len(self.rehearsal.start):
            pick = self._never_tried(exists)
            if pick is not None:
                return pick
        hopeful = self._hopeful(state, known, exists)
        for first in range(len(self._late) + 1):
            late = np.isin(self.rehearsal.part, self._late[first:])
            pick = self._pick(state, hopeful & ~(late[:, None] | late[None]), known)
            if pick is not None:
                return pick
        return None

    def _pick(self, state: State, hopeful: Bool[np.ndarray, "m m"], known: np.ndarray) -> Action | None:
        """The next pair of the plan, or any other; None if there is none."""
        self._daring = False
        if self._strict:
            hopeful = self._sure(state, hopeful, known)
        if self._careful:
            hopeful = self._unlocked(state, hopeful)
        if self._axes is not None:
            hopeful = self._in_order(state, hopeful)
        for pair in self._plan:
            if hopeful[pair]:
                return self._way(pair, known)
        others = np.argwhere(np.triu(hopeful))
        if not len(others):
            return None
        risk = self._risk(state)[self.rehearsal.part[others[:, 0]], self.rehearsal.part[others[:, 1]]]
        weight = np.exp(-self._caution * (risk - risk.min()))
        row, column = others[self.rng.choice(len(others), p=weight / weight.sum())].tolist()
        return self._way((row, column), known)

    def _sure(self, state: State, hopeful: Bool[np.ndarray, "m m"], known: np.ndarray) -> Bool[np.ndarray, "m m"]:
        """Of the pairs those that nothing speaks against; where there are none, sometimes all of them, else none."""
        share = np.zeros(hopeful.shape)
        for row, column in np.argwhere(np.triu(hopeful)).tolist():
            works = (known[row, column] == MERGES).any() or (known[column, row] == MERGES).any()
            strangeness = 0.0 if works else self.rehearsal.joints.strange(state, row, column)
            share[row, column] = share[column, row] = strangeness
        strange = share > 0.0
        chance = max(_DARE * (self._dared[1] + 1.0) / (self._dared.sum() + 2.0), _LEAST)
        if (hopeful & ~strange).any() and (self._axes is None or not strange.any() or self.rng.random() > chance):
            return hopeful & ~strange
        self._daring = bool(hopeful.any()) and self.rng.random() < chance
        if self._daring and self.rng.random() > _RECKLESS:
            hopeful = hopeful & (share <= _MOSTLY_STRANGE)
        return hopeful & self._daring

    def _unlocked(self, state: State, hopeful: Bool[np.ndarray, "m m"]) -> Bool[np.ndarray, "m m"]:
        """Of the pairs those that lock fewest groups out."""
        pairs = np.argwhere(np.triu(hopeful))
        if not len(pairs):
            return hopeful
        out = np.zeros_like(hopeful)
        locked = np.array([self.rehearsal.joints.locked_out(state, row, column) for row, column in pairs.tolist()])
        rows, columns = pairs[locked == locked.min()].T
        out[rows, columns] = out[columns, rows] = True
        return out

    def _in_order(self, state: State, hopeful: Bool[np.ndarray, "m m"]) -> Bool[np.ndarray, "m m"]:
        """Of the pairs those that join along the axis that is first in the play's order."""
        pairs = np.argwhere(np.triu(hopeful))
        if not len(pairs):
            return hopeful
        axes = self._axes or ()
        rank = np.array([axes.index(self.rehearsal.joints.axis(state, row, column)) for row, column in pairs.tolist()])
        out = np.zeros_like(hopeful)
        rows, columns = pairs[rank == rank.min()].T
        out[rows, columns] = out[columns, rows] = True
        return out

    def _risk(self, state: State) -> Float[np.ndarray, "P P"]:
        """For two parts, how many third ones are likely to be left over if their groups are joined now."""
        groups = self.rehearsal.members(state)
        like, together, left = self.rehearsal.like, self._together, self._left_over
        mean = (left.sum() + 1.0) / (together.sum() + 2.0)
        excess = np.maximum((left + mean) / (together + 1.0) - mean, 0.0)[like][:, like][:, :, like]
        out = np.zeros((len(like), len(like)))
        for i, one in enumerate(groups):
            for two in groups[:i]:
                rest = np.setdiff1d(np.arange(len(like)), [*one, *two])
                risk = excess[list(one)][:, list(two)][:, :, rest].max(axis=(0, 1)).sum()
                out[np.ix_(one, two)] = out.T[np.ix_(one, two)] = risk
        return out

    def _hopeful(self, state: State, known: np.ndarray, exists: Bool[np.ndarray, "m m"]) -> Bool[np.ndarray, "m m"]:
        """Pairs that were right before and are not given up here; symmetric."""
        works, blocked = (known == MERGES).any(axis=2), (known == BLOCKED).sum(axis=2)
        open_ = (known == UNKNOWN).any(axis=2)
        open_ = (
            works
            | works.T
            | ((open_ | open_.T) & (blocked + blocked.T < self.rehearsal.trial.patience[len(state) <= _FEW]))
        )
        out = exists & (self.rehearsal.tried[1] > 0) & open_
        if not out.any():
            return out
        # Of the ways to bring two groups together, the one in which most points meet.
        meets = np.where(out, self.rehearsal.joints.meets(state), 0)
        owner = self.rehearsal.owners(state)
        member = np.array([owner == name for name in state])
        most = np.array([[meets[np.ix_(a, b)].max(initial=0) for b in member] for a in member])
        at = np.argmax(member, axis=0)
        return out & (meets == most[at][:, at])

    def _never_tried(self, exists: Bool[np.ndarray, "m m"]) -> Action | None:
        fresh = np.argwhere(np.triu(exists & (self.rehearsal.tried.sum(axis=0) == 0)))
        if not len(fresh):
            return None
        row, column = fresh[self.rng.integers(len(fresh))].tolist()
        return row, column, int(self.rng.integers(self.rehearsal.ways))

    def _way(self, pair: Pair, known: np.ndarray) -> Action:
        """Who moves, and with which `w`."""
        row, column = self._last = pair
        actions = [(a, b, w) for a, b in ((row, column), (column, row)) for w in range(self.rehearsal.ways)]
        works = [a for a in actions if known[a] == MERGES]
        if works:
            return works[self.rng.integers(len(works))]
        untried = [a for a in actions if known[a] == UNKNOWN]
        failed, merged = np.array([self.rehearsal.went(a, b)[:, w] for a, b, w in untried]).T
        hope = ((merged + 0.5) / (failed + merged + 1.0)) ** 2
        if self.rehearsal.trial.roles_matter:
            # Where the goal was in collision, it often was the ground's; then who waits should move.
            swapped = np.array([known[b, a, w] for a, b, w in untried])
            hope *= np.select([swapped == FAILS, swapped == BLOCKED], [_SWAP, 1.0 / _SWAP], 1.0)
        return untried[self.rng.choice(len(untried), p=hope / hope.sum())]

    def joined(self, state: State, action: Action) -> None:
        """The action merged, in a state."""
        self._dared[1] += self._daring
        groups = self.rehearsal.members(state)
        one, two = (next(g for g in groups if self.rehearsal.part[row] in g) for row in action[:2])
        self._merges.append((one, two))
        self._done.append((min(action[:2]), max(action[:2])))
        self._last = None

    def end(self, state: State, stuck: bool) -> None:
        """The episode ended in a state, because nothing was left to try or because a try failed."""
        self._episodes += 1
        self._dared[0] += self._daring and not stuck and len(state) > 1
        self._dared *= _FORGET
        if stuck or self._episodes > _PATIENCE:
            self._judge(state)
            self._change(state)
            self._episodes = 0
        else:
            # The same once more, as far as it went; now with one way less to try.
            seen = [*self._done, *([] if self._last is None else [self._last])]
            self._plan = seen + [pair for pair in self._plan if pair not in seen]
        self._done, self._last, self._merges = [], None, []

    def _judge(self, state: State) -> None:
        whole = self.rehearsal.members(state)
        group_of = np.zeros(len(self.rehearsal.like), int)
        for i, parts in enumerate(whole):
            group_of[list(parts)] = i
        like = self.rehearsal.like
        for one, two in self._merges:
            rest = np.setdiff1d(np.arange(len(like)), [*one, *two])
            left = group_of[rest] != group_of[one[0]]
            for a, b in ((one, two), (two, one)):
                at = np.ix_(like[list(a)], like[list(b)], like[rest])
                np.add.at(self._together, at, 1)
                np.add.at(self._left_over, at, np.broadcast_to(left, (len(a), len(b), len(rest))))
        self._idle = 0 if len(state) < self._left else self._idle + 1
        if len(state) <= self._left or self.rng.random() < _WORSE:
            self._kept, self._left = list(self._done), len(state)
        if self._idle > _RESTART:
            self._kept, self._left, self._idle = [], len(self.rehearsal.start) + 1, 0

    def _change(self, state: State) -> None:
        """A new play: the kept one with a pair of what was left over earlier in it."""
        rng, plan = self.rng, list(self._kept)
        self._caution = float(rng.choice(_CAUTION))
        self._strict = bool(rng.random() < _STRICT)
        self._careful = bool(rng.random() < _CAREFUL)
        self._axes = _ORDERS[rng.integers(len(_ORDERS))] if rng.random() < _ORDERED else None
        several = int(rng.choice(len(_DELAYED), p=_DELAYED))
        self._late = rng.choice(len(self.rehearsal.like), several, replace=False, p=self._lateness(state)).tolist()
        if not plan:
            self._plan = []
            return
        if rng.random() < _SHAKE:
            plan.insert(int(rng.integers(len(plan))), plan.pop(int(rng.integers(len(plan)))))
        over = self._over(plan)
        right = np.argwhere(np.triu(over & (self.rehearsal.tried[1] > 0)))
        if len(right):
            row, column = right[rng.integers(len(right))].tolist()
            plan.insert(int(rng.integers(len(plan))), (row, column))
        self._plan = plan

    def _lateness(self, state: State) -> Float[np.ndarray, "P"]:
        """How likely each part is left out in the next play, after one that left a state over; sums to 1.

        Rather those with many points, or those that can be joined to several of the parts to which a group left over
        belongs: a seat that holds the legs between which a rung was to go.
        """
        part, like = self.rehearsal.part, self.rehearsal.like
        first = np.flatnonzero(np.diff(part, prepend=-1))
        fits = np.logical_or.reduceat(np.logical_or.reduceat(self.rehearsal.tried[1] > 0, first, 0), first, 1)
        if self.rng.random() < 0.5:
            counts = np.bincount(part).astype(float) ** 2
            return counts / counts.sum()
        weight = np.ones(len(like))
        groups = sorted(self.rehearsal.members(state), key=len)
        for group in groups[:-1]:
            mates = np.array(fits[list(group)].any(axis=0))
            mates[list(group)] = False
            links = (fits & mates).sum(axis=1)
            weight = weight + np.where((links >= 2) & ~mates, links, 0) ** 2
        return weight / weight.sum()

    def _over(self, plan: list[Pair]) -> Bool[np.ndarray, "m m"]:
        """Pairs of points of parts that the plan leaves in different groups."""
        part = self.rehearsal.part
        group = np.arange(part.max() + 1)
        for row, column in plan:
            group[group == group[part[row]]] = group[part[column]]
        return group[part][:, None] != group[part][None]

    def to_arrays(self) -> Params:
        """Where it stands."""
        return {
            "plan": np.array(self._plan, np.int32).reshape(-1, 2),
            "done": np.array(self._done, np.int32).reshape(-1, 2),
            "kept": np.array(self._kept, np.int32).reshape(-1, 2),
            "counts": np.array([self._left, self._episodes, self._idle], np.int64),
            "late": np.array(self._late, np.int64),
            "axes": np.array(self._axes or (), np.int64),
            "flags": np.array([self._strict, self._daring, self._careful]),
            "dared": self._dared.copy(),
            "last": np.array([] if self._last is None else [self._last], np.int32).reshape(-1, 2),
            "together": self._together.copy(),
            "left_over": self._left_over.copy(),
            "caution": np.array(self._caution),
        }

    def restore(self, arrays: Params) -> None:
        """Take over what `to_arrays` gave."""
        self._plan, self._done, self._kept = (
            [(a, b) for a, b in arrays[name].tolist()] for name in ("plan", "done", "kept")
        )
        self._together, self._left_over = arrays["together"].copy(), arrays["left_over"].copy()
        self._last = next(((a, b) for a, b in arrays["last"].tolist()), None)
        self._left, self._episodes, self._idle = arrays["counts"].tolist()
        self._late = arrays["late"].tolist()
        self._axes = tuple(arrays["axes"].tolist()) or None
        self._strict, self._daring, self._careful = (bool(flag) for flag in arrays["flags"])
        self._dared = arrays["dared"].copy()
        self._caution = float(arrays["caution"])
