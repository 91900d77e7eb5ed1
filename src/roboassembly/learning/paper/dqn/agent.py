"""What one expert does while it trains: it plays, tries what it has not tried, and remembers.

What it may use is what it has lived through in this chair: outcomes of merges (`rehearsal`), how often two points were
a wrong or a right pair, and the best return from each state so far. Nothing is ever masked but actions that do not
exist: exploration merely prefers what is untried over what is known to fail, and the greedy plays that decide whether
the chair is mastered choose by Q alone.
"""

from __future__ import annotations

import json
from bisect import insort
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32

from roboassembly.learning.layers import Params
from roboassembly.learning.paper.dqn.exploration import Practice
from roboassembly.learning.paper.dqn.memoized_env import Action, Rehearsal, State
from roboassembly.learning.paper.dqn.network import Chair
from roboassembly.learning.paper.dqn.trials import FAILS, MERGES, UNKNOWN

_RECENT = 4_000
"""Visits that the younger half of the replay memory reaches back."""


@dataclass(frozen=True)
class LearnerConfig:
    """How a learner explores, and what it replays."""

    batch: int = 24
    """States in an update."""
    backups: int = 2
    """Known merges of each state that are backed up in an update: the best so far, and others at random."""
    explore: float = 0.5
    """Share of moves into the unknown, from a depth on that is drawn for each episode."""
    familiar: float = 0.7
    """Share of those that take two points which were a right pair before, in other groups or another way."""
    curious: float = 0.5
    """Share of moves into the unknown that are drawn; the others take the highest Q."""
    wander: float = 0.8
    """Share of the other moves that take any merge known to work; the others take the highest Q."""
    practice: float = 0.85
    """Share of episodes in which a play is improved (`practice`), until the chair has been finished."""
    greedy_every: int = 10
    """Every so many episodes is played by Q alone; twice as often ..."""
    settled_every: int = 3
    """... once the chair has been finished."""


