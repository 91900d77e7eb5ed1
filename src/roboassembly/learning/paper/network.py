"""The paper's multi-task policy: its whole state in one padded vector, an MLP, and a Q-value for every action.

A chair has at most 20 parts and a part at most 10 connection points. The state vector is these, one after another,
each with zeros where a part or a point is not there:

| what | shape | unit |
|---|---|---|
| feature of each part's cloud, by the frozen auto-encoder | (20, 48) | – |
| connection points: position, outward normal, tangent, part frame | (20, 10, 9) | m, 1, 1 |
| world pose of each part: translation, Euler angles | (20, 6) | m, rad |
| connection matrix: pose of part j in part i's frame if they are joined | (20, 20, 6) | m, rad |
| with robots: the hand at each grasp, part frame | (20, 8, 6) | m, rad |

An MLP, with layer normalisation, makes a global feature of it. From that, all 200 slots for points are given an
embedding in the role of the moving point and one in that of the waiting point, and

    Q(u, k, v, l, w) = sum_d a[u, k, d] b[v, l, d] W[d, w] + A[u, k, w] + B[v, l, w]

with A and B affine in a and b: 240,000 values by way of 200 · 2 · d numbers, where the best `w` depends on the pair.
With robots it is a sum of two of these, of `g_a` and of `g_b` (`heads`). Weights belong to slots; so, as in the paper,
the network knows parts by their numbers, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from roboassembly.envs.observation import Observation
from roboassembly.errors import InputError
from roboassembly.furniture.model import MAX_PARTS, MAX_POINTS
from roboassembly.learning.checkpoint import Checkpoint
from roboassembly.learning.layers import Array, Params, gelu, init_linear, init_norm, linear, norm
from roboassembly.learning.paper import autoencoder, heads
from roboassembly.learning.paper.autoencoder import CLOUD_POINTS, FEATURE
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.rules.connections import GRASPS
from roboassembly.task.setting import SettingName

KIND = "paper"
"""Of checkpoints."""
SLOTS = MAX_PARTS * MAX_POINTS
"""Slot `MAX_POINTS * part + point`."""
SECTIONS = {
    "features": (MAX_PARTS, FEATURE),
    "points": (MAX_PARTS, MAX_POINTS, 9),
    "poses": (MAX_PARTS, 6),
    "connections": (MAX_PARTS, MAX_PARTS, 6),
}
"""Of the state vector, in order, and their shapes."""
GRASP_SECTION = {"grasps": (MAX_PARTS, GRASPS, 6)}
"""What the state vector has besides with robots."""
_RETURN = 10.0
"""About the return of a play: the network's outputs are in this unit inside, so that they start out of order one."""


@dataclass(frozen=True, eq=False)
class PaperState:
    """What the state vector is made of, before padding: P parts, K points at most on one."""

    features: Float[np.ndarray, "P 48"]
    points: Float[np.ndarray, "P K 9"]
    poses: Float[np.ndarray, "P 6"]
    connections: Float[np.ndarray, "P P 6"]
    grasps: Float[np.ndarray, "P 8 6"] | None = None
    """With robots."""

    def write(self, into: Float32[np.ndarray, "s"]) -> None:
        """Put it into a vector of zeros."""
        begin = 0
        for name, shape in sections(self.grasps is not None).items():
            end = begin + int(np.prod(shape))
            value = getattr(self, name)
            # The last axis is never padded.
            into[begin:end].reshape(shape)[tuple(slice(n) for n in value.shape[:-1])] = value
            begin = end


def sections(hands: bool) -> dict[str, tuple[int, ...]]:
    """Of the state vector, in order, and their shapes."""
    return {**SECTIONS, **(GRASP_SECTION if hands else {})}


def size(hands: bool) -> int:
    """Of the state vector: 5,280, with hands 6,240."""
    return sum(int(np.prod(shape)) for shape in sections(hands).values())


@dataclass(frozen=True)
class PaperConfig:
    """Sizes of the network."""

    hidden: int = 384
    feature: int = 256
    """Of the global feature."""
    slot: int = 16
    """Of an embedding."""
    hands: bool = False
    """For the full setting."""

    @property
    def ways(self) -> tuple[int, ...]:
        """Choices after the two points."""
        return FullTask.action_branches if self.hands else ObjectCentricTask.action_branches


def init(rng: np.random.Generator, c: PaperConfig) -> Params:
    """Fresh weights of the Q-network."""
    return {
        "state": {
            str(i): {"map": init_linear(rng, a, b), "norm": init_norm(b)}
            for i, (a, b) in enumerate(pairwise((size(c.hands), c.hidden, c.hidden, c.feature)))
        },
        "slots": init_linear(rng, c.feature, SLOTS * 2 * c.slot),
        "heads": heads.init(rng, c.slot, c.slot, c.ways, mean=1.0, spread=0.5),
    }


