"""The expert: a Q-network for one chair, and how it acts. Needs NumPy only; `losses` and `train` train it with JAX.

As in the paper, a state goes in as one vector and the Q-values of all actions come out. Three things differ. Q of
`(u, v, k, l, w)` is read off the two points and `w` (a product of embeddings), where the paper decodes a vector for
each action; in the full setting it is the sum of what `g_a` and `g_b` add. What is constant for one chair, the features
and points of the parts, describes the points. Absolute poses are left out, because they do not matter to what fits
what; of the connections the network gets which parts are joined and which points are free, which for one chair
determines the relative poses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Int

from roboassembly.furniture.model import PAPER_PARTS, PAPER_POINTS
from roboassembly.learning.layers import Array, Params, gelu, init_linear, init_mlp, linear, mlp
from roboassembly.learning.paper import heads
from roboassembly.learning.paper.dqn.group_table import point_counts
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.rollout import RememberedTask, rollout
from roboassembly.task.rules.groups import TaskState
from roboassembly.task.setting import Task

KIND = "expert"
"""Kind of the checkpoints."""
POINT_SIZES = (12, 20, 28, 36, 44, 52, 64, 80, 100, 130, 160, PAPER_PARTS * PAPER_POINTS)
"""Padded numbers of points, few, so that few shapes are compiled."""
TIE = 0.05
"""Difference of Q below which two actions count as equally good, as a share of the largest return: half the margin
between actions that lead to the whole chair and all others (`losses.margin_loss`)."""
_WIDTH, _RANK = 64, 32
_ABOVE = np.triu_indices(PAPER_PARTS, 1)


@dataclass(frozen=True, eq=False)
class ChairInputs:
    """Constant inputs of the network for one chair, padded to n points."""

    features: Float32[np.ndarray, "n f"]
    """Position, normal and tangent of each point in its part's frame, and the part's feature."""
    part: Int[np.ndarray, "n"]
    """Part of each point."""
    points: int
    """Number of points without the padding."""
    parts: int
    """Number of parts."""
    branches: tuple[int, ...]
    """Number of choices of each action branch after the two points: of `w`, or of `g_a` and `g_b`. Their combinations
    are numbered in C order."""

    @property
    def max_return(self) -> float:
        """Return of a finished chair: 1 for each merge, 4 more for the last."""
        return self.parts + 3.0


def padded_points(points: int) -> int:
    """Return the least padded number of points that holds so many."""
    return next(s for s in POINT_SIZES if s >= points)


def chair_inputs(task: Task[Any, Any], part_features: Float32[np.ndarray, "P s"]) -> ChairInputs:
    """Return the constant inputs for the chair of a task."""
    furniture = task.furniture
    parts, counts = furniture.parts, point_counts(furniture)
    part = np.repeat(np.arange(len(parts)), counts)
    points: list[Any] = []
    for c, own, count in zip(furniture.class_of, parts, counts, strict=True):
        # A part gets the points that only an equal part has once it takes that part's slot.
        most = max((parts[m].points for m in furniture.classes[c].members), key=len)
        points += [*own.points, *most[len(own.points) : count]]
    frames = np.array([[p.position * 2.0, p.normal, p.tangent] for p in points])
    size = padded_points(len(part))
    features = np.zeros((size, 9 + part_features.shape[1]), np.float32)
    features[: len(part), :9], features[: len(part), 9:] = frames.reshape(-1, 9), part_features[part]
    return ChairInputs(features, np.pad(part, (0, size - len(part))), len(part), len(parts), task.action_branches)


def init(
    rng: np.random.Generator, points: int, features: int, branches: tuple[int, ...] = ObjectCentricTask.action_branches
) -> Params:
    """Return fresh weights.

    Args:
        rng: random numbers.
        points: padded number of points.
        features: size of the constant feature of a point.
        branches: number of choices of each action branch.
    """
    return {
        "state": init_mlp(rng, len(_ABOVE[0]) + points, 128, _WIDTH),
        "token": init_linear(rng, features + PAPER_PARTS + 2, _WIDTH),
        "slot": rng.normal(0.0, 0.1, (points, _WIDTH)).astype(np.float32),
        "hidden": init_linear(rng, _WIDTH, _WIDTH),
        "u": init_linear(rng, _WIDTH, _RANK),
        "v": init_linear(rng, _WIDTH, _RANK),
        "heads": heads.init(rng, _WIDTH, _RANK, branches),
    }


def apply(p: Params, features: Array, part: Array, joined: Array, free: Array) -> Array:
    """Return Q of every action in some states of one chair, as shares of the largest return.

    Args:
        p: weights from `init`.
        features: (n, f) constant features of the chair's points.
        part: (n,) part of each point.
        joined: (b, 20, 20) whether two parts are in one group, 1 or 0.
        free: (b, n) whether a point exists and is free, 1 or 0.

    Returns:
        (b, n, n, w) over all combinations of branches.
    """
    return heads.combined(branch_values(p, features, part, joined, free))


def branch_values(p: Params, features: Array, part: Array, joined: Array, free: Array) -> list[Array]:
    """Return what each branch adds to the Q of two points, (b, n, n, w_i) each; see `apply`."""
    return heads.branch_values(p["heads"], *_embeddings(p, features, part, joined, free))


def values_of(p: Params, features: Array, part: Array, joined: Array, free: Array, actions: Array) -> Array:
    """Return (b,) Q of one action (b, 3) in each state, without that of the others; see `apply`."""
    return heads.values_of(p["heads"], *_embeddings(p, features, part, joined, free), actions)


def _embeddings(
    p: Params, features: Array, part: Array, joined: Array, free: Array
) -> tuple[Array, Array, Array, Array]:
    """Return the embeddings of each point as one that moves and as one that waits, and the inputs of its biases."""
    xp = joined.__array_namespace__()
    b = len(free)
    whole = mlp(p["state"], xp.concatenate([joined[:, _ABOVE[0], _ABOVE[1]], free], axis=1))
    size = xp.sum(joined, axis=2)[:, part, None] / 5.0
    fixed = xp.broadcast_to(features[None], (b, *features.shape))
    token = linear(p["token"], xp.concatenate([fixed, joined[:, part], size, free[..., None]], axis=2))
    token = gelu(token + whole[:, None] + p["slot"][None])
    token = gelu(linear(p["hidden"], token))
    return linear(p["u"], token), linear(p["v"], token), token, token


def existing_pairs(part: Array, joined: Array, free: Array) -> Array:
    """Return (b, n, n) which pairs of points exist: both free, their parts in different groups."""
    xp = joined.__array_namespace__()
    group = xp.argmax(joined, axis=2)[:, part]
    return (group[:, :, None] != group[:, None]) & (free[:, :, None] > 0) & (free[:, None] > 0)


@dataclass(frozen=True, eq=False)
class ExpertPolicy:
    """A trained Q-network and the chair that it assembles."""

    inputs: ChairInputs
    params: Params

    def values(self, joined: Bool[np.ndarray, "20 20"], free: Bool[np.ndarray, "m"]) -> Float32[np.ndarray, "m m w"]:
        """Return Q over all points, as shares of the largest return; -inf where the action does not exist."""
        arrays, m = self._arrays(joined, free), len(free)
        q = np.where(existing_pairs(*arrays[1:])[..., None], apply(self.params, *arrays), -np.inf)
        return q[0, :m, :m]

    def branch_values(self, joined: Bool[np.ndarray, "20 20"], free: Bool[np.ndarray, "m"]) -> list[np.ndarray]:
        """Return what each branch adds to Q, (m, m, w_i) each, whether the action exists or not."""
        m = len(free)
        return [np.asarray(x)[0, :m, :m] for x in branch_values(self.params, *self._arrays(joined, free))]

    def _arrays(self, joined: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, ...]:
        padded = np.zeros((1, len(self.inputs.part)), np.float32)
        padded[0, : len(free)] = free
        return self.inputs.features, self.inputs.part, joined[None].astype(np.float32), padded


@dataclass(frozen=True, eq=False)
class ExpertStep:
    """One step of an expert's episode."""

    state: TaskState
    """Groups before the step."""
    action: tuple[int, int, int]
    """Rows of the two points and number of the combination of branches."""
    verdict: str = ""
    """Verdict of the task."""
    merged: bool = False
    """Whether two groups were joined."""