class Memory:
    """States lived through, and the merges between them, as arrays ready for the network."""

    def __init__(self, rehearsal: Rehearsal, chair: Chair) -> None:
        self.rehearsal, self.chair = rehearsal, chair
        self.states: list[State] = []
        self.index: dict[State, int] = {}
        self.joined: list[Bool[np.ndarray, "20 20"]] = []
        self.free: list[Bool[np.ndarray, "n"]] = []
        """Padded."""
        self.merges: list[dict[Action, int]] = []
        """For each state, actions that are known to work and the states that they lead to."""
        self.best: list[float] = []
        """Highest return from each state so far, in shares of the best return."""
        self.recent: list[int] = []
        self._parents: list[set[int]] = []
        self._left: list[int] = []
        """Ascending, those with merges."""
        self.add(rehearsal.start)

    def add(self, state: State) -> int:
        """The state's number, after `index`."""
        if state not in self.index:
            self.index[state] = len(self.states)
            self.states.append(state)
            free = np.zeros(len(self.chair.part), bool)
            free[: self.chair.points] = self.rehearsal.owners(state) >= 0
            self.joined.append(self.rehearsal.joined(state))
            self.free.append(free)
            self.merges.append({})
            self.best.append(0.0)
            self._parents.append(set())
        return self.index[state]

    def reward(self, after: int) -> float:
        """Of a merge that leads to a state: 1, and 4 more for the last, in shares of the best return."""
        return (1.0 + 4.0 * (len(self.states[after]) == 1)) / self.chair.best

    def worth(self, after: int) -> float:
        """Reward of a merge that leads to a state, and the best that has come after it."""
        return self.reward(after) + self.best[after]

    def merged(self, before: int, action: Action, after: int) -> None:
        """Take in a merge."""
        if not self.merges[before]:
            insort(self._left, before)
        self.merges[before][action] = after
        self._parents[after].add(before)
        self._raise(before, after)

    def _raise(self, before: int, after: int) -> None:
        pending = [(before, after)]
        while pending:
            before, after = pending.pop()
            worth = self.worth(after)
            if worth > self.best[before] + 1e-9:
                self.best[before] = worth
                pending += [(parent, before) for parent in self._parents[before]]

    def recall(self) -> None:
        """Find all merges and best returns anew, after the rehearsal was corrected."""
        for i, state in enumerate(self.states):
            known = self.rehearsal.known(state)
            self.merges[i] = {a: j for a, j in self.merges[i].items() if known[a] == MERGES}
        self.best = [0.0] * len(self.states)
        self._left = [i for i, merges in enumerate(self.merges) if merges]
        self._parents = [set() for _ in self.states]
        for i, merges in enumerate(self.merges):
            for j in merges.values():
                self._parents[j].add(i)
        for i, merges in enumerate(self.merges):
            for j in merges.values():
                self._raise(i, j)

    def best_path(self) -> list[int]:
        """States of the best play so far, the last one excepted."""
        out, at = [], 0
        while self.merges[at]:
            out.append(at)
            at = max(self.merges[at].values(), key=self.worth)
        return out

    def _finishes(self, before: int, after: int) -> bool:
        """Whether a merge has led to the whole chair."""
        merges_and_more = len(self.states[before]) - 1 + 4.0
        return self.worth(after) > merges_and_more / self.chair.best - 1e-6

    def sample(self, rng: np.random.Generator, c: LearnerConfig) -> dict[str, np.ndarray]:
        """A batch: a third of it states lately seen, a third those of the best play, a third any left by a merge."""
        third = c.batch // 3
        left = self._left or [0]
        path = self.best_path() or [0]
        chosen = np.concatenate(
            [rng.choice(self.recent[-_RECENT:], third), rng.choice(path, third), rng.choice(left, c.batch - 2 * third)]
        )
        n, m = len(self.chair.part), self.chair.points
        fails = np.zeros((c.batch, n, n, self.rehearsal.ways), bool)
        actions = np.zeros((c.batch, c.backups, 3), np.int32)
        after = np.zeros((c.batch, c.backups), int)
        real = np.zeros((c.batch, c.backups), np.float32)
        whole = np.zeros((c.batch, n, n, self.rehearsal.ways), bool)
        for row, i in enumerate(chosen.tolist()):
            state = self.states[i]
            fails[row, :m, :m] = (self.rehearsal.known(state) >= FAILS) & self.rehearsal.exists(state)[..., None]
            known = list(self.merges[i].items())
            for action, follower in known:
                whole[row][action] = self._finishes(i, follower)
            for slot in range(min(c.backups, len(known))):
                if slot == 0:
                    action, follower = max(known, key=lambda one: self.worth(one[1]))
                else:
                    action, follower = known[rng.integers(len(known))]
                actions[row, slot], after[row, slot], real[row, slot] = action, follower, 1.0
        flat = after.ravel().tolist()
        rewards = np.array([self.reward(i) for i in flat], np.float32)
        ahead = np.array([self.best[i] for i in flat], np.float32)
        shape = after.shape
        return {
            "features": self.chair.features,
            "part": self.chair.part,
            "joined": np.array([self.joined[i] for i in chosen], np.float32),
            "free": np.array([self.free[i] for i in chosen], np.float32),
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
        """All states and merges; the rehearsal excepted."""
        width = max(len(s) for s in self.states)
        merges = [(i, *a, j) for i, known in enumerate(self.merges) for a, j in known.items()]
        return {
            "states": np.array([(*s, *[-1] * (width - len(s))) for s in self.states], np.int32),
            "merges": np.array(merges, np.int32).reshape(-1, 5),
            "recent": np.array(self.recent[-_RECENT:], np.int32),
        }

    def restore(self, arrays: Params) -> None:
        """Take over what `to_arrays` gave; the rehearsal is restored already."""
        for row in arrays["states"].tolist():
            self.add(tuple(g for g in row if g >= 0))
        for i, row, column, w, j in arrays["merges"].tolist():
            self.merged(i, (row, column, w), j)
        self.recent = arrays["recent"].tolist()


class Learner:
    """Plays one chair and remembers; its network is trained elsewhere."""

    def __init__(self, memory: Memory, config: LearnerConfig, rng: np.random.Generator) -> None:
        self.memory, self.config, self.rng = memory, config, rng
        self.steps = self.episodes = self.updates = 0
        self.at = 0
        """Number of the current state."""
        self._deepest = self._frontier = 0
        self._stuck = False
        self._greedy = self._practising = False
        self._practice = Practice(memory.rehearsal, rng)
        self.mastered = False
        """Whether the last greedy play finished the chair."""
        self.depths: list[tuple[int, int]] = []
        """Step and merges of each greedy play."""

    @property
    def finished_once(self) -> bool:
        """Whether any play finished the chair."""
        return self.memory.best[0] > 1.0 - 1e-6

    def move(self, q: Float32[np.ndarray, "n n w"]) -> None:
        """One step of the environment; starts a new episode where one ends.

        Args:
            q: of the current state, padded.
        """
        memory, rehearsal = self.memory, self.memory.rehearsal
        state = memory.states[self.at]
        action = self._choose(state, q)
        memory.recent.append(self.at)
        after = rehearsal.step(state, action)
        self.steps += 1
        if after is not None:
            follower = memory.add(after)
            memory.merged(self.at, action, follower)
            self.at = follower
            if self._practising:
                self._practice.joined(state, action)
        if after is None or len(after) == 1:
            self._end(after is not None)

    def _end(self, finished: bool) -> None:
        depth = len(self.memory.states[0]) - len(self.memory.states[self.at])
        if self._greedy:
            self.mastered = finished
            self.depths.append((self.steps, depth))
        if self._practising:
            self._practice.end(self.memory.states[self.at], self._stuck)
        self._deepest = max(self._deepest, depth)
        self._frontier = int(self.rng.integers(self._deepest + 1))
        self.episodes += 1
        every = self.config.settled_every if self.finished_once else self.config.greedy_every
        self._greedy = self.episodes % every == 0
        draw = self.rng.random()
        self._practising = not self._greedy and not self.finished_once and draw < self.config.practice
        self._stuck = False
        self.at = 0
        del self.memory.recent[: -2 * _RECENT]

    def _choose(self, state: State, q: Float32[np.ndarray, "n n w"]) -> Action:
        c, rng, rehearsal = self.config, self.rng, self.memory.rehearsal
        m = self.memory.chair.points
        exists = np.broadcast_to(rehearsal.exists(state)[..., None], (m, m, rehearsal.ways))
        q = np.where(exists, q[:m, :m], -np.inf)
        if self._greedy:
            return _unravel(int(np.argmax(q)), q.shape)
        if self._practising:
            action = self._practice.choose(state)
            self._stuck = action is None
            return action or _unravel(int(np.argmax(q)), q.shape)
        known = rehearsal.known(state)
        works = np.flatnonzero((known == MERGES).ravel())
        deep = len(rehearsal.start) - len(state) >= self._frontier
        if not len(works) or (deep and rng.random() < c.explore):
            untried = self._untried(exists & (known == UNKNOWN))
            if len(untried):
                curious = rng.random() < c.curious
                pick = self._draw(untried, q.shape) if curious else untried[np.argmax(q.ravel()[untried])]
                return _unravel(int(pick), q.shape)
        if len(works):
            wander = rng.random() < c.wander
            pick = rng.choice(works) if wander else works[np.argmax(q.ravel()[works])]
            return _unravel(int(pick), q.shape)
        return _unravel(int(np.argmax(q)), q.shape)

    def _draw(self, untried: np.ndarray, shape: tuple[int, ...]) -> int:
        """One of several actions, those rather that have worked for these points in other groups."""
        row, column, w = np.unravel_index(untried, shape)
        failed, merged = self.memory.rehearsal.went(row, column)[:, np.arange(len(row)), w]
        hope = ((merged + 0.5) / (failed + merged + 1.0)) ** 2
        return int(self.rng.choice(untried, p=hope / hope.sum()))

    def _untried(self, unknown: Bool[np.ndarray, "m m w"]) -> np.ndarray:
        """Flat indices of actions worth a try: of points that have been a right pair, or that were never tried."""
        wrong, right = self.memory.rehearsal.tried > 0
        familiar = np.flatnonzero(unknown & right[..., None])
        strange = np.flatnonzero(unknown & ~(right | wrong)[..., None])
        if len(familiar) and (not len(strange) or self.rng.random() < self.config.familiar):
            return familiar
        return strange if len(strange) else np.flatnonzero(unknown)

    def correct(self, state: State, action: Action) -> None:
        """The action failed in the real environment."""
        self.memory.rehearsal.correct(state, action)
        self.memory.recall()
        self.mastered = False

    def to_arrays(self) -> Params:
        """All that it takes to go on later."""
        counts = [self.steps, self.episodes, self.updates, self.at, self._deepest, self._frontier, self._greedy]
        return {
            "rehearsal": self.memory.rehearsal.to_arrays(),
            "memory": self.memory.to_arrays(),
            "counts": np.array([*counts, self.mastered, self._practising, self._stuck], np.int64),
            "practice": self._practice.to_arrays(),
            "depths": np.array(self.depths, np.int32).reshape(-1, 2),
            "generator": np.frombuffer(json.dumps(self.rng.bit_generator.state).encode(), np.uint8),
        }

    def restore(self, arrays: Params) -> None:
        """Go on from what `to_arrays` gave."""
        self.memory.rehearsal.restore(arrays["rehearsal"])
        self.memory.restore(arrays["memory"])
        counts: list[Any] = arrays["counts"].tolist()
        self.steps, self.episodes, self.updates, self.at, self._deepest, self._frontier = counts[:6]
        self._greedy, self.mastered, self._practising, self._stuck = (bool(c) for c in counts[6:])
        self._practice.restore(arrays["practice"])
        self.depths = [(step, depth) for step, depth in arrays["depths"].tolist()]
        self.rng.bit_generator.state = json.loads(arrays["generator"].tobytes())


def _unravel(flat: int, shape: tuple[int, ...]) -> Action:
    row, column, w = np.unravel_index(flat, shape)
    return int(row), int(column), int(w)
