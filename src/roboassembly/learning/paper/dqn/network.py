"""An expert: a Q-network for one chair, and how it plays. Acts with NumPy alone; `double_q` trains it with JAX.

As in the paper a state goes in as one vector, and Q-values of all actions come out. What differs: Q of
`(u, v, k, l, w)` is read off the two points and `w` (a product of embeddings), where the paper decodes a vector for
each action; with robots it is the sum of what `g_a` and `g_b` add; and of the state that goes in, what is constant for
one chair (features and points) describes the points, absolute poses are left out (they do not matter to what fits
what), and of the connections it is told which parts are joined and which points are free (with one chair, this tells
the relative poses too).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Int

from roboassembly.furniture.model import MAX_PARTS, MAX_POINTS
from roboassembly.learning.layers import Array, Params, gelu, init_linear, init_mlp, linear, mlp
from roboassembly.learning.paper import heads
from roboassembly.learning.paper.dqn.group_table import point_counts
from roboassembly.task.object_centric.task import ObjectCentricTask, ObjectCentricVerdict
from roboassembly.task.rollout import rollout
from roboassembly.task.rules.groups import TaskState
from roboassembly.task.setting import Task

KIND = "expert"
"""Of checkpoints."""
POINT_SIZES = (12, 20, 28, 36, 44, 52, 64, 80, 100, 130, 160, MAX_PARTS * MAX_POINTS)
"""Points are padded to one of these, so that few shapes are compiled."""
_WIDTH, _RANK = 64, 32
_ABOVE = np.triu_indices(MAX_PARTS, 1)


@dataclass(frozen=True, eq=False)
class Chair:
    """What of a chair never changes, padded to n points."""

    features: Float32[np.ndarray, "n f"]
    """Of each point: its position, normal and tangent in the part's frame, and the part's shape."""
    part: Int[np.ndarray, "n"]
    """Of each point."""
    points: int
    """That are real."""
    parts: int
    ways: tuple[int, ...]
    """Choices after the two points: of `w`, or of `g_a` and `g_b`. Together they are numbered through."""

    @property
    def best(self) -> float:
        """The return of a chair that is finished: a point a merge, four more for the last."""
        return self.parts + 3.0


def chair_of(task: Task[Any, Any], shapes: Float32[np.ndarray, "P s"]) -> Chair:
    """What of a chair never changes; `shapes` are the features of its parts."""
    furniture = task.furniture
    parts, counts = furniture.parts, point_counts(furniture)
    part = np.repeat(np.arange(len(parts)), counts)
    rows = []
    for c, piece, count in zip(furniture.class_of, parts, counts, strict=True):
        # Points that only a like of the part has: it gets them in that one's slot.
        most = max((parts[m].points for m in furniture.classes[c].members), key=len)
        rows += [*piece.points, *most[len(piece.points) : count]]
    own = np.array([[p.position * 2.0, p.normal, p.tangent] for p in rows])
    size = next(s for s in POINT_SIZES if s >= len(part))
    features = np.zeros((size, 9 + shapes.shape[1]), np.float32)
    features[: len(part), :9], features[: len(part), 9:] = own.reshape(-1, 9), shapes[part]
    return Chair(features, np.pad(part, (0, size - len(part))), len(part), len(parts), task.action_branches)


def init(
    rng: np.random.Generator, points: int, features: int, ways: tuple[int, ...] = ObjectCentricTask.action_branches
) -> Params:
    """Fresh weights.

    Args:
        rng: draws them.
        points: padded.
        features: numbers that describe a point for good.
        ways: of the chair.
    """
    return {
        "state": init_mlp(rng, len(_ABOVE[0]) + points, 128, _WIDTH),
        "token": init_linear(rng, features + MAX_PARTS + 2, _WIDTH),
        "slot": rng.normal(0.0, 0.1, (points, _WIDTH)).astype(np.float32),
        "hidden": init_linear(rng, _WIDTH, _WIDTH),
        "u": init_linear(rng, _WIDTH, _RANK),
        "v": init_linear(rng, _WIDTH, _RANK),
        "heads": heads.init(rng, _WIDTH, _RANK, ways),
    }


def apply(p: Params, features: Array, part: Array, joined: Array, free: Array) -> Array:
    """Q of every action in some states of one chair, in shares of the best return.

    Args:
        p: of `init`.
        features: (n, f) of the chair's points.
        part: (n,) of the chair's points.
        joined: (b, 20, 20) whether two parts are in one group, 1 or 0.
        free: (b, n) whether a point exists and is free, 1 or 0.

    Returns:
        (b, n, n, w) over all ways.
    """
    return heads.together(added(p, features, part, joined, free))


def added(p: Params, features: Array, part: Array, joined: Array, free: Array) -> list[Array]:
    """What each choice adds to the Q of two points, (b, n, n, w) each; arguments as of `apply`."""
    xp = joined.__array_namespace__()
    b = len(free)
    whole = mlp(p["state"], xp.concatenate([joined[:, _ABOVE[0], _ABOVE[1]], free], axis=1))
    size = xp.sum(joined, axis=2)[:, part, None] / 5.0
    fixed = xp.broadcast_to(features[None], (b, *features.shape))
    token = linear(p["token"], xp.concatenate([fixed, joined[:, part], size, free[..., None]], axis=2))
    token = gelu(token + whole[:, None] + p["slot"][None])
    token = gelu(linear(p["hidden"], token))
    u, v = linear(p["u"], token), linear(p["v"], token)
    return heads.added(p["heads"], u, v, token, token)


def existing(part: Array, joined: Array, free: Array) -> Array:
    """(b, n, n) which pairs of points exist: both free, their parts in different groups."""
    together = joined[:, part][:, :, part] > 0
    return ~together & (free[:, :, None] > 0) & (free[:, None] > 0)


@dataclass(frozen=True, eq=False)
class Expert:
    """A trained network and its chair."""

    chair: Chair
    params: Params

    def values(self, joined: Bool[np.ndarray, "20 20"], free: Bool[np.ndarray, "m"]) -> Float32[np.ndarray, "m m w"]:
        """Q over all points of the chair, in shares of the best return; -inf where the action does not exist."""
        seen, m = self._seen(joined, free), len(free)
        q = np.where(existing(*seen[1:])[..., None], apply(self.params, *seen), -np.inf)
        return q[0, :m, :m]

    def added(self, joined: Bool[np.ndarray, "20 20"], free: Bool[np.ndarray, "m"]) -> list[np.ndarray]:
        """What each choice adds to that, (m, m, w) each, whether the action exists or not."""
        m = len(free)
        return [np.asarray(x)[0, :m, :m] for x in added(self.params, *self._seen(joined, free))]

    def _seen(self, joined: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, ...]:
        padded = np.zeros((1, len(self.chair.part)), np.float32)
        padded[0, : len(free)] = free
        return self.chair.features, self.chair.part, joined[None].astype(np.float32), padded


@dataclass(frozen=True, eq=False)
class Move:
    """One step of a play."""

    state: TaskState
    values: Float32[np.ndarray, "m m w"]
    action: tuple[int, int, int]
    """Rows of the two points and number of the way."""
    verdict: str


def told(task: Task[Any, Any], state: TaskState) -> tuple[Bool[np.ndarray, "20 20"], Bool[np.ndarray, "m"]]:
    """Of a state, which parts are joined and which points are free: what an expert sees."""
    joined = np.zeros((MAX_PARTS, MAX_PARTS), bool)
    for group in state.groups:
        joined[np.ix_(group.parts, group.parts)] = True
    free = task.rules.free_points(state)
    return joined, np.concatenate([free[i, :count] for i, count in enumerate(point_counts(task.furniture))])


def play(expert: Expert, task: Task[Any, Any], seed: int, margin: float = 0.0) -> list[Move]:
    """One episode in the real environment, nothing remembered.

    Args:
        expert: takes the action with the highest Q.
        task: of its chair.
        seed: of the start, the planner and the draws.
        margin: any action whose Q is this little below the highest (in shares of the best return) may be drawn.
    """
    rng = np.random.default_rng(seed)
    part, point = expert.chair.part, _point(expert.chair)
    moves: list[Move] = []

    def propose(state: Any) -> Iterator[tuple[int, ...]]:
        joined = task.groups_of(state)
        values = expert.values(*told(task, joined))
        row, column, way = choose(values, rng, margin)
        moves.append(Move(joined, values, (row, column, way), ""))
        ways = (int(i) for i in np.unravel_index(way, task.action_branches))
        yield int(part[row]), int(part[column]), int(point[row]), int(point[column]), *ways

    for transition in rollout(task, task.initial_state(rng), propose, rng):
        moves[-1] = replace(moves[-1], verdict=str(transition.outcome.verdict))
    return moves


def finished(moves: list[Move], chair: Chair) -> bool:
    """Whether a play ended with the whole chair."""
    return len(moves) == chair.parts - 1 and moves[-1].verdict == ObjectCentricVerdict.MERGED


def choose(values: Float32[np.ndarray, "m m w"], rng: np.random.Generator, margin: float = 0.0) -> tuple[int, int, int]:
    """The action with the highest Q, or any that is at most `margin` below."""
    best = values.max()
    pick = int(rng.choice(np.flatnonzero(values.ravel() >= best - margin))) if margin else int(values.argmax())
    row, column, w = np.unravel_index(pick, values.shape)
    return int(row), int(column), int(w)


def _point(chair: Chair) -> Int[np.ndarray, "m"]:
    """Each point's number within its part."""
    part = chair.part[: chair.points]
    return np.arange(len(part)) - np.searchsorted(part, part)
