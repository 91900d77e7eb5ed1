"""What two hands would meet at a joint, told from clouds: the relational policy's view of `g_a` and `g_b`.

Only what the observation tells is used: clouds, the hand's pose for each grasp, and how parts lie to each other. A hand
is three convex bodies. What it meets is told by how far the nearest point of a cloud is outside them, or how deep
inside; how far it is open, by the points of the held part between its pads.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Float32
from scipy.spatial import ConvexHull

from roboassembly.geometry.poses import rotations_from_euler
from roboassembly.learning.relational.policy_view import Situation
from roboassembly.robots.gripper import MAX_OPENING, RETREAT, hand_bodies
from roboassembly.task.full.cell import WIDER
from roboassembly.task.rules.connections import GRASPS

ONE, TWO = 43, 9
"""Numbers that describe one hand at a joint, and two together."""
FAR = 0.05
"""Metres beyond which it does not matter how far something is from a hand."""
NEAR = 0.01
"""Metres within which it matters by how much."""
ARM_STRETCHES, ARM_FAR = ((0.13, 0.30), (0.30, 0.50)), 0.3
"""Metres from the tips to where wrist and forearm begin and end; and from these to what does not matter to them."""
_POST = 12
"""Points of a post that are looked at."""
_APART = 0.6
"""Metres between the tips of two hands beyond which they do not meet."""
_WAY = (0.0, 0.03, 0.10, 0.20)
"""Metres out of the joint at which a hand is looked at."""
_CLOSED = 0.03
"""Metres between the pads of a hand that holds something of which there is no point between them."""
_LOOSE = 0.003
"""Metres by which a closed hand is opened to tell what else of its part it meets."""
_PAD = 0.011
"""Metres from its middle to the rims of a pad."""


@dataclass(frozen=True, eq=False)
class Handling:
    """Two hands at a joint; rows are grasps of u's part, columns those of v's."""

    one: Float32[np.ndarray, "2 8 43"]
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
    width: Float[np.ndarray, "8"]
    """Metres between the pads, as far as the cloud tells."""
    own: Float[np.ndarray, "c 3"]
    """Points of the held part."""
    rest: Float[np.ndarray, "m 3"]
    """Points of all its parts but the held one."""
    whole: Float[np.ndarray, "n 3"]
    world: Float[np.ndarray, "3 3"]
    """World directions in that frame, as columns: where the group stands now."""

    def post(self) -> Float[np.ndarray, "n 3"]:
        """Points of the post that holds the group, about below its middle."""
        at = self.whole @ self.world
        middle, lowest = at.mean(axis=0), at[:, 2].min()
        down = np.tile([middle[0], middle[1], lowest], (_POST, 1))
        down[:, 2] -= np.arange(_POST) * 0.04
        return down @ self.world.T


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
    at, own = poses[:, :3] @ turn.T + shift, clouds[members == part][0]
    return _Held(
        hands, at, poses.any(axis=1), widths(hands, at, own), own, clouds[members != part].reshape(-1, 3),
        clouds.reshape(-1, 3), world,
    )  # fmt: skip


def widths(turn: np.ndarray, at: np.ndarray, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "8"]:
    """Metres between the pads of each hand, by the points that are between them."""
    local = np.einsum("gnj,gji->gni", points - at[:, None], turn)
    between = (np.abs(local[..., 0]) < _PAD) & (np.abs(local[..., 2]) < _PAD)
    across = np.where(between & (np.abs(local[..., 1]) < 0.5 * MAX_OPENING + _LOOSE), np.abs(local[..., 1]), 0.0)
    width = 2.0 * across.max(axis=1)
    return np.where(width > 0.0, width, _CLOSED)


def _one(own: _Held, other: _Held, way: Float[np.ndarray, "3"], joint: Float[np.ndarray, "3"]) -> np.ndarray:
    """Of each hand of one group, while the other comes or waits; `way` is the one out of the joint."""
    wide = np.minimum(MAX_OPENING, own.width + WIDER)
    clear, arm = np.full((GRASPS, 9), FAR), np.full((GRASPS, 8), ARM_FAR)
    post = own.post()
    for g in np.flatnonzero(own.there).tolist():
        held, rest, met = (around(own.turn[g], own.at[g], points) for points in (own.own, own.rest, other.whole))
        clear[g, :3] = [clearance(points, wide[g], RETREAT) for points in (held, rest, met)]
        clear[g, 3:5] = clearance(held, own.width[g] + _LOOSE), clearance(rest, own.width[g])
        clear[g, 5:] = [clearance(met - out * (way @ own.turn[g])[:, None], own.width[g]) for out in _WAY]
        whole = np.concatenate([held, rest], axis=1)
        away = met - _WAY[-1] * (way @ own.turn[g])[:, None]
        below = own.turn[g].T @ (post - own.at[g]).T
        arm[g] = [from_arm(points, *stretch) for stretch in ARM_STRETCHES for points in (whole, met, away, below)]
    room = np.concatenate([clear, clear[:, 5:].min(axis=1, keepdims=True)], axis=1)
    approach, closing = own.turn[:, :, 2], own.turn[:, :, 1]
    low, high = own.whole.min(axis=0), own.whole.max(axis=0)
    middle, size, up = 0.5 * (low + high), float(np.linalg.norm(high - low)), own.world[:, 2]
    heights = own.whole @ up
    from_joint, from_middle = own.at - joint, own.at - middle
    level = from_middle - np.outer(from_middle @ up, up)
    outward = level / np.maximum(np.linalg.norm(level, axis=1, keepdims=True), 1e-6)
    told = [
        np.clip(room, -FAR, FAR) / FAR,
        np.tanh(room / NEAR),
        arm / ARM_FAR,
        np.stack([approach @ way, np.abs(closing @ way), approach @ up, np.abs(closing @ up)], axis=1),
        2.0 * np.stack([np.linalg.norm(from_joint, axis=1), from_joint @ way, from_middle @ up], axis=1),
        own.width[:, None] / MAX_OPENING,
        2.0 * np.linalg.norm(level, axis=1)[:, None],
        np.einsum("gi,gi->g", approach, outward)[:, None],
        np.full((GRASPS, 3), [float(np.ptp(heights)), size, 2e-5 * len(own.whole)]),
        np.stack([own.at @ up - heights.min(), (len(own.rest) > 0) * np.ones(GRASPS)], axis=1),
    ]  # fmt: skip
    return np.concatenate(told, axis=1)


def _two(a: _Held, b: _Held, way: Float[np.ndarray, "3"]) -> np.ndarray:
    """Of two hands at the joint."""
    apart = a.at[:, None] - b.at[None]
    distance = np.linalg.norm(apart, axis=2)
    surface, opens = _surface()
    skins = (surface + b.width[:, None, None] * opens) @ b.turn.transpose(0, 2, 1) + b.at[:, None]
    wide = np.minimum(MAX_OPENING, a.width + WIDER)
    clear = np.full((2, GRASPS, GRASPS), FAR)
    for g in np.flatnonzero(a.there).tolist():
        for h in np.flatnonzero(b.there & (distance[g] < _APART)).tolist():
            near = around(a.turn[g], a.at[g], skins[h])
            clear[:, g, h] = clearance(near, a.width[g]), clearance(near, wide[g], RETREAT)
    of_a, of_b = a.turn[:, :, 2], b.turn[:, :, 2]
    return np.stack(
        [
            *(np.clip(clear, -FAR, FAR) / FAR),
            *np.tanh(clear / NEAR),
            of_a @ of_b.T,
            2.0 * distance,
            2.0 * apart @ way,
            np.einsum("abi,ai->ab", apart, of_a) * 2.0,
            -np.einsum("abi,bi->ab", apart, of_b) * 2.0,
        ],
        axis=-1,
    )


def around(
    turn: Float[np.ndarray, "3 3"], at: Float[np.ndarray, "3"], points: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "3 m"]:
    """In the frame of a hand's tips, whose pose is given, the points that it could meet: as it comes, and a way out of
    the joint."""
    local = turn.T @ (points - at).T
    low, high = _reach()
    return local[:, ((local > low[:, None]) & (local < high[:, None])).all(axis=0)]


def from_arm(points: Float[np.ndarray, "3 n"], near: float, far: float) -> float:
    """Metres from the line behind a hand, between two distances from its tips, to the nearest of some points in their
    frame: where the arm will be."""
    beside = points.copy()
    beside[2] -= np.clip(points[2], -far, -near)
    return float(np.sqrt((beside**2).sum(axis=0).min(initial=ARM_FAR**2)))


def clearance(points: Float[np.ndarray, "3 n"], opening: float, back: float = 0.0) -> float:
    """Metres from a hand to the nearest of some points in the frame of its tips, negative inside; `FAR` at most.

    Args:
        points: of `around`.
        opening: metres between the pads.
        back: metres from behind which the hand comes; its whole way counts.
    """
    bodies = _bodies(back)
    opened = opening * bodies.opens
    middle, half = 0.5 * (bodies.low + bodies.high) + opened, 0.5 * (bodies.high - bodies.low)
    beside = np.abs(points - middle[..., None]) - half[..., None]
    out = np.maximum(np.maximum(beside[:, 0], beside[:, 1]), beside[:, 2])
    nearest = float(out.min(initial=FAR))
    if nearest >= NEAR:
        return nearest
    # Boxes tell what is near, the bodies' faces how near.
    close = out < NEAR
    beyond = [
        (normals @ (points[:, close[i]] - opened[i][:, None]) - offsets).max(axis=0).min(initial=FAR)
        for i, (normals, offsets) in enumerate(bodies.faces)
        if close[i].any()
    ]
    return float(min(beyond))


@dataclass(frozen=True, eq=False)
class _Bodies:
    """Palm and fingers of the closed hand, all convex, in the tips' frame."""

    low: Float[np.ndarray, "3 3"]
    """Corners of their boxes."""
    high: Float[np.ndarray, "3 3"]
    faces: tuple[tuple[Float[np.ndarray, "f 3"], Float[np.ndarray, "f 1"]], ...]
    """Normals of their faces, and how far these are from the origin."""
    opens: Float[np.ndarray, "3 3"]
    """How far each moves for each metre between the pads."""


