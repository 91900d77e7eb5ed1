"""The agent of one expert in training: it acts, explores, and fills its replay buffer.

It uses what it has experienced in this chair: outcomes of merges (`memoized_env`), how often two points were a wrong or
a right pair, and the best return from each state so far. Nothing is masked but actions that do not exist: exploration
prefers what is untried to what is known to fail, and the greedy episodes that decide whether the chair is mastered
choose by Q alone.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32

from roboassembly.learning.layers import Params
from roboassembly.learning.paper.dqn.exploration import PlanExplorer, pair_of
from roboassembly.learning.paper.dqn.memoized_env import Action, State
from roboassembly.learning.paper.dqn.network import first_best
from roboassembly.learning.paper.dqn.recovery import RecoveryExplorer
from roboassembly.learning.paper.dqn.replay_buffer import RECENT, ReplayBuffer
from roboassembly.learning.paper.dqn.tie_breaking import TieBreaker
from roboassembly.solvers.mate_checks import MERGES, UNKNOWN


@dataclass(frozen=True)
class AgentConfig:
    """Settings of exploration and replay."""

    batch: int = 24
    """States in an update."""
    backups: int = 2
    """Known merges of each state that are backed up in an update: the best so far, and random others."""
    untried_share: float = 0.5
    """Share of steps that take an untried action, from a depth on that is drawn for each episode."""
    familiar_share: float = 0.7
    """Share of untried actions between two points that were a right pair before, in other groups or otherwise."""
    random_share: float = 0.5
    """Share of untried actions that are drawn; the others have the highest Q."""
    random_merge_share: float = 0.8
    """Share of the other steps that take any merge known to work; the others take the highest Q."""
    explorer_share: float = 0.85
    """Share of episodes in which the explorer improves a plan, until the chair has been finished."""
    greedy_every: int = 10
    """Distance between greedy episodes, before the chair has been finished and while recoveries are sought ..."""
    greedy_every_finished: int = 3
    """... and otherwise."""
    tie_breaking_steps: int = 15_000
    """Largest number of steps spent on finding the first of the best actions; the best known ones count then."""
    demonstrate_after: int = 5_000
    """Number of steps after which an agent that has not finished the chair once is shown how to, as in Hester et al.
    2018 ("Deep Q-learning from Demonstrations")."""
    recoveries: int = 40
    """Number of episodes that finish the chair after random merges."""


class DQNAgent:
    """Acts in one chair and fills the replay buffer; its network is trained elsewhere.

    Args:
        buffer: an empty replay buffer.
        config: settings.
        rng: random numbers.
        demonstration: returns actions that assemble the chair, or none; see `AgentConfig.demonstrate_after`. None: the
            agent is not shown anything.
    """

    def __init__(
        self,
        buffer: ReplayBuffer,
        config: AgentConfig,
        rng: np.random.Generator,
        demonstration: Callable[[], list[Action]] | None = None,
    ) -> None:
        self.buffer, self.config, self.rng = buffer, config, rng
        self._demonstration = demonstration
        self.demonstrated = False
        """Whether the agent was shown how to assemble the chair."""
        self.steps = self.episodes = self.updates = 0
        self.at = 0
        """Number of the current state."""
        self._deepest = self._frontier = 0
        self._stuck = False
        self.greedy = False
        """Whether the current episode chooses by Q alone."""
        self._explores = False
        self._explorer = PlanExplorer(buffer.env, rng)
        self._breaks_ties = False
        self._tie_breaking_steps = 0
        self._tie_breaker = TieBreaker(buffer, self._explorer)
        self._recovers = False
        self._recovery = RecoveryExplorer(buffer, self._explorer, rng)
        self.mastered = False
        """Whether the last greedy episode finished the chair."""
        self.depths: list[tuple[int, int]] = []
        """Step and number of merges of each greedy episode."""

    @property
    def finished_once(self) -> bool:
        """Whether any episode finished the chair."""
        return self.buffer.best[0] > 1.0 - 1e-6

    @property
    def settled(self) -> bool:
        """Whether the first episode that finishes the chair is known, or sought for long enough; see `tie_breaking`."""
        return self._tie_breaker.done or self._tie_breaking_steps >= self.config.tie_breaking_steps

    @property
    def recovers(self) -> bool:
        """Whether the agent learns, or has learnt, what to do beside the first episode."""
        return self._recovery.active

    @property
    def recovery_known(self) -> bool:
        """Whether it is known what to do beside the first episode; see `recovery`."""
        return self._recovery.active and self._recovery.done(self.config.recoveries)

    @property
    def _seeks_recoveries(self) -> bool:
        return self._recovery.active and not self.recovery_known

    def begin_recovery(self) -> None:
        """Learn what to do beside the first episode from now on."""
        self._recovery.begin()

    def step(self, values: Callable[[], Float32[np.ndarray, "n n w"]]) -> bool:
        """Make one step of the environment; starts a new episode where one ends.

        Args:
            values: computes the Q-values of the current state, padded; only called where they matter.

        Returns:
            Whether there is something to learn from the step: its outcome is new and more than a wrong pair at the
            start, of which one update takes in all; or exploration is over.
        """
        buffer, env = self.buffer, self.buffer.env
        state = buffer.states[self.at]
        action = self._choose(state, values)
        buffer.recent.append(self.at)
        new = bool(env.known(state)[action] == UNKNOWN)
        after = env.step(state, action)
        self.steps += 1
        self._tie_breaking_steps += self._breaks_ties
        if after is not None:
            follower = buffer.add(after)
            buffer.add_merge(self.at, action, follower)
            self.at = follower
            if self._explores:
                self._explorer.record_merge(state, action)
            if self._recovers:
                self._recovery.record_merge()
        elif self._recovers:
            self._recovery.record_failure()
        # While recoveries are sought there is a network to start from, and much to find out before it is to fit all.
        fits = (self.greedy or self.settled) and not self._seeks_recoveries
        learnable = fits or (new and (after is not None or self.at != 0))
        if after is None or len(after) == 1:
            self._end_episode(after is not None)
        return learnable

    def _end_episode(self, finished: bool) -> None:
        depth = len(self.buffer.states[0]) - len(self.buffer.states[self.at])
        if self.greedy:
            self.mastered = finished
            self.depths.append((self.steps, depth))
        if self._explores:
            self._explorer.end_episode(self.buffer.states[self.at], self._stuck)
        if self._breaks_ties:
            self._tie_breaker.end_episode(finished, self._stuck, depth)
        if self._recovers:
            self._recovery.end_episode(finished, self._stuck)
        if not self.finished_once and self.steps >= self.config.demonstrate_after:
            self._see_demonstration()
        self._deepest = max(self._deepest, depth)
        self._frontier = int(self.rng.integers(self._deepest + 1))
        self.episodes += 1
        often = self.finished_once and not self._seeks_recoveries
        distance = self.config.greedy_every_finished if often else self.config.greedy_every
        self.greedy = self.episodes % distance == 0
        draw = self.rng.random()
        self._explores = not self.greedy and not self.finished_once and draw < self.config.explorer_share
        self._breaks_ties = not self.greedy and self.finished_once and not self.settled
        self._recovers = not self.greedy and self.settled and self._seeks_recoveries
        self._stuck = False
        self.at = self.buffer.index[self._recovery.start()] if self._recovers else 0
        del self.buffer.recent[: -2 * RECENT]

    def _see_demonstration(self) -> None:
        """Take an episode from the demonstration; what fails in it the explorer tries in other ways."""
        if self.demonstrated or self._demonstration is None:
            return
        buffer, env, at = self.buffer, self.buffer.env, 0
        # Asked for once: a search that finds nothing takes long.
        actions, self._demonstration = self._demonstration(), None
        for action in actions:
            after = env.step(buffer.states[at], action)
            self.steps += 1
            if after is None:
                self._explorer.start_from([pair_of(merge) for merge in actions])
                break
            follower = buffer.add(after)
            buffer.add_merge(at, action, follower)
            at = follower
        self.demonstrated = bool(actions)

    def _choose(self, state: State, values: Callable[[], Float32[np.ndarray, "n n w"]]) -> Action:
        c, rng, env = self.config, self.rng, self.buffer.env
        m = self.buffer.inputs.points
        if self._explores or self._breaks_ties or self._recovers:
            explorer = self._explorer if self._explores else self._tie_breaker if self._breaks_ties else self._recovery
            action = explorer.choose(state)
            self._stuck = action is None
            if action is not None:
                return action
        exists = np.broadcast_to(env.exists(state)[..., None], (m, m, env.choices))
        q = np.where(exists, values()[:m, :m], -np.inf)
        if self.greedy:
            return first_best(q)
        if self._stuck:
            return _unravel(int(np.argmax(q)), q.shape)
        known = env.known(state)
        works = np.flatnonzero((known == MERGES).ravel())
        deep = len(env.start) - len(state) >= self._frontier
        if not len(works) or (deep and rng.random() < c.untried_share):
            untried = self._untried(exists & (known == UNKNOWN))
            if len(untried):
                at_random = rng.random() < c.random_share
                flat = self._draw(untried, q.shape) if at_random else untried[np.argmax(q.ravel()[untried])]
                return _unravel(int(flat), q.shape)
        if len(works):
            at_random = rng.random() < c.random_merge_share
            flat = rng.choice(works) if at_random else works[np.argmax(q.ravel()[works])]
            return _unravel(int(flat), q.shape)
        return _unravel(int(np.argmax(q)), q.shape)

    def _draw(self, untried: np.ndarray, shape: tuple[int, ...]) -> int:
        """Draw one of several actions; those that have worked for these points in other groups are more likely."""
        row, column, choice = np.unravel_index(untried, shape)
        failed, merged = self.buffer.env.outcome_counts(row, column)[:, np.arange(len(row)), choice]
        hope = ((merged + 0.5) / (failed + merged + 1.0)) ** 2
        return int(self.rng.choice(untried, p=hope / hope.sum()))

    def _untried(self, unknown: Bool[np.ndarray, "m m w"]) -> np.ndarray:
        """Return flat indices of untried actions: of points that have been a right pair, or that were never tried."""
        wrong, right = self.buffer.env.tried > 0
        familiar = np.flatnonzero(unknown & right[..., None])
        novel = np.flatnonzero(unknown & ~(right | wrong)[..., None])
        if len(familiar) and (not len(novel) or self.rng.random() < self.config.familiar_share):
            return familiar
        return novel if len(novel) else np.flatnonzero(unknown)

    def mark_failed(self, state: State, action: Action) -> None:
        """Take over that an action failed in the real environment.

        What is known beside the first episode that finishes the chair is kept, as long as that episode still works. If
        no known episode finishes the chair any more, exploration goes on from the first one.
        """
        episode = self.buffer.first_episode()
        self.buffer.drop(self.buffer.env.mark_failed(state, action))
        self._recovers = self.mastered = False
        if episode and not self.finished_once:
            self._explorer.start_from([pair_of(merge) for _, merge in episode])
        if not self._recovery.still_works:
            self._tie_breaker.restart()
            self._recovery.reset()

    def start_from(self, relative: Params) -> None:
        """Take over what the agent of a near relative, with the same parts and points, has found out.

        Args:
            relative: its `to_arrays`.
        """
        self._explorer.start_from([(a, b) for a, b in relative["best_pairs"].tolist()])
        self._tie_breaker.restore_tries(relative["tie_breaker"])

    def to_arrays(self) -> Params:
        """Return all that it takes to go on later."""
        counts = [self.steps, self.episodes, self.updates, self.at, self._deepest, self._frontier]
        flags = [self.greedy, self.mastered, self._explores, self._breaks_ties, self._recovers, self._stuck]
        return {
            "env": self.buffer.env.to_arrays(),
            "buffer": self.buffer.to_arrays(),
            "counts": np.array([*counts, self._tie_breaking_steps, *flags, self.demonstrated], np.int64),
            "explorer": self._explorer.to_arrays(),
            "tie_breaker": self._tie_breaker.to_arrays(),
            "recovery": self._recovery.to_arrays(),
            "best_pairs": np.array(self.buffer.best_pairs(), np.int32).reshape(-1, 2),
            "depths": np.array(self.depths, np.int32).reshape(-1, 2),
            "generator": np.frombuffer(json.dumps(self.rng.bit_generator.state).encode(), np.uint8),
        }

    def restore(self, arrays: Params) -> None:
        """Go on from what `to_arrays` returned."""
        self.buffer.env.restore(arrays["env"])
        self.buffer.restore(arrays["buffer"])
        counts: list[int] = arrays["counts"].tolist()
        self.steps, self.episodes, self.updates, self.at, self._deepest, self._frontier = counts[:6]
        self._tie_breaking_steps = counts[6]
        self.greedy, self.mastered, self._explores, self._breaks_ties = (bool(c) for c in counts[7:11])
        self._recovers, self._stuck, self.demonstrated = (bool(c) for c in counts[11:])
        self._explorer.restore(arrays["explorer"])
        self._tie_breaker.restore(arrays["tie_breaker"])
        self._recovery.restore(arrays["recovery"])
        self.depths = [(step, depth) for step, depth in arrays["depths"].tolist()]
        self.rng.bit_generator.state = json.loads(arrays["generator"].tobytes())


def _unravel(flat: int, shape: tuple[int, ...]) -> Action:
    row, column, choice = np.unravel_index(flat, shape)
    return int(row), int(column), int(choice)
