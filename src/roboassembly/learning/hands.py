"""What two hands would meet at a joint, told from clouds: the relational policy's view of `g_a` and `g_b`.

Only what the observation tells is used: clouds, the hand's pose for each grasp, and how parts lie to each other. A hand
is three boxes. What it meets is told by how far the nearest point of a cloud is outside them, or how deep inside.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Float32

from roboassembly.gripper import MAX_OPENING, RETREAT, hand_bodies
from roboassembly.learning.situation import Situation
from roboassembly.poses import rotations_from_euler
from roboassembly.task.rules import GRASPS

ONE, TWO = 28, 9
"""Numbers that describe one hand at a joint, and two together."""
_FAR = 0.05
"""Metres beyond which it does not matter how far something is from a hand."""
_NEAR = 0.01
_AROUND = 0.35
"""Metres from the finger tips within which anything of a hand can be."""
_WAY = (0.0, 0.03, 0.10, 0.20)
"""Metres out of the joint at which a hand is looked at."""
_CLOSED = 0.03
"""Metres between the pads of a hand that holds something."""


@dataclass(frozen=True, eq=False)
class Handling:
    """Two hands at a joint; rows are grasps of u's part, columns those of v's."""

    one: Float32[np.ndarray, "2 8 28"]
    """Of R_a's hand at u, and of R_b's at v."""
    two: Float32[np.ndarray, "8 8 9"]
    there: Bool[np.ndarray, "8 8"]
    """Whether both grasps exist."""


@dataclass(frozen=True, eq=False)
class _Held:
    """A group in the frame of v's part, and the hands that could hold it by one part."""

    turn: Float[np.ndarray, "8 3 3"]
    at: Float[np.ndarray, "8 3"]
    there: Bool[np.ndarray, "8"]
    rest: Float[np.ndarray, "m 3"]
    """Points of all its parts but the held one."""
    whole: Float[np.ndarray, "n 3"]
    world: Float[np.ndarray, "3 3"]
    """World directions in that frame, as columns: where the group stands now."""


def handling_of(s: Situation, u: int, k: int, v: int, l: int) -> Handling:  # noqa: E741
    """Of a pair: what every hand at `u` and every hand at `v` would meet."""
    a, b = _held(s, u, *s.mated(u, k, v, l)), _held(s, v, np.eye(3), np.zeros(3))
    way, joint = s.points[v, l, 3:6], s.points[v, l, :3]
    one = np.stack([_one(a, b, way, joint), _one(b, a, -way, joint)]).astype(np.float32)
    return Handling(one, _two(a, b, way).astype(np.float32), a.there[:, None] & b.there[None])


def _held(s: Situation, part: int, turn: np.ndarray, shift: np.ndarray) -> _Held:
    members = np.flatnonzero(s.group == s.group[part])
    rotations, positions = s.relative(part, members)
    clouds = s.clouds[members] @ rotations.transpose(0, 2, 1) + positions[:, None]
    clouds = clouds @ turn.T + shift
    poses = s.hands[part]
    hands = turn @ rotations_from_euler(poses[:, 3:])
    world = turn @ rotations_from_euler(s.poses[part, 3:]).T
    return _Held(
        hands, poses[:, :3] @ turn.T + shift, poses.any(axis=1), clouds[members != part].reshape(-1, 3),
        clouds.reshape(-1, 3), world,
    )  # fmt: skip


