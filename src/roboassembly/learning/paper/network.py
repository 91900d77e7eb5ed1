"""The paper's multi-task policy: one padded state vector, an MLP, and a Q-value for every action.

A chair has at most 20 parts and a part at most 10 connection points. The state vector concatenates these arrays, with
zeros where a part or a point does not exist:

| content | shape | unit |
|---|---|---|
| feature of each part's cloud, from the frozen auto-encoder | (20, 48) | – |
| connection points: position, outward normal, tangent, part frame | (20, 10, 9) | m, 1, 1 |
| whether a point exists and is free, as the action mask says | (20, 10, 1) | – |
| world pose of each part: translation, Euler angles | (20, 6) | m, rad |
| connection matrix: pose of part j in part i's frame if they are joined | (20, 20, 6) | m, rad |
| in the full setting: gripper pose of each grasp, part frame | (20, 8, 6) | m, rad |

The network standardises each channel over the rows that are not padding, leaves padding at zero, and gets one number
more for each row: whether it is there. For the connection matrix these numbers say which parts are joined.

An MLP with layer normalisation makes a global feature of it. From this feature each of the 200 slots for points gets
an embedding in the role of the moving point and one in the role of the waiting point, and

    Q(u, k, v, l, w) = sum_d a[u, k, d] b[v, l, d] W[d, w] + A[u, k, w] + B[v, l, w]

with A and B affine in a and b: 240,000 values from 200 · 2 · d numbers, where the best `w` depends on the pair. In the
full setting Q is a sum of two such terms, of `g_a` and of `g_b` (`heads`). Weights belong to slots, so that the
network, as in the paper, knows parts by their numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from roboassembly.envs.observation import Observation
from roboassembly.errors import InputError
from roboassembly.furniture.model import PAPER_PARTS, PAPER_POINTS
from roboassembly.learning.checkpoint import Checkpoint, check_arrays, network_config
from roboassembly.learning.layers import Array, Params, gelu, init_linear, init_norm, linear, norm
from roboassembly.learning.paper import autoencoder, heads
from roboassembly.learning.paper.autoencoder import CLOUD_POINTS, FEATURE
from roboassembly.task.rules.connections import FULL_BRANCHES, GRASPS, OBJECT_CENTRIC_BRANCHES
from roboassembly.task.setting import SettingName

KIND = "paper"
"""Kind of the checkpoints."""
SLOTS = PAPER_PARTS * PAPER_POINTS
"""Number of slots for points; point k of part p has slot `PAPER_POINTS * p + k`."""
SECTIONS = {
    "features": (PAPER_PARTS, FEATURE),
    "points": (PAPER_PARTS, PAPER_POINTS, 9),
    "free": (PAPER_PARTS, PAPER_POINTS, 1),
    "poses": (PAPER_PARTS, 6),
    "connections": (PAPER_PARTS, PAPER_PARTS, 6),
}
"""Sections of the state vector, in order, and their shapes."""
GRASP_SECTION = {"grasps": (PAPER_PARTS, GRASPS, 6)}
"""Further section of the full setting."""
_CONSTANT = 1e-4
"""Deviation up to which a channel counts as constant; the reciprocal of a larger one fits into 16 bits."""
_RETURN = 10.0
"""Typical return of an episode: unit of the network's outputs, so that they start near one."""


@dataclass(frozen=True, eq=False)
class PaperState:
    """Content of the state vector before padding: P parts with at most K points each."""

    features: Float[np.ndarray, "P 48"]
    points: Float[np.ndarray, "P K 9"]
    free: Float[np.ndarray, "P K 1"]
    """1 where a point exists and is free, else 0."""
    poses: Float[np.ndarray, "P 6"]
    connections: Float[np.ndarray, "P P 6"]
    grasps: Float[np.ndarray, "P 8 6"] | None = None
    """Gripper poses; None in the object-centric setting."""

    def write(self, into: Float32[np.ndarray, "s"]) -> None:
        """Write the state into a vector of zeros."""
        begin = 0
        for name, shape in sections(self.grasps is not None).items():
            end = begin + int(np.prod(shape))
            value = getattr(self, name)
            # The last axis is never padded.
            into[begin:end].reshape(shape)[tuple(slice(n) for n in value.shape[:-1])] = value
            begin = end


def setting_of(full: bool) -> SettingName:
    """Return the setting of a network."""
    return "full" if full else "object-centric"