def encode_state(task: Task[Any, Any], state: TaskState) -> tuple[Bool[np.ndarray, "20 20"], Bool[np.ndarray, "m"]]:
    """Return what an expert sees of a state: which parts are joined and which points are free."""
    joined = np.zeros((PAPER_PARTS, PAPER_PARTS), bool)
    for group in state.groups:
        joined[np.ix_(group.parts, group.parts)] = True
    free = task.rules.free_points(state)
    return joined, np.concatenate([free[i, :count] for i, count in enumerate(point_counts(task.furniture))])


def run_expert(
    expert: ExpertPolicy, task: Task[Any, Any], seed: int, known: RememberedTask[Any, Any] | None = None
) -> list[ExpertStep]:
    """Run one episode in the real environment, where nothing of `MemoizedEnv` counts.

    Args:
        expert: takes the first of the actions with the highest Q.
        task: task of its chair.
        seed: random seed of the start and of the planner.
        known: the same task with the episodes that it remembers.
    """
    return _run_episode(
        lambda state: first_best(expert.values(*encode_state(task, state))), expert.inputs, task, seed, known
    )


def run_actions(
    actions: Sequence[tuple[int, int, int]],
    inputs: ChairInputs,
    task: Task[Any, Any],
    seed: int,
    known: RememberedTask[Any, Any] | None = None,
) -> list[ExpertStep]:
    """Run one episode of given actions in the real environment, up to the first that fails.

    Args:
        actions: actions that assemble the chair in `MemoizedEnv`.
        inputs: the chair.
        task: its task.
        seed: random seed of the start and of the planner.
        known: the same task with the episodes that it remembers.
    """
    left = iter(actions)
    return _run_episode(lambda _: next(left), inputs, task, seed, known)


