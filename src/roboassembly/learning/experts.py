"""One expert a chair, by Double DQN (van Hasselt et al. 2016), many of them trained side by side in one compiled call.

As in the paper: at most 40,000 environment steps, a replay memory, a target network, and masks for actions that do not
exist, never for wrong ones. The state is the paper's, minus what is constant for one chair or does not matter to it:
features of the parts, connection points, and which parts are joined in which relative poses.

What a learner may use is what it has lived through. Outcomes are remembered (`rehearsal`), and so the memory holds
whole states: in each update, everything that is known to fail in a state is a target of 0, and some of the merges that
are known to work are backed up as usual. While training, known failures are not tried again; the greedy plays that
decide whether the chair is solved choose by Q alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Float32

from roboassembly.learning.layers import Array, Params, gelu, init_linear, init_mlp, linear, mlp
from roboassembly.learning.rehearsal import FAILS, MERGES, UNKNOWN, Action, Rehearsal, State
from roboassembly.task.object_centric import UP_AXES

KIND = "expert"
"""Of checkpoints."""
_JOINT = 7
"""Numbers for two parts: whether they are joined, and how."""
_OWN = 8
"""Numbers of a point that change from state to state: size of its group, whether it is free, its part's pose in it."""
PART_SIZES = (6, 8, 10, 12, 14, 16, 18, 20)
POINT_SIZES = (12, 20, 28, 36, 44, 52, 64, 80, 100, 130, 160, 200)
"""Chairs are padded to one of these, so that few shapes are compiled."""


@dataclass(frozen=True)
class ExpertConfig:
    """How experts are trained."""

    steps: int = 40_000
    """Of the environment, at most."""
    batch: int = 24
    """States in an update."""
    backups: int = 2
    """Known merges of each state that are backed up in an update."""
    update_every: int = 8
    """Steps."""
    target_every: int = 50
    """Updates."""
    learning_rate: float = 1.5e-3
    explore: float = 0.5
    """Share of moves into the unknown, from a depth on that is drawn for each episode."""
    blind: float = 0.2
    """Share of the moves into the unknown that are drawn evenly; the others take what Q makes of it."""
    wander: float = 0.5
    """Share of the other moves that take any merge known to work."""
    greedy_every: int = 10
    """Every so many episodes is played by Q alone."""


