"""The replay buffer of one expert: the states it has visited, the merges between them, and the best returns."""

from __future__ import annotations

from bisect import insort
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float32

from roboassembly.learning.layers import Params
from roboassembly.learning.paper.dqn.memoized_env import Action, FailedMates, MemoizedEnv, State
from roboassembly.learning.paper.dqn.network import ChairInputs
from roboassembly.solvers.mate_checks import FAILS

RECENT = 4_000
"""Number of visits that the recent part of the buffer reaches back."""


class ReplayBuffer:
    """States and merges of one chair, as arrays ready for the network.

    Args:
        env: environment of the chair.
        inputs: constant inputs of the network.
    """

    def __init__(self, env: MemoizedEnv, inputs: ChairInputs) -> None:
        self.env, self.inputs = env, inputs
        self.states: list[State] = []
        """States by number."""
        self.index: dict[State, int] = {}
        """Numbers of states."""
        self.joined: list[Bool[np.ndarray, "20 20"]] = []
        """Joined parts of each state."""
        self.free: list[Bool[np.ndarray, "n"]] = []
        """Free points of each state; padded."""
        self.merges: list[dict[Action, int]] = []
        """Actions of each state that are known to work, and the states that they lead to."""
        self.best: list[float] = []
        """Highest return reached from each state, as a share of the largest return."""
        self.recent: list[int] = []
        """States of the last visits."""
        self.preferred: dict[int, Action] = {}
        """Action that counts among those that finish the chair from a state, where it is known."""
        self._parents: list[set[int]] = []
        self._left: list[int] = []
        """States with merges, ascending."""
        self.add(env.start)

    def add(self, state: State) -> int:
        """Return the number of a state; adds it if it is new."""
        if state not in self.index:
            self.index[state] = len(self.states)
            self.states.append(state)
            free = np.zeros(len(self.inputs.part), bool)
            free[: self.inputs.points] = self.env.owners(state) >= 0
            self.joined.append(self.env.joined(state))
            self.free.append(free)
            self.merges.append({})
            self.best.append(0.0)
            self._parents.append(set())
        return self.index[state]

    def reward(self, after: int) -> float:
        """Return the reward of a merge that leads to a state: 1, and 4 more for the last, over the largest return."""
        return (1.0 + 4.0 * (len(self.states[after]) == 1)) / self.inputs.max_return

    def reached(self, after: int) -> float:
        """Return the reward of a merge that leads to a state, plus the best return reached from there."""
        return self.reward(after) + self.best[after]

    def add_merge(self, before: int, action: Action, after: int) -> None:
        """Add a merge between two states."""
        if not self.merges[before]:
            insort(self._left, before)
        self.merges[before][action] = after
        self._parents[after].add(before)
        self._raise(before, after)

    def _raise(self, before: int, after: int) -> None:
        """Raise the best returns of a state and of all that lead to it."""
        pending = [(before, after)]
        while pending:
            before, after = pending.pop()
            reached = self.reached(after)
            if reached > self.best[before] + 1e-9:
                self.best[before] = reached
                pending += [(parent, before) for parent in self._parents[before]]

    def drop(self, failed: FailedMates) -> None:
        """Drop the merges that the environment no longer lets work, and compute all best returns anew."""
        for i in self._left:
            state = self.states[i]
            if self.env.has_types_of(state, failed):
                self.merges[i] = {a: j for a, j in self.merges[i].items() if not self.env.is_among(failed, state, a)}
        self.best = [0.0] * len(self.states)
        self._left = [i for i, merges in enumerate(self.merges) if merges]
        self._parents = [set() for _ in self.states]
        for i, merges in enumerate(self.merges):
            for j in merges.values():
                self._parents[j].add(i)
        for i, merges in enumerate(self.merges):
            for j in merges.values():
                self._raise(i, j)
        self.preferred = {i: a for i, a in self.preferred.items() if self.finishes(self.states[i], a)}

    def best_path(self) -> list[int]:
        """Return the states of the best episode so far, except the last."""
        return [at for at, _ in self._best_merges()]

    def best_pairs(self) -> list[tuple[int, int]]:
        """Return the pairs of points that the best episode so far joins, in their order."""
        return [(row, column) for _, (row, column, _) in self._best_merges()]

    def _best_merges(self) -> list[tuple[int, Action]]:
        """Return the states and actions of the best episode so far."""
        return self._episode(
            lambda at: max(self.merges[at], key=lambda action: self.reached(self.merges[at][action]), default=None)
        )

    def _episode(self, choose: Callable[[int], Action | None]) -> list[tuple[int, Action]]:
        """Return the states and actions of the episode of known merges that someone chooses, as far as there is one."""
        out: list[tuple[int, Action]] = []
        at = 0
        while (action := choose(at)) is not None:
            out.append((at, action))
            at = self.merges[at][action]
        return out

    def finishes(self, state: State, action: Action) -> bool:
        """Return whether an action of a state has led to the whole chair."""
        at = self.index.get(state)
        return at is not None and action in self.merges[at] and self._finishes(at, self.merges[at][action])

    def finishing_action(self, state: State) -> Action | None:
        """Return the first action of a state, in number order, that has led to the whole chair; None if none has."""
        at = self.index.get(state)
        merges = {} if at is None else self.merges[at]
        return min((action for action in merges if self.finishes(state, action)), default=None)

    def first_episode(self) -> list[tuple[int, Action]]:
        """Return the states and actions of the first episode, in number order, that finishes the chair, if any does."""
        return self._episode(lambda at: self.finishing_action(self.states[at]))

    def preferred_episode(self) -> list[tuple[int, Action]]:
        """Return the states and actions of the episode of preferred actions; empty before they are known."""
        return self._episode(self.preferred.get)

    def _finishes(self, before: int, after: int) -> bool:
        """Return whether a merge has led to the whole chair."""
        left = len(self.states[before]) - 1 + 4.0
        return self.reached(after) > left / self.inputs.max_return - 1e-6

    def sample(self, rng: np.random.Generator, batch: int, backups: int) -> dict[str, Float32[np.ndarray, "..."]]:
        """Return a batch for `losses.loss`: a third recent states, a third of the best episode, a third any.

        Once preferred actions are known, the second third is of their episode, and the last third of all their states.

        Args:
            rng: random numbers.
            batch: number of states.
            backups: number of known merges of each state that are backed up: the best so far, and random others.
        """
        third = batch // 3
        left = list(self.preferred) or self._left or [0]
        path = [at for at, _ in self.preferred_episode()] or self.best_path() or [0]
        chosen = np.concatenate(
            [rng.choice(self.recent[-RECENT:], third), rng.choice(path, third), rng.choice(left, batch - 2 * third)]
        )
        n, m, choices = len(self.inputs.part), self.inputs.points, self.env.choices
        fails = np.zeros((batch, n, n, choices), bool)
        actions = np.zeros((batch, backups, 3), np.int32)
        after = np.zeros((batch, backups), int)
        real = np.zeros((batch, backups), np.float32)
        whole = np.zeros((batch, n, n, choices), bool)
        numbers: list[int] = chosen.tolist()
        for row, i in enumerate(numbers):
            state = self.states[i]
            fails[row, :m, :m] = (self.env.known(state) >= FAILS) & self.env.exists(state)[..., None]
            known = list(self.merges[i].items())
            if i in self.preferred:
                first = self.preferred[i]
                best = first, self.merges[i][first]
                whole[row][first] = True
                # The others that finish are worth as much, but come after it: the margin alone says how much they are.
                known = [(action, j) for action, j in known if action == first or not self._finishes(i, j)]
            else:
                best = max(known, key=lambda merge: self.reached(merge[1]), default=None)
                for action, follower in known:
                    whole[row][action] = self._finishes(i, follower)
            for slot in range(min(backups, len(known))):
                action, follower = best if slot == 0 and best else known[int(rng.integers(len(known)))]
                actions[row, slot], after[row, slot], real[row, slot] = action, follower, 1.0
        flat: list[int] = after.ravel().tolist()
        rewards = np.array([self.reward(i) for i in flat], np.float32)
        ahead = np.array([self.best[i] for i in flat], np.float32)
        shape = after.shape
        return {
            "features": self.inputs.features,
            "part": self.inputs.part,
            "joined": np.array([self.joined[i] for i in numbers], np.float32),
            "free": np.array([self.free[i] for i in numbers], np.float32),
            "fails": fails,
            "actions": actions,
            "rewards": rewards.reshape(shape),
            "done": np.array([len(self.states[i]) == 1 for i in flat]).reshape(shape),
            "bound": (rewards + ahead).reshape(shape),
            "real": real,
            "whole": whole,
            "next_joined": np.array([self.joined[i] for i in flat], np.float32),
            "next_free": np.array([self.free[i] for i in flat], np.float32),
        }

    def to_arrays(self) -> Params:
        """Return all states and merges, without the environment."""
        width = max(len(s) for s in self.states)
        merges = [(i, *a, j) for i, known in enumerate(self.merges) for a, j in known.items()]
        return {
            "states": np.array([(*s, *[-1] * (width - len(s))) for s in self.states], np.int32),
            "merges": np.array(merges, np.int32).reshape(-1, 5),
            "recent": np.array(self.recent[-RECENT:], np.int32),
            "preferred": np.array([(i, *a) for i, a in self.preferred.items()], np.int32).reshape(-1, 4),
        }

    def restore(self, arrays: Params) -> None:
        """Take over what `to_arrays` returned; the environment is restored already."""
        for row in arrays["states"].tolist():
            self.add(tuple(g for g in row if g >= 0))
        for i, row, column, choice, j in arrays["merges"].tolist():
            self.add_merge(i, (row, column, choice), j)
        self.recent = arrays["recent"].tolist()
        self.preferred = {i: (row, column, choice) for i, row, column, choice in arrays["preferred"].tolist()}