def _run_episode(
    choose: Callable[[TaskState], tuple[int, int, int]],
    inputs: ChairInputs,
    task: Task[Any, Any],
    seed: int,
    known: RememberedTask[Any, Any] | None,
) -> list[ExpertStep]:
    real = task if known is None else known
    rng = np.random.default_rng(seed)
    part, point = inputs.part, _point_numbers(inputs)
    steps: list[ExpertStep] = []

    def propose(state: Any) -> Iterator[tuple[int, ...]]:
        groups = task.groups_of(state)
        row, column, choice = choose(groups)
        steps.append(ExpertStep(groups, (row, column, choice)))
        branches = (int(i) for i in np.unravel_index(choice, task.action_branches))
        yield int(part[row]), int(part[column]), int(point[row]), int(point[column]), *branches

    for transition in rollout(real, real.initial_state(rng), propose, rng):
        steps[-1] = replace(steps[-1], verdict=transition.outcome.verdict, merged=transition.merged)
    return steps


def finished(steps: list[ExpertStep], inputs: ChairInputs) -> bool:
    """Return whether an episode ended with the whole chair."""
    return len(steps) == inputs.parts - 1 and steps[-1].merged


def first_best(values: Float32[np.ndarray, "m m w"], tie: float = TIE) -> tuple[int, int, int]:
    """Return the first action, in number order, whose value is within a tie of the highest."""
    flat = int(np.argmax(values >= values.max() - tie))
    row, column, choice = np.unravel_index(flat, values.shape)
    return int(row), int(column), int(choice)


def _point_numbers(inputs: ChairInputs) -> Int[np.ndarray, "m"]:
    """Return the number of each point in its part."""
    part = inputs.part[: inputs.points]
    return np.arange(len(part)) - np.searchsorted(part, part)