def sections(full: bool) -> dict[str, tuple[int, ...]]:
    """Return the sections of the state vector of a setting, in order, and their shapes."""
    return {**SECTIONS, **(GRASP_SECTION if full else {})}


def state_size(full: bool) -> int:
    """Return the length of the state vector: 5,480, in the full setting 6,440."""
    return sum(int(np.prod(shape)) for shape in sections(full).values())


def _row_count(full: bool) -> int:
    """Return the number of rows of all sections; the last axis of a section counts channels."""
    return sum(int(np.prod(shape[:-1])) for shape in sections(full).values())


@dataclass(frozen=True)
class PaperConfig:
    """Sizes of the network."""

    hidden: int = 512
    """Width of the hidden layer."""
    feature: int = 512
    """Size of the global feature."""
    slot: int = 24
    """Size of a slot's embedding."""
    full: bool = False
    """Whether the network acts in the full setting."""

    @property
    def branches(self) -> tuple[int, ...]:
        """Number of choices of each action branch after the two points."""
        return FULL_BRANCHES if self.full else OBJECT_CENTRIC_BRANCHES


def init(rng: np.random.Generator, c: PaperConfig) -> Params:
    """Return fresh weights of the Q-network."""
    return {
        "state": {
            str(i): {"map": init_linear(rng, a, b), "norm": init_norm(b)}
            for i, (a, b) in enumerate(pairwise((state_size(c.full) + _row_count(c.full), c.hidden, c.feature)))
        },
        "slots": init_linear(rng, c.feature, SLOTS * 2 * c.slot),
        "heads": heads.init(rng, c.slot, c.slot, c.branches, mean=1.0, deviation=0.5),
    }


