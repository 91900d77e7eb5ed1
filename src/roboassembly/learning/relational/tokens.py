"""What the relational policy looks at: free connection points as tokens, and how any two of them would mate.

Everything is computed from the observation (clouds, points, connections) and the mask of existing actions, nothing
from the furniture itself. Absolute poses do not matter to what fits what and are left out, so the policy is exactly
indifferent to where the parts lie and how they are numbered.

A part's frame is parallel to the furniture's, as in the paper (equal parts share the frame of the first of them);
this is what tells a policy which way the furniture stands.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Float16, Float32, Int, UInt8
from scipy.spatial import KDTree

from roboassembly.geometry.poses import rotations_from_euler
from roboassembly.learning.mating import mating_rotations
from roboassembly.learning.relational.clearance import HOLD, MET, ROOM, Grasps
from roboassembly.learning.relational.cycles import closing_bridges, closing_groups
from roboassembly.learning.relational.features import possible, same_way, turns
from roboassembly.learning.relational.policy_view import MEET, OPPOSED, Situation, frames_of
from roboassembly.task.rules.connections import GRASPS

GRID_STEPS = (0.010, 0.040, 0.150)
"""Metres between the grid points at which a group's surface around a point is probed: joint, part, furniture."""
GRID = np.stack(np.meshgrid(*[np.arange(-2.0, 3.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
"""Five a side, in steps, in the connection point's frame."""
PATCH = len(GRID_STEPS) * len(GRID)
T = TypeVar("T")
POINT = 21
"""Numbers that describe a point."""
_SPREAD = 160
"""Points of a group's cloud by which its extent after mating is told."""
_NEAR, _AROUND = 0.012, 0.040
"""Metres: points that ought to coincide, and that lie in each other's way."""


@dataclass(frozen=True, eq=False)
class Tokens:
    """Free connection points of one state. `n` of them; rows of pairs move onto columns."""

    part: Int[np.ndarray, "n"]
    point: Int[np.ndarray, "n"]
    group: Int[np.ndarray, "n"]
    """0, 1, ... by first appearance."""
    patch: UInt8[np.ndarray, "n 375"]
    """Distance from each grid point to the surface of the token's group, over 1.5 steps, times 255."""
    own: Float32[np.ndarray, "n 21"]
    """Sizes, directions, how many parts are alike; the first tells the group's size, the last whether its frame is
    surely parallel to the furniture's, 1 or 0."""
    frame: Float32[np.ndarray, "n 3 3"]
    """`group_from_point` rotation; a group's frame is that of its most singular part."""
    position: Float32[np.ndarray, "n 3"]
    """In the group's frame, metres."""
    extent: Float32[np.ndarray, "n 3"]
    """Of the token's group, metres."""
    meet: UInt8[np.ndarray, "n n 4"]
    """Other free points of the two groups that would meet if the pair did, those that would with tangents aligned too,
    those that would miss each other a little, and those that would come close."""
    beside: Float32[np.ndarray, "n n 6"]
    """How much higher the moving group's lower bounds would be than the waiting one's, and its upper bounds, metres."""
    loops: UInt8[np.ndarray, "n n"]
    """Of `closing_groups`."""
    bridges: UInt8[np.ndarray, "n n"]
    """Of `closing_bridges`."""
    hold: Float16[np.ndarray, "n 8 16"] | None = None
    """Of `room.Grasps.seen_from`: the hands at the token's part; None where nobody asks for hands."""
    room: Float16[np.ndarray, "n n 4"] | None = None
    """Of `room.Grasps.room`: what the row's hands would have at the joint; None likewise."""


class Memory:
    """What was computed about groups and pairs of groups: from one state to the next most of them stay the same.

    Args:
        most: entries; all are forgotten when there are more.
    """

    def __init__(self, most: int = 4096) -> None:
        self._most = most
        self._known: dict[bytes, Any] = {}

    def get(self, key: bytes, compute: Callable[[], T]) -> T:
        """What `compute` gives, or gave for this key before."""
        if key not in self._known:
            if len(self._known) >= self._most:
                self._known.clear()
            self._known[key] = compute()
        return self._known[key]


@dataclass(frozen=True, eq=False)
class _GroupView:
    """One group in the frame of its most singular part, with its free points."""

    key: bytes
    """Of all that it consists of."""
    at: Float[np.ndarray, "k 3"]
    frame: Float[np.ndarray, "k 3 3"]
    patch: UInt8[np.ndarray, "k 375"]
    some: Float[np.ndarray, "s 3"]
    """Points of the cloud, at most `_SPREAD`."""
    held: _Held | None
    """None where nobody asks for hands."""

    @staticmethod
    def of(
        key: bytes, clouds: Float[np.ndarray, "p c 3"], turn: np.ndarray, shift: np.ndarray, at: np.ndarray,
        frame: np.ndarray, member: np.ndarray | None = None, hands: np.ndarray | None = None,
    ) -> _GroupView:  # fmt: skip
        """Put together from its parts, each with its pose; with the part of each point among them, and the hands at
        each part, for those who ask for hands."""
        placed = clouds @ turn.transpose(0, 2, 1) + shift[:, None]
        cloud = placed.reshape(-1, 3)
        held = None
        if member is not None and hands is not None:
            of_part = {
                i: Grasps(hands[i], placed[i], np.delete(placed, i, axis=0).reshape(-1, 3), turn[i], shift[i])
                for i in np.unique(member).tolist()
            }
            grasps = tuple(of_part[i] for i in member.tolist())
            hold = np.stack([g.seen_from(*point) for g, *point in zip(grasps, at, frame, strict=True)])
            held = _Held(grasps, hold, _thinned(cloud, MET))
        return _GroupView(key, at, frame, _patches(cloud, at, frame), _thinned(cloud, _SPREAD), held)


@dataclass(frozen=True, eq=False)
class _Held:
    """Hands at a group."""

    grasps: tuple[Grasps, ...]
    """At the part of each point."""
    hold: Float16[np.ndarray, "k 8 16"]
    """The same as seen from the point."""
    some: Float[np.ndarray, "m 3"]
    """Points of the cloud that another group's hands may meet."""


def _thinned(points: Float[np.ndarray, "n 3"], most: int) -> Float[np.ndarray, "m 3"]:
    """At most so many of them, evenly."""
    return points[:: -(-len(points) // most)]


def tokens_of(situation: Situation, memory: Memory | None = None, hands: bool = False) -> Tokens:
    """Tokens of what is there; a memory saves time from state to state. With `hands`, what room there is for them."""
    clouds, points, group = situation.clouds, situation.points, situation.group
    connections, free = situation.connections, situation.free
    memory = memory or Memory()
    part, point = np.nonzero(free)
    shapes = [hashlib.blake2b(cloud.tobytes(), digest_size=16).digest() for cloud in clouds]
    count = Counter(shapes)
    alike = np.array([count[shape] for shape in shapes])
    sides = np.array(
        [memory.get(shape, partial(np.ptp, cloud, axis=0)) for shape, cloud in zip(shapes, clouds, strict=True)]
    )
    turn, shift, upright = _into_group_frames(sides, connections, group, alike)
    position = points[part, point, :3]
    normal, tangent = points[part, point, 3:6], points[part, point, 6:9]
    frame = frames_of(points[part, point])
    in_group = turn[part] @ frame
    at = np.einsum("nij,nj->ni", turn[part], position) + shift[part]
    names, token_group = np.unique(group[part], return_inverse=True)
    size = np.zeros(len(part))
    groups = [np.flatnonzero(token_group == index) for index in range(len(names))]
    views: list[_GroupView] = []
    for name, tokens in zip(names, groups, strict=True):
        members = np.flatnonzero(group == name)
        arrays = [turn[members], shift[members], at[tokens], in_group[tokens]]
        if hands:
            arrays += [np.searchsorted(members, part[tokens]), situation.hands[members]]
        key = hashlib.blake2b(b"".join([*(shapes[i] for i in members), *(a.tobytes() for a in arrays)])).digest()
        views.append(memory.get(key, partial(_GroupView.of, key, clouds[members], *arrays)))
        size[tokens] = len(members)
    own = np.zeros((len(part), POINT), np.float32)
    own[:, 2:5] = -2.0 * np.einsum("nji,nj->ni", frame, position)
    own[:, 5:8] = 2.0 * sides[part]
    own[:, 8:11] = 2.0 * position
    own[:, 11:14], own[:, 14:17] = normal, tangent
    own[:, 17], own[:, 18] = alike[part] / 4.0, alike[part] == 1
    own[:, 19], own[:, 20] = np.bincount(part, minlength=len(clouds))[part] / 5.0, upright[part]
    patch, extent = np.zeros((len(part), PATCH), np.uint8), np.zeros((len(part), 3), np.float32)
    own[:, 0] = size / 5.0
    for view, tokens in zip(views, groups, strict=True):
        own[tokens, 1] = len(tokens) / 10.0
        patch[tokens], extent[tokens] = view.patch, np.ptp(view.some, axis=0)
    meet, beside = _pairs(views, groups, memory)
    parallel = same_way(turns(in_group[None])[0])
    can = possible(parallel, upright[part], token_group[:, None] != token_group)
    loops = np.minimum(closing_groups(groups, at, in_group, can), 255)
    bridges = np.minimum(closing_bridges(groups, at, in_group, can), 255)
    hold, room = _hands(views, groups, memory) if hands else (None, None)
    return Tokens(
        part, point, token_group, patch, own, in_group.astype(np.float32), at.astype(np.float32), extent, meet, beside,
        loops.astype(np.uint8), bridges.astype(np.uint8), hold, room,
    )  # fmt: skip


def _into_group_frames(
    sides: Float[np.ndarray, "P 3"],
    connections: Float[np.ndarray, "P P 6"],
    group: Int[np.ndarray, "P"],
    alike: Int[np.ndarray, "P"],
) -> tuple[Float[np.ndarray, "P 3 3"], Float[np.ndarray, "P 3"], Bool[np.ndarray, "P"]]:
    """`group_from_part`, and whether the group's frame is surely parallel to the furniture's.

    The reference is the part with the fewest like it, then the largest: most surely upright.
    """
    upright = np.zeros(len(group), bool)
    turn, shift = np.tile(np.eye(3), (len(group), 1, 1)), np.zeros((len(group), 3))
    extent = sides.max(axis=1)
    for name in np.unique(group):
        members = np.flatnonzero(group == name)
        reference = members[np.lexsort((members, -extent[members], alike[members]))[0]]
        rest = members[members != reference]
        turn[rest] = rotations_from_euler(connections[reference, rest, 3:])
        shift[rest] = connections[reference, rest, :3]
        upright[members] = alike[reference] == 1
    return turn, shift, upright


def _patches(
    cloud: Float[np.ndarray, "c 3"], at: Float[np.ndarray, "k 3"], frame: Float[np.ndarray, "k 3 3"]
) -> UInt8[np.ndarray, "k 375"]:
    """Distances from each point's grids to the cloud."""
    tree = KDTree(cloud)
    out = []
    for step in GRID_STEPS:
        queries = at[:, None] + np.einsum("nij,qj->nqi", frame, GRID * step)
        distance, _ = tree.query(queries.reshape(-1, 3), distance_upper_bound=1.5 * step)
        out.append(np.minimum(distance / (1.5 * step), 1.0).reshape(len(at), -1))
    return (255.0 * np.concatenate(out, axis=1)).astype(np.uint8)


def _pairs(
    views: list[_GroupView], groups: list[Int[np.ndarray, "k"]], memory: Memory
) -> tuple[UInt8[np.ndarray, "n n 4"], Float32[np.ndarray, "n n 6"]]:
    """What would come of mating any two points of different groups: `meet` and `beside`."""
    n = sum(map(len, groups))
    meet, beside = np.zeros((n, n, 4), np.uint8), np.zeros((n, n, 6), np.float32)
    for moving, waiting, told in _between(views, groups, memory, b"", _pairs_of):
        meet[np.ix_(moving, waiting)], beside[np.ix_(moving, waiting)] = told
    return meet, beside


def _hands(
    views: list[_GroupView], groups: list[Int[np.ndarray, "k"]], memory: Memory
) -> tuple[Float16[np.ndarray, "n 8 16"], Float16[np.ndarray, "n n 4"]]:
    """What is told of hands: `hold` and `room`."""
    n = sum(map(len, groups))
    hold, room = np.zeros((n, GRASPS, HOLD), np.float16), np.zeros((n, n, ROOM), np.float16)
    for view, tokens in zip(views, groups, strict=True):
        assert view.held is not None
        hold[tokens] = view.held.hold
    for moving, waiting, told in _between(views, groups, memory, b"room", _room_of):
        room[np.ix_(moving, waiting)] = told
    return hold, room


def _between(
    views: list[_GroupView], groups: list[Int[np.ndarray, "k"]], memory: Memory, name: bytes,
    tell: Callable[[_GroupView, _GroupView], T],
) -> Iterator[tuple[Int[np.ndarray, "k"], Int[np.ndarray, "l"], T]]:  # fmt: skip
    """Tokens of each two groups, and what is told of these; `name` is that of what is told."""
    for first, moving in zip(views, groups, strict=True):
        for second, waiting in zip(views, groups, strict=True):
            if moving is not waiting:
                yield moving, waiting, memory.get(first.key + second.key + name, partial(tell, first, second))


def _pairs_of(first: _GroupView, second: _GroupView) -> tuple[UInt8[np.ndarray, "k l 4"], Float[np.ndarray, "k l 6"]]:
    """For a moving and a waiting group."""
    turn, shift = _mated(first, second)
    return _meetings(turn, shift, first, second), _beside(turn, shift, first, second)


def _mated(first: _GroupView, second: _GroupView) -> tuple[Float[np.ndarray, "k l 3 3"], Float[np.ndarray, "k l 3"]]:
    """`second_from_first`, were each two points joined."""
    turn = mating_rotations(first.frame, second.frame)
    return turn, second.at[None] - (turn @ first.at[:, None, :, None])[..., 0]


def _room_of(first: _GroupView, second: _GroupView) -> Float16[np.ndarray, "k l 4"]:
    """What room the hands of a moving group have at a waiting one, where each two points meet."""
    assert first.held is not None
    assert second.held is not None
    turn, shift = _mated(first, second)
    joints = zip(first.held.grasps, turn, shift, strict=True)
    return np.stack([grasps.room(turned, shifted, second.held.some) for grasps, turned, shifted in joints])


def _meetings(turn: np.ndarray, shift: np.ndarray, first: _GroupView, second: _GroupView) -> UInt8[np.ndarray, "k l 4"]:
    """How many other free points of the two groups would meet, miss each other a little, or come close."""
    # (k, l, m, 3): tokens of the moving group, and their normals and tangents, where the pair would bring them.
    back = turn.transpose(0, 1, 3, 2)
    at, frame = second.at, second.frame
    there = first.at @ back + shift[:, :, None]
    apart = np.sqrt(np.maximum(_squares(there)[..., None] + _squares(at) - 2.0 * (there @ at.T), 0.0))
    opposed = (first.frame[:, :, 2] @ back) @ frame[:, :, 2].T < OPPOSED
    along = (first.frame[:, :, 0] @ back) @ frame[:, :, 0].T > -OPPOSED
    hit = (apart < MEET) & opposed
    near = (apart < _NEAR) & ~hit
    around = (apart < _AROUND) & ~hit
    counts = [np.any(x, axis=3).sum(axis=2) for x in (hit, hit & along, near, around)]
    # The pair itself meets, too.
    return np.maximum(np.stack(counts, axis=-1) - np.array([1, 1, 0, 0]), 0).astype(np.uint8)


def _squares(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
    return (vectors * vectors).sum(axis=-1)


def _beside(turn: np.ndarray, shift: np.ndarray, first: _GroupView, second: _GroupView) -> Float[np.ndarray, "k l 6"]:
    """The moving group's bounds beside the waiting one's."""
    there = (turn.reshape(-1, 3) @ first.some.T).reshape(*shift.shape, -1)
    low, high = there.min(axis=3) + shift, there.max(axis=3) + shift
    return np.concatenate([low - second.some.min(axis=0), high - second.some.max(axis=0)], axis=-1)