def _one(own: _Held, other: _Held, way: Float[np.ndarray, "3"], joint: Float[np.ndarray, "3"]) -> np.ndarray:
    """Of each hand of one group, while the other comes or waits; `way` is the one out of the joint."""
    coming, closed = _boxes(MAX_OPENING, RETREAT), _boxes(_CLOSED, 0.0)
    clear = [_clearance(own, own.rest, coming), _clearance(own, other.whole, coming)]
    clear += [_clearance(own, other.whole - out * way, closed) for out in _WAY]
    clearance = np.stack([*clear, np.minimum.reduce(clear[2:])], axis=1)
    approach, closing = own.turn[:, :, 2], own.turn[:, :, 1]
    low, high = own.whole.min(axis=0), own.whole.max(axis=0)
    middle, up = 0.5 * (low + high), own.world[:, 2]
    heights = own.whole @ up
    from_joint, from_middle = own.at - joint, own.at - middle
    level = from_middle - np.outer(from_middle @ up, up)
    outward = level / np.maximum(np.linalg.norm(level, axis=1, keepdims=True), 1e-6)
    told = [
        np.clip(clearance, -_FAR, _FAR) / _FAR,
        np.tanh(clearance / _NEAR),
        np.stack([approach @ way, np.abs(closing @ way), approach @ up, np.abs(closing @ up)], axis=1),
        2.0 * np.stack([np.linalg.norm(from_joint, axis=1), from_joint @ way, from_middle @ up], axis=1),
        2.0 * np.linalg.norm(level, axis=1)[:, None],
        np.einsum("gi,gi->g", approach, outward)[:, None],
        np.full((GRASPS, 3), [float(np.ptp(heights)), float(np.linalg.norm(high - low)), 2e-5 * len(own.whole)]),
        np.stack([own.at @ up - heights.min(), (len(own.rest) > 0) * np.ones(GRASPS)], axis=1),
    ]
    return np.concatenate(told, axis=1)


def _two(a: _Held, b: _Held, way: Float[np.ndarray, "3"]) -> np.ndarray:
    """Of two hands at the joint."""
    apart = a.at[:, None] - b.at[None]
    distance = np.linalg.norm(apart, axis=2)
    surface = _surface(_CLOSED)
    clear = np.zeros((2, GRASPS, GRASPS))
    for g in range(GRASPS):
        skin = surface @ b.turn[g].T + b.at[g]
        clear[0, :, g] = _clearance(a, skin, _boxes(_CLOSED, 0.0))
        clear[1, :, g] = _clearance(a, skin, _boxes(MAX_OPENING, RETREAT))
    of_a, of_b = a.turn[:, :, 2], b.turn[:, :, 2]
    return np.stack(
        [
            *(np.clip(clear, -_FAR, _FAR) / _FAR),
            *np.tanh(clear / _NEAR),
            of_a @ of_b.T,
            2.0 * distance,
            2.0 * apart @ way,
            np.einsum("abi,ai->ab", apart, of_a) * 2.0,
            -np.einsum("abi,bi->ab", apart, of_b) * 2.0,
        ],
        axis=-1,
    )


def _clearance(held: _Held, points: Float[np.ndarray, "n 3"], boxes: Float[np.ndarray, "3 2 3"]) -> np.ndarray:
    """For each hand, metres from its boxes to the nearest point, negative inside; `_FAR` at most."""
    out = np.full(GRASPS, _FAR)
    for g in np.flatnonzero(held.there):
        near = points[((points - held.at[g]) ** 2).sum(axis=1) < _AROUND**2]
        if len(near):
            local = (near - held.at[g]) @ held.turn[g]
            beyond = np.maximum(boxes[:, None, 0] - local, local - boxes[:, None, 1]).max(axis=2)
            out[g] = min(_FAR, beyond.min())
    return out


@cache
def _boxes(opening: float, back: float) -> Float[np.ndarray, "3 2 3"]:
    """Lower and upper corners of palm and fingers in the tips' frame, swept from `back` metres behind."""
    out = []
    for mesh, pose in hand_bodies(opening):
        points = mesh.vertices @ pose.rotation.T + pose.translation
        out.append([points.min(axis=0) - [0.0, 0.0, back], points.max(axis=0)])
    return np.array(out)


@cache
def _surface(opening: float) -> Float[np.ndarray, "n 3"]:
    """Points on the boxes of a hand."""
    grid = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    grid = grid[((grid == 0.0) | (grid == 1.0)).any(axis=1)]
    return np.concatenate([low + grid * (high - low) for low, high in _boxes(opening, 0.0)])
