"""Exploration once the chair has been finished: finds the episode whose actions come first in number order.

Many actions of a state are equally good: any leg may come next. Experts of similar chairs should break such ties alike,
or a policy that imitates all of them has nothing to go by. So the first of the best actions counts, in the order of
their numbers (`network.first_best`), as `numpy.argmax` breaks ties. The agent has to know which one that is: step by
step, it tries the actions that come before the one it knows to lead to the whole chair, and then goes on as before.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from roboassembly.learning.layers import Params
from roboassembly.learning.paper.dqn.exploration import Pair, PlanExplorer
from roboassembly.learning.paper.dqn.memoized_env import Action, State
from roboassembly.learning.paper.dqn.replay_buffer import ReplayBuffer
from roboassembly.solvers.mate_checks import BLOCKED, MERGES, UNKNOWN

_TRIES = 3
"""Number of episodes after an action that merged until it counts as leading nowhere."""


Groups = tuple[int, ...]
"""State as the first part of each part's group; near relatives of a chair have the same."""


class TieBreaker:
    """Explores the actions that come before those known to lead to the whole chair.

    Args:
        buffer: replay buffer with an episode that finished the chair.
        explorer: knows which pairs may work, and how to try them.
    """

    def __init__(self, buffer: ReplayBuffer, explorer: PlanExplorer) -> None:
        self._buffer, self._explorer = buffer, explorer
        self._tries: dict[tuple[Groups, Pair], int] = {}
        """Number of episodes that took a pair in a state, merged and did not finish."""
        self._trial: tuple[Groups, Pair] | None = None
        """State and pair that this episode tries; None as long as all its actions are known to finish."""
        self._plan: list[Pair] = []
        """Pairs that finished the chair, in their order."""
        self.done = False
        """Whether the first episode is known."""

    def choose(self, state: State) -> Action | None:
        """Return the next action; None if nothing is left that might work."""
        if self._trial is not None:
            return self._finishing(state)
        groups = self._groups(state)
        for row, column in self._candidates(state):
            action, finishes = self._first_choice(state, (row, column))
            if finishes:
                return action
            if action is not None and self._tries.get((groups, (row, column)), 0) < _TRIES:
                self._trial = groups, (row, column)
                self._plan = self._buffer.best_pairs()
                return action
        return None

    def _candidates(self, state: State) -> list[Pair]:
        """Return the pairs that may work, in number order; either point may move."""
        return [(row, column) for row, column in np.argwhere(self._hopeful(state)).tolist()]

    def _hopeful(self, state: State) -> Bool[np.ndarray, "n n"]:
        """Return the pairs that may work and lock the fewest groups out; symmetric."""
        env = self._buffer.env
        return self._explorer.least_locking(state, self._explorer.hopeful(state, env.known(state), env.exists(state)))

    def _first_choice(self, state: State, pair: Pair) -> tuple[Action | None, bool]:
        """Return the first choice of a pair that merges or may do so, and whether it is known to lead to the whole."""
        env = self._buffer.env
        known = env.known(state)[pair]
        if (known == BLOCKED).sum() >= env.check.patience[1] and not (known == MERGES).any():
            return None, False
        open_ = np.flatnonzero((known == MERGES) | (known == UNKNOWN)).tolist()
        if not open_:
            return None, False
        action = (*pair, open_[0])
        return action, self._buffer.finishes(state, action)

    def _finishing(self, state: State) -> Action | None:
        """Return an action toward the whole chair: one that is known to finish, else the next of the plan."""
        env = self._buffer.env
        action = self._buffer.finishing_action(state)
        if action is not None:
            return action
        known, hopeful = env.known(state), self._hopeful(state)
        for pair in [*self._plan, *np.argwhere(np.triu(hopeful)).tolist()]:
            if hopeful[tuple(pair)]:
                return self._explorer.action((pair[0], pair[1]), known)
        return None

    def end_episode(self, finished: bool, stuck: bool, merged: int) -> None:
        """Record the end of an episode.

        Args:
            finished: whether the chair is whole.
            stuck: whether nothing was left to try.
            merged: number of merges of the episode.
        """
        if self._trial is None:
            self.done = finished or stuck
        elif not finished and merged > len(self._trial[0]) - len(set(self._trial[0])):
            self._tries[self._trial] = self._tries.get(self._trial, 0) + (_TRIES if stuck else 1)
        self._trial = None

    def restart(self) -> None:
        """Start again, because an action that was known to work failed in the real environment."""
        self.done, self._trial = False, None

    def _groups(self, state: State) -> Groups:
        count = len(self._buffer.env.start)
        return tuple(np.argmax(self._buffer.env.joined(state)[:count], axis=1).tolist())

    def to_arrays(self) -> Params:
        """Return all that it takes to go on later."""
        tries = [(*pair, count, *groups) for (groups, pair), count in self._tries.items()]
        trial = [] if self._trial is None else [(*self._trial[1], *self._trial[0])]
        width = len(self._buffer.env.start)
        return {
            "tries": np.array(tries, np.int32).reshape(-1, 3 + width),
            "trial": np.array(trial, np.int32).reshape(-1, 2 + width),
            "plan": np.array(self._plan, np.int32).reshape(-1, 2),
            "done": np.array(self.done),
        }

    def restore(self, arrays: Params) -> None:
        """Go on from what `to_arrays` returned."""
        self.restore_tries(arrays)
        trial: list[list[int]] = arrays["trial"].tolist()
        self._trial = (tuple(trial[0][2:]), (trial[0][0], trial[0][1])) if trial else None
        self._plan = [(a, b) for a, b in arrays["plan"].tolist()]
        self.done = bool(arrays["done"])

    def restore_tries(self, arrays: Params) -> None:
        """Take over which actions led nowhere, of this chair or of a near relative."""
        rows: list[list[int]] = arrays["tries"].tolist()
        self._tries = {(tuple(row[3:]), (row[0], row[1])): row[2] for row in rows}
