"""Exploration beside the first episode: some random merges, then back to its order, as far as that still leads to the
whole chair.

A policy that imitates an expert errs now and then, and then meets states that the expert's own episodes never visit. So
the expert learns what to do there, too, once it knows the first episode that finishes the chair (`tie_breaking`). Of
all actions that finish the chair from such a state the one counts whose pair comes first in that episode. Experts of
similar chairs then prefer similar actions in similar states, and a policy that imitates all of them has something to go
by.

An episode that gets stuck is tried again from where its random merges ended, without the merge that led to where it
stuck: a depth-first search. (Starting where exploration has to go on is from Go-Explore, Ecoffet et al. 2021; learning
to come back after an error is from DART, Laskey et al. 2017.)
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Int8

from roboassembly.learning.layers import Params
from roboassembly.learning.paper.dqn.exploration import PlanExplorer
from roboassembly.learning.paper.dqn.memoized_env import Action, State
from roboassembly.learning.paper.dqn.replay_buffer import ReplayBuffer
from roboassembly.solvers.mate_checks import MERGES, UNKNOWN

_FURTHER_MERGE = 0.4
"""Chance of another random merge after each."""
_CAREFUL = 0.5
"""Share of random merges that lock the fewest groups out."""
_ATTEMPTS = 12
"""Largest number of episodes after the same random merges."""
_EPISODES = 6
"""Largest number of episodes, as a multiple of the number of recoveries."""


class RecoveryExplorer:
    """Learns what to do in states beside the first episode.

    Args:
        buffer: replay buffer in which the first episode is known.
        explorer: knows which pairs may work, and how to try them.
        rng: random numbers.
    """

    def __init__(self, buffer: ReplayBuffer, explorer: PlanExplorer, rng: np.random.Generator) -> None:
        self._buffer, self._explorer, self._rng = buffer, explorer, rng
        self._order: list[Action] = []
        """Actions of the first episode."""
        self._dead: set[tuple[State, Action]] = set()
        """Merges after which nothing was left that might work."""
        self._random = 0
        """Number of random merges that are left in this episode."""
        self._merges: list[tuple[State, Action]] = []
        """Merges of this episode after the random ones."""
        self._origin: State | None = None
        """State after the random merges; None before."""
        self._attempts = 0
        self.active = False
        """Whether the first episode is known and recoveries are learnt."""
        self.episodes = self.recoveries = 0

    def begin(self) -> None:
        """Take over the first episode."""
        self.reset()
        path = self._buffer.first_episode()
        self._order = [action for _, action in path]
        self._buffer.preferred.update(path)
        self.active = bool(path)

    def reset(self) -> None:
        """Forget everything, because the first episode has changed."""
        self._buffer.preferred.clear()
        self._order, self._merges, self._origin = [], [], None
        self._dead.clear()
        self._random = self._attempts = self.episodes = self.recoveries = 0
        self.active = False

    @property
    def still_works(self) -> bool:
        """Whether recoveries are learnt, and no action of the first episode has failed since."""
        return self.active and [action for _, action in self._buffer.preferred_episode()] == self._order

    def done(self, count: int) -> bool:
        """Return whether so many recoveries are known, or were sought for long enough."""
        return self.recoveries >= count or self.episodes >= _EPISODES * count

    def start(self) -> State:
        """Return the state in which the next episode begins."""
        self._merges = []
        if self._origin is not None:
            return self._origin
        buffer, at = self._buffer, 0
        for action in self._order[: self._rng.integers(len(self._order))]:
            at = buffer.merges[at][action]
        self._random = 1
        while self._rng.random() < _FURTHER_MERGE:
            self._random += 1
        return buffer.states[at]

    def choose(self, state: State) -> Action | None:
        """Return the next action; None if nothing is left that might work."""
        env = self._buffer.env
        known, exists = env.known(state), env.exists(state)
        hopeful = self._explorer.hopeful(state, known, exists)
        if self._random and len(state) > 2:
            careful = self._rng.random() < _CAREFUL
            pairs = np.argwhere(np.triu(self._explorer.least_locking(state, hopeful) if careful else hopeful))
            if not len(pairs):
                return None
            row, column = pairs[self._rng.integers(len(pairs))].tolist()
            return self._explorer.action((row, column), known)
        self._random = 0
        if self._origin is None:
            self._origin = state
        action = next(self._candidates(state, known, hopeful), None)
        if action is not None:
            self._merges.append((state, action))
        return action

    def _candidates(
        self, state: State, known: Int8[np.ndarray, "m m w"], hopeful: Bool[np.ndarray, "m m"]
    ) -> Iterator[Action]:
        """Yield what may be done in a state: pairs in the order of the first episode, then others by number.

        Equal parts may be in each other's places, so a pair of the first episode stands for all pairs of equal points.
        """
        equal = self._buffer.env.table.equal_row
        for row, column, choice in self._order:
            rows, columns = np.flatnonzero(equal == equal[row]), np.flatnonzero(equal == equal[column])
            pairs: list[tuple[int, int]] = [(r, c) for r in rows.tolist() for c in columns.tolist() if hopeful[r, c]]
            for r, c in sorted(pairs, key=lambda pair: (pair != (row, column), pair)):
                yield from self._open(state, (r, c), choice, known)
        for row, column in np.argwhere(np.triu(hopeful)).tolist():
            yield from self._open(state, (row, column), 0, known)

    def _open(
        self, state: State, pair: tuple[int, int], choice: int, known: Int8[np.ndarray, "m m w"]
    ) -> Iterator[Action]:
        """Yield the actions of a pair that merge or may do so: the given choice first, swapped roles last."""
        row, column = pair
        count = known.shape[2]
        choices = [choice, *(w for w in range(count) if w != choice)]
        for action in (*((row, column, w) for w in choices), *((column, row, w) for w in choices)):
            if known[action] in (MERGES, UNKNOWN) and (state, action) not in self._dead:
                yield action

    def record_failure(self) -> None:
        """Record that the last action failed."""
        if not self._random and self._merges:
            self._merges.pop()

    def record_merge(self) -> None:
        """Record that the last action merged."""
        self._random = max(0, self._random - 1)

    def end_episode(self, finished: bool, stuck: bool) -> None:
        """Record the end of an episode.

        Args:
            finished: whether the chair is whole.
            stuck: whether nothing was left to try.
        """
        self.episodes += 1
        if finished:
            for state, action in self._merges:
                self._buffer.preferred[self._buffer.index[state]] = action
            self.recoveries += 1
        elif stuck and self._merges:
            self._dead.add(self._merges[-1])
        self._attempts += 1
        hopeless = stuck and not self._merges
        if finished or hopeless or self._origin is None or self._attempts >= _ATTEMPTS:
            self._origin, self._attempts = None, 0
        self._random = 0

    def to_arrays(self) -> Params:
        """Return all that it takes to go on later."""
        width = len(self._buffer.env.start)

        def padded(state: State) -> list[int]:
            return [*state, *[-1] * (width - len(state))]

        return {
            "order": np.array(self._order, np.int32).reshape(-1, 3),
            "dead": np.array([(*a, *padded(s)) for s, a in sorted(self._dead)], np.int32).reshape(-1, 3 + width),
            "merges": np.array([(*a, *padded(s)) for s, a in self._merges], np.int32).reshape(-1, 3 + width),
            "origin": np.array([] if self._origin is None else [padded(self._origin)], np.int32).reshape(-1, width),
            "counts": np.array([self._random, self._attempts, self.episodes, self.recoveries, self.active], np.int64),
        }

    def restore(self, arrays: Params) -> None:
        """Go on from what `to_arrays` returned."""

        def state_of(row: list[int]) -> State:
            return tuple(g for g in row if g >= 0)

        def kept(name: str) -> list[tuple[State, Action]]:
            return [(state_of(row[3:]), (row[0], row[1], row[2])) for row in arrays[name].tolist()]

        self._order = [(a, b, w) for a, b, w in arrays["order"].tolist()]
        self._dead, self._merges = set(kept("dead")), kept("merges")
        self._origin = next((state_of(row) for row in arrays["origin"].tolist()), None)
        self._random, self._attempts, self.episodes, self.recoveries, active = arrays["counts"].tolist()
        self.active = bool(active)