def init(rng: np.random.Generator, parts: int, points: int, features: int) -> Params:
    """Fresh weights.

    Args:
        parts: padded.
        points: padded.
        features: numbers that describe a point for good.
    """
    return {
        "state": init_mlp(rng, parts * (parts - 1) // 2 * _JOINT, 128, 96),
        "token": init_linear(rng, features + _OWN, 64),
        "mix": init_linear(rng, 96, 64),
        "slot": rng.normal(0.0, 0.1, (points, 64)).astype(np.float32),
        "hidden": init_linear(rng, 64, 64),
        "u": init_linear(rng, 64, 32),
        "v": init_linear(rng, 64, 32),
        "ways": rng.normal(0.0, 32**-0.5, (32, len(UP_AXES))).astype(np.float32),
        "way_u": init_linear(rng, 64, len(UP_AXES)),
        "way_v": init_linear(rng, 64, len(UP_AXES)),
    }


def apply(p: Params, features: Array, joints: Array, own: Array) -> Array:
    """Q of every action in some states of one chair.

    Args:
        p: of `init`.
        features: (n, f) of the chair's points.
        joints: (b, j) which parts are joined, and how.
        own: (b, n, 8) of points in each state.

    Returns:
        (b, n, n, 6), in shares of the best return.
    """
    xp = own.__array_namespace__()
    b, n = own.shape[:2]
    whole = mlp(p["state"], joints)
    token = xp.concatenate([xp.broadcast_to(features[None], (b, *features.shape)), own], axis=2)
    token = gelu(linear(p["token"], token) + linear(p["mix"], gelu(whole))[:, None] + p["slot"][None])
    token = gelu(linear(p["hidden"], token))
    u = linear(p["u"], token)[:, :, None] * p["ways"].T
    pairs = xp.reshape(u, (b, n * len(UP_AXES), -1)) @ xp.swapaxes(linear(p["v"], token), 1, 2)
    q = xp.moveaxis(xp.reshape(pairs, (b, n, len(UP_AXES), n)), 2, 3)
    return q + linear(p["way_u"], token)[:, :, None] + linear(p["way_v"], token)[:, None]


def double_q_target(reward: Array, done: Array, next_online: Array, next_target: Array, exists: Array) -> Array:
    """What an action's Q should be: `r + Q_target(s', argmax_a' Q_online(s', a'))`, no discount, `r` if it is over.

    Args:
        reward: (...,).
        done: (...,) whether the episode ended.
        next_online: (..., a) by the network that learns.
        next_target: (..., a) by the target network.
        exists: (..., a) which actions exist in the next state.
    """
    xp = reward.__array_namespace__()
    best = xp.argmax(xp.where(exists, next_online, -xp.inf), axis=-1)
    ahead = xp.take_along_axis(next_target, best[..., None], axis=-1)[..., 0]
    return reward + xp.where(done, 0.0, ahead)


def _loss(p: Params, target: Params, features: Array, batch: dict[str, Array]) -> Array:
    q = apply(p, features, batch["joints"], batch["own"])
    b = q.shape[0]
    fails = batch["fails"].astype(jnp.float32)
    # Wrong pairs are by far the most; what matters is not to rank one of them first, so the largest count most.
    wrong = (jnp.maximum(q, 0.0) ** 2 + 0.05 * q**2) * fails
    wrong = wrong.sum((1, 2, 3)) / jnp.maximum(fails.sum((1, 2, 3)), 1.0) + 0.2 * wrong.max((1, 2, 3))
    row, column, way = (batch["actions"][..., i] for i in range(3))
    chosen = q[jnp.arange(b)[:, None], row, column, way]
    after = (batch["next_joints"], batch["next_own"])
    flat = (-1, int(np.prod(q.shape[1:])))
    online = jax.lax.stop_gradient(apply(p, features, *after)).reshape(flat)
    exists = jnp.broadcast_to(batch["next_exists"][..., None], (*batch["next_exists"].shape, len(UP_AXES)))
    ahead = double_q_target(
        batch["rewards"].ravel(), batch["done"].ravel(), online, apply(target, features, *after).reshape(flat),
        exists.reshape(flat),
    )  # fmt: skip
    right = (chosen - ahead.reshape(chosen.shape)) ** 2 * batch["real"]
    return (wrong + 2.0 * right.sum(1) / jnp.maximum(batch["real"].sum(1), 1.0)).mean()


@partial(jax.jit, static_argnums=0)
def _update(rate: float, params: Any, target: Any, moments: Any, features: Any, batch: Any) -> tuple[Any, Any, Any]:
    """One step of Adam for each of several experts."""

    def one(p: Any, t: Any, m: Any, f: Any, b: Any) -> tuple[Any, Any, Any]:
        value, gradient = jax.value_and_grad(_loss)(p, t, f, b)
        change, m = _optimiser(rate).update(gradient, m, p)
        return optax.apply_updates(p, change), m, value

    return jax.vmap(one)(params, target, moments, features, batch)


def _optimiser(rate: float) -> optax.GradientTransformation:
    return optax.chain(optax.clip_by_global_norm(5.0), optax.adam(rate))


@jax.jit
def _values(params: Any, features: Any, joints: Any, own: Any) -> Any:
    """Q of one state for each of several experts."""
    return jax.vmap(lambda p, f, j, o: apply(p, f, j[None], o[None])[0])(params, features, joints, own)


@dataclass(eq=False)
class Memory:
    """What one learner has lived through, as arrays ready for the network."""

    rehearsal: Rehearsal
    features: Float32[np.ndarray, "n f"]
    parts: int
    """Padded."""
    index: dict[State, int] = field(default_factory=dict)
    states: list[State] = field(default_factory=list)
    joints: list[np.ndarray] = field(default_factory=list)
    own: list[np.ndarray] = field(default_factory=list)
    exists: list[np.ndarray] = field(default_factory=list)
    merges: list[dict[Action, int]] = field(default_factory=list)
    """For each state, actions that are known to work and the states that they lead to."""
    recent: list[int] = field(default_factory=list)

    def add(self, state: State) -> int:
        """The state's number, after `index`."""
        if state not in self.index:
            self.index[state] = len(self.states)
            self.states.append(state)
            joints, own = describe(self.rehearsal, state, self.parts, len(self.features))
            self.joints.append(joints)
            self.own.append(own)
            n = len(self.rehearsal.part)
            exists = np.zeros((len(self.features),) * 2, bool)
            exists[:n, :n] = self.rehearsal.exists(state)
            self.exists.append(exists)
            self.merges.append({})
        return self.index[state]

    def sample(self, rng: np.random.Generator, c: ExpertConfig) -> dict[str, np.ndarray]:
        """A batch: half of it states lately seen, half any state that has been left by a merge."""
        left = [i for i, m in enumerate(self.merges) if m] or [0]
        half = c.batch // 2
        chosen = [*rng.choice(self.recent[-4_000:], half), *rng.choice(left, c.batch - half)]
        n, real = len(self.features), len(self.rehearsal.part)
        fails = np.zeros((c.batch, n, n, len(UP_AXES)), bool)
        actions = np.zeros((c.batch, c.backups, 3), np.int32)
        after = np.zeros((c.batch, c.backups), int)
        there = np.zeros((c.batch, c.backups), np.float32)
        for row, i in enumerate(chosen):
            exists = self.exists[i][:real, :real, None]
            fails[row, :real, :real] = (self.rehearsal.known(self.states[i]) == FAILS) & exists
            known = list(self.merges[i].items())
            for slot in range(min(c.backups, len(known))):
                action, follower = known[rng.integers(len(known))]
                actions[row, slot], after[row, slot], there[row, slot] = action, follower, 1.0
        flat = after.ravel()
        done = np.array([len(self.states[i]) == 1 for i in flat])
        total = len(self.states[0]) + 3.0  # the best return
        return {
            "joints": np.array([self.joints[i] for i in chosen]),
            "own": np.array([self.own[i] for i in chosen]),
            "fails": fails,
            "actions": actions,
            "rewards": ((1.0 + 4.0 * done) / total).astype(np.float32),
            "done": done,
            "next_joints": np.array([self.joints[i] for i in flat]),
            "next_own": np.array([self.own[i] for i in flat]),
            "next_exists": np.array([self.exists[i] for i in flat]),
            "real": there,
        }


def describe(rehearsal: Rehearsal, state: State, parts: int, points: int) -> tuple[np.ndarray, np.ndarray]:
    """A state as the network takes it: `joints` (j,) and `own` (points, 8)."""
    connections = rehearsal.connections(state)
    n = len(connections)
    joined = (connections != 0).any(axis=2)
    table = np.zeros((parts, parts, _JOINT), np.float32)
    table[:n, :n, 0] = joined
    table[:n, :n, 1:4] = 2.0 * connections[..., :3]
    table[:n, :n, 4:] = connections[..., 3:] / np.pi
    reference = np.argmax(joined | np.eye(n, dtype=bool), axis=1)
    own = np.zeros((points, _OWN), np.float32)
    rows = slice(len(rehearsal.part))
    own[rows, 0] = (joined.sum(axis=1) / 5.0)[rehearsal.part]
    own[rows, 1] = rehearsal.exists(state).any(axis=1)
    own[rows, 2:] = table[reference, np.arange(n), 1:][rehearsal.part]
    return table[np.triu_indices(parts, 1)].ravel(), own


class Learner:
    """Plays one chair and remembers; its network is trained elsewhere."""

    def __init__(self, memory: Memory, config: ExpertConfig, rng: np.random.Generator) -> None:
        self.memory, self.config, self.rng = memory, config, rng
        self.steps = self.episodes = 0
        self._deepest = self._frontier = 0
        self.state = memory.add(memory.rehearsal.start)
        self.solved_greedily = False
        """Whether the last greedy play ended with the chair."""

    @property
    def greedy(self) -> bool:
        """Whether the current episode is played by Q alone."""
        return self.episodes % self.config.greedy_every == self.config.greedy_every - 1

    def move(self, q: Float32[np.ndarray, "n n 6"]) -> None:
        """One step of the environment; starts a new episode where one ends."""
        memory, rehearsal = self.memory, self.memory.rehearsal
        state = memory.states[self.state]
        action = self._choose(state, q)
        memory.recent.append(self.state)
        after = rehearsal.step(state, action)
        self.steps += 1
        if after is not None:
            follower = memory.add(after)
            memory.merges[self.state][action] = follower
            self.state = follower
        if after is None or rehearsal.done(after):
            if self.greedy:
                self.solved_greedily = after is not None
            self._deepest = max(self._deepest, len(rehearsal.start) - len(state))
            self._frontier = int(self.rng.integers(self._deepest + 1))
            self.episodes += 1
            self.state = 0

    def _choose(self, state: State, q: Float32[np.ndarray, "n n 6"]) -> Action:
        c, rng, rehearsal = self.config, self.rng, self.memory.rehearsal
        n = len(rehearsal.part)
        exists = np.broadcast_to(self.memory.exists[self.state][:n, :n, None], (n, n, len(UP_AXES)))
        q = np.where(exists, q[:n, :n], -np.inf)
        if self.greedy:
            return _argmax(q)
        known = rehearsal.known(state)
        unknown = np.flatnonzero((exists & (known == UNKNOWN)).ravel())
        works = np.flatnonzero((known == MERGES).ravel())
        deep = len(rehearsal.start) - len(state) >= self._frontier
        if len(unknown) and (not len(works) or (deep and rng.random() < c.explore)):
            # The most promising of what was never tried, or now and then any of it.
            pick = rng.choice(unknown) if rng.random() < c.blind else unknown[np.argmax(q.ravel()[unknown])]
            return _unravel(int(pick), q.shape)
        if len(works) and rng.random() < c.wander:
            return _unravel(int(rng.choice(works)), q.shape)
        return _argmax(np.where(known == FAILS, -np.inf, q)) if (known != FAILS).any() else _argmax(q)


def _argmax(q: np.ndarray) -> Action:
    return _unravel(int(np.argmax(q)), q.shape)


def _unravel(flat: int, shape: tuple[int, ...]) -> Action:
    row, column, w = np.unravel_index(flat, shape)
    return int(row), int(column), int(w)


class Bench:
    """Several learners of like size whose networks are updated in one call."""

    def __init__(self, learners: Sequence[Learner], config: ExpertConfig, seed: int) -> None:
        self.learners, self.config = list(learners), config
        rngs = [np.random.default_rng([seed, 1, i]) for i in range(len(learners))]
        first = learners[0].memory
        weights = [init(rng, first.parts, len(first.features), first.features.shape[1]) for rng in rngs]
        self.params: Any = jax.tree.map(lambda *w: jnp.stack(w), *weights)
        self.target = self.params
        self.moments: Any = jax.vmap(_optimiser(config.learning_rate).init)(self.params)
        self.features = np.array([x.memory.features for x in learners])
        self.updates = 0

    def advance(self) -> list[float]:
        """`update_every` steps of every learner, then one update; the losses."""
        for _ in range(self.config.update_every):
            memories = [x.memory for x in self.learners]
            joints = np.array([m.joints[x.state] for m, x in zip(memories, self.learners, strict=True)])
            own = np.array([m.own[x.state] for m, x in zip(memories, self.learners, strict=True)])
            q = np.asarray(_values(self.params, self.features, joints, own))
            for learner, values in zip(self.learners, q, strict=True):
                learner.move(values)
        batches = [x.memory.sample(x.rng, self.config) for x in self.learners]
        batch = {k: np.array([b[k] for b in batches]) for k in batches[0]}
        self.params, self.moments, losses = _update(
            self.config.learning_rate, self.params, self.target, self.moments, self.features, batch
        )
        self.updates += 1
        if self.updates % self.config.target_every == 0:
            self.target = self.params
        return np.asarray(losses).tolist()

    def weights(self, index: int) -> Params:
        """One expert's network."""
        return jax.tree.map(lambda x: np.asarray(x[index]), self.params)