def standard(states: Float[np.ndarray, "b s"]) -> dict[str, Float32[np.ndarray, "s"]]:
    """Mean and reciprocal deviation of each channel (the last axis of a section) over what is there, all slots alike.

    Constant channels are left out by a factor of 0.
    """
    means, scales, begin = [], [], 0
    for shape in sections(states.shape[1] > size(False)).values():
        end = begin + int(np.prod(shape))
        rows = states[:, begin:end].reshape(-1, shape[-1])
        rows = rows[(rows != 0).any(axis=1)]
        mean, deviation = (rows.mean(axis=0), rows.std(axis=0)) if len(rows) else (np.zeros(shape[-1]),) * 2
        scale = np.where(deviation > 1e-6, 1.0 / np.maximum(deviation, 1e-6), 0.0)
        means.append(np.tile(mean, (end - begin) // shape[-1]))
        scales.append(np.tile(scale, (end - begin) // shape[-1]))
        begin = end
    return {"mean": np.concatenate(means).astype(np.float32), "scale": np.concatenate(scales).astype(np.float32)}


def apply(p: Params, inputs: Params, state: Array, slot: Array) -> Array:
    """Q of all actions between some slots.

    Args:
        p: of `init`.
        inputs: of `standard`.
        state: (b, s), s as of `size`.
        slot: (b, n) points to value, as numbers of slots.

    Returns:
        (b, n, n, w) over all ways, undiscounted return: 1 for each merge, 4 more for the whole. Rows move onto columns.
    """
    return heads.together(choices(p, inputs, state, slot))


def choices(p: Params, inputs: Params, state: Array, slot: Array) -> list[Array]:
    """What each choice adds to Q, (b, n, n, w_i); takes what `apply` takes."""
    xp = state.__array_namespace__()
    b = len(slot)
    whole = (state - inputs["mean"]) * inputs["scale"]
    for i in range(len(p["state"])):
        layer = p["state"][str(i)]
        whole = gelu(norm(layer["norm"], linear(layer["map"], whole)))
    slots = xp.reshape(linear(p["slots"], whole), (b, SLOTS, -1))
    some = slots[xp.arange(b)[:, None], slot]
    half = some.shape[2] // 2
    u, v = some[..., :half], some[..., half:]
    return [_RETURN * each for each in heads.added(p["heads"], u, v, u, v)]


class PaperPolicy:
    """Acts by the largest Q-value; knows nothing but the observation and which actions exist."""

    name = "paper"
    cloud_points = CLOUD_POINTS

    def __init__(self, params: Params, hands: bool = False) -> None:
        """Of a checkpoint: `network` of `init`, `inputs` of `standard`, `encoder` of the auto-encoder."""
        self._params, self._hands = params, hands
        self.settings: tuple[SettingName, ...] = ("full",) if hands else ("object-centric",)
        self._seen: tuple[np.ndarray, np.ndarray] | None = None

    @classmethod
    def from_checkpoint(cls, checkpoint: Checkpoint) -> PaperPolicy:
        """The policy of a checkpoint.

        Raises:
            InputError: it is of another kind, or of a network of other inputs.
        """
        if checkpoint.kind != KIND:
            raise InputError(f"the checkpoint holds a '{checkpoint.kind}' network where a '{KIND}' one is needed")
        rng = np.random.default_rng(0)
        try:
            network = init(rng, PaperConfig(**checkpoint.config["network"]))
        except (KeyError, TypeError):
            raise InputError("the checkpoint does not tell the sizes of its network; train again") from None
        hands = bool(checkpoint.config["network"].get("hands"))
        empty = np.zeros(size(hands), np.float32)
        own = {"network": network, "inputs": {"mean": empty, "scale": empty}, "encoder": autoencoder.init(rng)}
        found, wanted = _shapes(checkpoint.params), _shapes(own)
        differing = sorted(k for k in found.keys() | wanted.keys() if found.get(k) != wanted.get(k))
        if differing:
            k = differing[0]
            raise InputError(
                f"the checkpoint's '{k}' has shape {found.get(k)}, this program takes {wanted.get(k)}; train again"
            )
        return cls(checkpoint.params, hands)

    def values(
        self, observation: Observation, mask: Bool[np.ndarray, "P P K K ..."]
    ) -> Float32[np.ndarray, "P P K K ..."]:
        """Q of every action; -inf where the mask says that it does not exist."""
        exists = mask.reshape(*mask.shape[:4], -1)
        part, point = np.nonzero(exists.any(axis=(1, 3, 4)) | exists.any(axis=(0, 2, 4)))
        out = np.full(mask.shape, -np.inf, np.float32)
        if len(part):
            state = np.zeros((1, size(self._hands)), np.float32)
            self._state(observation).write(state[0])
            slot = (MAX_POINTS * part + point)[None]
            q = apply(self._params["network"], self._params["inputs"], state, slot)[0]
            u, v = part[:, None], part[None]
            out[u, v, point[:, None], point[None]] = q.reshape(*q.shape[:2], *mask.shape[4:])
        return np.where(mask, out, np.float32(-np.inf))

    def act(self, observation: Observation, mask: Bool[np.ndarray, "P P K K ..."]) -> Int[np.ndarray, "_"]:
        """The action that is worth most.

        Raises:
            InputError: no action exists.
        """
        if not mask.any():
            raise InputError("no action exists; the episode is over")
        q = self.values(observation, mask)
        return np.array(np.unravel_index(int(np.argmax(q)), q.shape))

    def _state(self, observation: Observation) -> PaperState:
        shapes = observation["shapes"]
        parts = int(np.flatnonzero(shapes.any(axis=(1, 2)))[-1]) + 1
        if parts > MAX_PARTS:
            raise InputError(f"the furniture has {parts} parts; preset '{KIND}' takes at most {MAX_PARTS}")
        # Parts stay what they are while they are put together; encoding is most of the work.
        if self._seen is None or not np.array_equal(self._seen[0], shapes):
            self._seen = shapes.copy(), autoencoder.encode(self._params["encoder"], shapes[:parts])
        return PaperState(
            self._seen[1],
            observation["connection_points"][:parts],
            observation["poses"][:parts],
            observation["connections"][:parts, :parts],
            observation["grasp_regions"][:parts].reshape(parts, GRASPS, 6) if self._hands else None,
        )


def _shapes(params: Params, above: str = "") -> dict[str, tuple[int, ...]]:
    """Of all arrays, by path."""
    out: dict[str, tuple[int, ...]] = {}
    for name, value in params.items():
        out.update(_shapes(value, f"{above}{name}/") if isinstance(value, dict) else {above + name: value.shape})
    return out