@cache
def _bodies(back: float) -> _Bodies:
    """The hand, swept from `back` metres behind."""
    corners, faces, opens = [], [], []
    for (mesh, shut), (_, open_) in zip(hand_bodies(0.0), hand_bodies(1.0), strict=True):
        points = mesh.vertices @ shut.rotation.T + shut.translation
        hull = ConvexHull(np.concatenate([points, points - [0.0, 0.0, back]]))
        planes = np.unique(hull.equations.round(9), axis=0)
        corners.append((hull.min_bound, hull.max_bound))
        faces.append((planes[:, :3], -planes[:, 3:]))
        opens.append(open_.translation - shut.translation)
    low, high = np.array(corners).transpose(1, 0, 2)
    return _Bodies(low, high, tuple(faces), np.array(opens))


def boxes() -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]]:
    """Corners of the boxes around palm and fingers of the closed hand, in the frame of its tips, and how far each moves
    for each metre between the pads."""
    bodies = _bodies(0.0)
    return bodies.low, bodies.high, bodies.opens


@cache
def _reach() -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Corners of a box around all that a hand can meet, in the frame of its tips."""
    bodies, more = _bodies(RETREAT), FAR + _WAY[-1]
    more += 0.5 * MAX_OPENING
    return bodies.low.min(axis=0) - more, bodies.high.max(axis=0) + more


@cache
def _surface() -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Points on the boxes of a closed hand, and how far each moves for each metre between the pads."""
    grid = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    grid = grid[((grid == 0.0) | (grid == 1.0)).any(axis=1)]
    hand = _bodies(0.0)
    points = hand.low[:, None] + grid * (hand.high - hand.low)[:, None]
    return points.reshape(-1, 3), np.repeat(hand.opens, len(grid), axis=0)