def normalization(states: Float[np.ndarray, "b s"]) -> dict[str, Float32[np.ndarray, "s"]]:
    """Return mean and reciprocal deviation of each channel (the last axis of a section) over all slots that are used.

    The factor of a constant channel is 0.
    """
    means: list[np.ndarray] = []
    scales: list[np.ndarray] = []
    begin = 0
    for shape in sections(states.shape[1] > state_size(False)).values():
        end = begin + int(np.prod(shape))
        rows = states[:, begin:end].reshape(-1, shape[-1])
        rows = rows[(rows != 0).any(axis=1)]
        mean, deviation = (rows.mean(axis=0), rows.std(axis=0)) if len(rows) else (np.zeros(shape[-1]),) * 2
        scale = np.where(deviation > _CONSTANT, 1.0 / np.maximum(deviation, _CONSTANT), 0.0)
        means.append(np.tile(mean, (end - begin) // shape[-1]))
        scales.append(np.tile(scale, (end - begin) // shape[-1]))
        begin = end
    return {"mean": np.concatenate(means).astype(np.float32), "scale": np.concatenate(scales).astype(np.float32)}


def apply(p: Params, inputs: Params, state: Array, slot: Array) -> Array:
    """Return Q of all actions between some slots.

    Args:
        p: weights from `init`.
        inputs: mean and scale from `normalization`.
        state: (b, s) state vectors, s as in `state_size`.
        slot: (b, n) numbers of the slots.

    Returns:
        (b, n, n, w) undiscounted returns over all combinations of branches: 1 for each merge, 4 more for the whole.
        Rows move onto columns.
    """
    return heads.combined(branch_values(p, inputs, state, slot))


def branch_values(p: Params, inputs: Params, state: Array, slot: Array) -> list[Array]:
    """Return what each branch adds to Q, (b, n, n, w_i); see `apply`."""
    xp = state.__array_namespace__()
    b = len(slot)
    whole = _masked(inputs, state)
    for i in range(len(p["state"])):
        layer = p["state"][str(i)]
        whole = gelu(norm(layer["norm"], linear(layer["map"], whole)))
    slots = xp.reshape(linear(p["slots"], whole), (b, SLOTS, -1))
    some = slots[xp.arange(b)[:, None], slot]
    half = some.shape[2] // 2
    u, v = some[..., :half], some[..., half:]
    return [_RETURN * values for values in heads.branch_values(p["heads"], u, v, u, v)]


def _masked(inputs: Params, state: Array) -> Array:
    """Return (b, s + r) the standardised states, with padding left at zero, and which of the r rows are there."""
    xp = state.__array_namespace__()
    values: list[Array] = []
    there: list[Array] = []
    begin = 0
    for shape in sections(state.shape[1] > state_size(False)).values():
        end = begin + int(np.prod(shape))
        rows = xp.reshape(state[:, begin:end], (len(state), -1, shape[-1]))
        present = xp.astype(xp.any(rows != 0, axis=2, keepdims=True), state.dtype)
        mean, scale = (xp.reshape(inputs[name][begin:end], rows.shape[1:]) for name in ("mean", "scale"))
        values.append(xp.reshape((rows - mean) * scale * present, (len(state), -1)))
        there.append(present[:, :, 0])
        begin = end
    return xp.concatenate([*values, *there], axis=1)


class PaperPolicy:
    """The paper's policy: takes the action with the largest Q, from the observation and the action mask alone.

    Args:
        params: `network` from `init`, `inputs` from `normalization`, `encoder` from the auto-encoder.
        full: whether it acts in the full setting.
    """

    name = "paper"
    cloud_points = CLOUD_POINTS

    def __init__(self, params: Params, full: bool = False) -> None:
        self._params, self._full = params, full
        self.settings: tuple[SettingName, ...] = (setting_of(full),)
        self._encoded: tuple[np.ndarray, np.ndarray] | None = None
        """Clouds of the parts and their features."""

    @classmethod
    def from_checkpoint(cls, loaded: Checkpoint, where: str) -> PaperPolicy:
        """Return the policy of a checkpoint.

        Args:
            loaded: the checkpoint.
            where: its file, for messages.

        Raises:
            InputError: it is of another kind, or its arrays do not fit its configuration.
        """
        if loaded.kind != KIND:
            raise InputError(f"'{where}' holds a '{loaded.kind}' network where a '{KIND}' one is needed")
        config = network_config(PaperConfig(), loaded.config.get("network"), where)
        rng, zeros = np.random.default_rng(0), np.zeros(state_size(config.full), np.float32)
        inputs = {"mean": zeros, "scale": zeros}
        expected = {"network": init(rng, config), "inputs": inputs, "encoder": autoencoder.init(rng)}
        check_arrays(loaded.params, expected, where)
        return cls(loaded.params, config.full)

    def values(
        self, observation: Observation, mask: Bool[np.ndarray, "P P K K ..."]
    ) -> Float32[np.ndarray, "P P K K ..."]:
        """Return Q of every action; -inf where the action does not exist."""
        exists = mask.reshape(*mask.shape[:4], -1)
        part, point = np.nonzero(exists.any(axis=(1, 3, 4)) | exists.any(axis=(0, 2, 4)))
        out = np.full(mask.shape, -np.inf, np.float32)
        if len(part):
            state = np.zeros((1, state_size(self._full)), np.float32)
            free = np.zeros((mask.shape[0], mask.shape[2], 1), np.float32)
            free[part, point] = 1.0
            self._state(observation, free).write(state[0])
            slot = (PAPER_POINTS * part + point)[None]
            q = apply(self._params["network"], self._params["inputs"], state, slot)[0]
            u, v = part[:, None], part[None]
            out[u, v, point[:, None], point[None]] = q.reshape(*q.shape[:2], *mask.shape[4:])
        return np.where(mask, out, np.float32(-np.inf))

    def act(self, observation: Observation, mask: Bool[np.ndarray, "P P K K ..."]) -> Int[np.ndarray, "_"]:
        """Return the action with the largest Q.

        Raises:
            InputError: no action exists.
        """
        if not mask.any():
            raise InputError("no action exists; the episode is over")
        q = self.values(observation, mask)
        return np.array(np.unravel_index(int(np.argmax(q)), q.shape))

    def _state(self, observation: Observation, free: Float32[np.ndarray, "P K 1"]) -> PaperState:
        shapes = observation["shapes"]
        parts = int(np.flatnonzero(shapes.any(axis=(1, 2)))[-1]) + 1
        if parts > PAPER_PARTS:
            raise InputError(f"the furniture has {parts} parts; preset '{KIND}' takes at most {PAPER_PARTS}")
        # The parts stay the same through an episode, and encoding them is most of the work.
        if self._encoded is None or not np.array_equal(self._encoded[0], shapes):
            self._encoded = shapes.copy(), autoencoder.encode(self._params["encoder"], shapes[:parts])
        return PaperState(
            self._encoded[1],
            observation["connection_points"][:parts],
            free[:parts],
            observation["poses"][:parts],
            observation["connections"][:parts, :parts],
            observation["grasp_regions"][:parts].reshape(parts, GRASPS, 6) if self._full else None,
        )
