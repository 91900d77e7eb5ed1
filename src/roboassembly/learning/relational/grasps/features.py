"""Features of two grasps at a mate: what the grippers would touch, from the clouds of the observation.

Everything is in the frame of v's part, where u's group is already mated. The direction out of the mate is the normal of
v's point for u's group and its opposite for v's group.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from roboassembly.geometry.poses import rotations_from_euler
from roboassembly.learning.relational.clearance import (
    ARM_CUTOFF,
    ARM_SECTIONS,
    CUTOFF,
    MATE_RETREATS,
    SCALE,
    NearPoints,
    PlacedGrasps,
    arm_clearance,
    gripper_shape,
    hand_clearance,
)
from roboassembly.learning.relational.policy_view import PolicyView
from roboassembly.robots.gripper import MAX_OPENING, SHORT_RETREAT
from roboassembly.task.rules.connections import GRASPS

SINGLE_FEATURES = 43
"""Number of features of one grasp at a mate."""
PAIR_FEATURES = 9
"""Number of features of two grasps at a mate."""
_POST_POINTS, _POST_STEP = 12, 0.04
"""Number of points on a post, and their distance [m]."""
_MAX_DISTANCE = 0.6
"""Distance between the tips of two grippers beyond which these cannot touch [m]."""
_REACH = 0.105
"""`nearness` up to which an arm reaches a pose of the hand: 99.8 % of 1,628 grasps that worked are nearer, and of four
that arms did not reach none is (62 generated chairs and 56 real pieces)."""
_CLOSED_MARGIN = 0.003
"""Distance by which a closed gripper is opened to test what else of its part it touches [m]."""


@dataclass(frozen=True, eq=False)
class GraspFeatures:
    """The grasps of u's part (rows) and of v's part (columns) at the mate of a point of u with a point of v.

    | index of `single` | feature | unit |
    |---|---|---|
    | 0–2 | clearance of the open gripper, last 50 mm: to its part, the rest of its group, the other group | 50 mm |
    | 3, 4 | clearance of the closed gripper to its part and the rest of its group | 50 mm |
    | 5–8 | clearance of the closed gripper to the other group, 0, 30, 100 and 200 mm out of the mate | 50 mm |
    | 9 | least of 5–8 | 50 mm |
    | 10–19 | tanh of the ten clearances above | 10 mm |
    | 20–23 | clearance of the wrist to its group, the other group mated, the same 200 mm out, the post below | 0.3 m |
    | 24–27 | the same of the forearm | 0.3 m |
    | 28, 29 | cosine of approach and of closing direction (absolute) with the direction out of the mate | |
    | 30, 31 | cosine of approach and of closing direction (absolute) with the world's up | |
    | 32, 33 | distance of the tips from the mate, and its component out of the mate | 0.5 m |
    | 34 | height of the tips above the middle of the group's bounds | 0.5 m |
    | 35 | opening of the closed gripper | 80 mm |
    | 36 | horizontal distance of the tips from the middle of the bounds | 0.5 m |
    | 37 | cosine of the approach with the horizontal direction from the middle to the tips | |
    | 38 | height of the group | m |
    | 39 | diagonal of the group's bounds | m |
    | 40 | number of points of the group's cloud | 50,000 |
    | 41 | height of the tips above the group's lowest point | m |
    | 42 | 1 if the group has more than one part | |

    | index of `pair` | feature | unit |
    |---|---|---|
    | 0, 1 | clearance of the closed, and of the approaching open gripper at u to the closed gripper at v | 50 mm |
    | 2, 3 | tanh of these clearances | 10 mm |
    | 4 | cosine between the two approaches | |
    | 5 | distance between the tips | 0.5 m |
    | 6 | component of their offset out of the mate | 0.5 m |
    | 7, 8 | components of the offset along the approach at u, and of its opposite along that at v | 0.5 m |
    """

    single: Float32[np.ndarray, "2 8 43"]
    """Features of R_a's gripper at u, and of R_b's at v."""
    pair: Float32[np.ndarray, "8 8 9"]
    """Features of both grippers together."""
    exists: Bool[np.ndarray, "8 8"]
    """Whether both grasps exist."""
    in_reach: Bool[np.ndarray, "2 8"]
    """Whether an arm reaches each grasp where its group waits, if its platform may stand anywhere."""


def grasp_features(
    view: PolicyView, u: int, k: int, v: int, l: int, groups: GraspedGroups | None = None,  # noqa: E741
) -> GraspFeatures:  # fmt: skip
    """Return the features of all grasps when point `k` of part `u` mates with point `l` of part `v`.

    Args:
        view: the state.
        u: part that moves.
        k: its point.
        v: part that waits.
        l: its point.
        groups: groups of this state and of others of the same furniture, if they are looked at more than once.
    """
    groups = GraspedGroups() if groups is None else groups
    a, b = groups(view, u), groups(view, v)
    rotation, translation = view.mating_pose(u, k, v, l)
    out, mate = view.points[v, l, 3:6], view.points[v, l, :3]
    single = np.stack(
        [
            _single_features(a, (b.whole - translation) @ rotation, out @ rotation, (mate - translation) @ rotation),
            _single_features(b, a.whole @ rotation.T + translation, -out, mate),
        ]
    )
    exists = a.grasps.exists[:, None] & b.grasps.exists[None]
    pair = _pair_features(a.grasps.moved(rotation, translation), b.grasps, out)
    in_reach = np.stack([a.in_reach, b.in_reach])
    return GraspFeatures(single.astype(np.float32), pair.astype(np.float32), exists, in_reach)


class GraspedGroups:
    """Groups of the states of one piece of furniture, each made once."""

    def __init__(self) -> None:
        self._known: dict[tuple[int, bytes, bytes, bytes], GraspedGroup] = {}

    def __len__(self) -> int:
        """Return the number of groups, each with the part at which it is grasped."""
        return len(self._known)

    def __call__(self, view: PolicyView, part: int) -> GraspedGroup:
        """Return the group of a part, grasped at this part."""
        members = np.flatnonzero(view.group == view.group[part])
        key = part, members.tobytes(), view.connections[part, members].tobytes(), view.poses[part].tobytes()
        if key not in self._known:
            self._known[key] = GraspedGroup.of(view, part, members)
        return self._known[key]


@dataclass(frozen=True, eq=False)
class GraspedGroup:
    """A group in the frame of one of its parts, and the grasps of this part."""

    grasps: PlacedGrasps
    own: Float[np.ndarray, "c 3"]
    """Cloud of the part [m]."""
    rest: Float[np.ndarray, "m 3"]
    """Cloud of the group's other parts [m]."""
    whole: Float[np.ndarray, "n 3"]
    """Cloud of the group [m]."""
    world: Float[np.ndarray, "3 3"]
    """Axes of the world as columns, as the group stands before the merge."""
    in_reach: Bool[np.ndarray, "8"]
    """Whether an arm reaches each grasp where the group waits; all where that is not known."""

    @staticmethod
    def of(view: PolicyView, part: int, members: Int[np.ndarray, "m"]) -> GraspedGroup:
        """Return the group of a part.

        Args:
            view: the state.
            part: the part.
            members: all parts of its group.
        """
        rotations, translations = view.part_from_members(part, members)
        clouds = view.clouds[members] @ rotations.transpose(0, 2, 1) + translations[:, None]
        own = clouds[members == part][0]
        return GraspedGroup(
            PlacedGrasps.place(view.grasps[part], np.eye(3), np.zeros(3), own),
            own,
            clouds[members != part].reshape(-1, 3),
            clouds.reshape(-1, 3),
            rotations_from_euler(view.poses[part, 3:]).T,
            _in_reach(view, part),
        )

    @cached_property
    def hand_clearances(self) -> tuple[Float[np.ndarray, "8"], ...]:
        """Clearances to the part and to the rest, of the approaching gripper and of the closed one [m]."""
        part, rest = self._near
        wide = self.grasps.approach_opening
        return (
            hand_clearance(part, wide, SHORT_RETREAT),
            hand_clearance(rest, wide, SHORT_RETREAT),
            hand_clearance(part, self.grasps.opening + _CLOSED_MARGIN),
            hand_clearance(rest, self.grasps.opening),
        )

    @cached_property
    def arm_clearances(self) -> tuple[tuple[Float[np.ndarray, "8"], Float[np.ndarray, "8"]], ...]:
        """Clearances of wrist and of forearm, each to the group and to the post below it [m]."""
        part, rest = self._near
        post = self.grasps.near(self._post(), reach=False)
        return tuple(
            (
                np.minimum(arm_clearance(part, GRASPS, *section), arm_clearance(rest, GRASPS, *section)),
                arm_clearance(post, GRASPS, *section),
            )
            for section in ARM_SECTIONS
        )

    @cached_property
    def places(self) -> Float[np.ndarray, "8 9"]:
        """Features 34 to 42 of `GraspFeatures.single`."""
        up = self.world[:, 2]
        low, high = self.whole.min(axis=0), self.whole.max(axis=0)
        heights = self.whole @ up
        position, approach = self.grasps.position, self.grasps.rotation[:, :, 2]
        from_middle = position - 0.5 * (low + high)
        horizontal = from_middle - np.outer(from_middle @ up, up)
        distance = np.linalg.norm(horizontal, axis=1)
        sizes = [float(np.ptp(heights)), float(np.linalg.norm(high - low)), 2e-5 * len(self.whole)]
        return np.stack(
            [
                2.0 * (from_middle @ up),
                self.grasps.opening / MAX_OPENING,
                2.0 * distance,
                np.einsum("gi,gi->g", approach, horizontal / np.maximum(distance, 1e-6)[:, None]),
                *np.full((GRASPS, 3), sizes).T,
                position @ up - heights.min(),
                np.full(GRASPS, float(len(self.rest) > 0)),
            ],
            axis=1,
        )

    @cached_property
    def _near(self) -> tuple[NearPoints, NearPoints]:
        """Points of the part and of the rest near the grippers."""
        return self.grasps.near(self.own), self.grasps.near(self.rest)

    def _post(self) -> Float[np.ndarray, "n 3"]:
        """Points of the post that carries the group, about below its middle [m]."""
        in_world = self.whole @ self.world
        middle, lowest = in_world.mean(axis=0), in_world[:, 2].min()
        points = np.tile([middle[0], middle[1], lowest], (_POST_POINTS, 1))
        points[:, 2] -= np.arange(_POST_POINTS) * _POST_STEP
        return points @ self.world.T


def _in_reach(view: PolicyView, part: int) -> Bool[np.ndarray, "8"]:
    """Return whether an arm reaches each grasp of a part where it is; all where that is not known."""
    if int(view.group[part]) in view.moved:
        return np.ones(GRASPS, bool)
    # Policies without robots load no arm.
    from roboassembly.robots.kinematics import Poses
    from roboassembly.robots.reach import nearness

    turn = rotations_from_euler(view.poses[part, 3:])
    rotations = turn @ rotations_from_euler(view.grasps[part, :, 3:])
    return nearness(Poses(rotations, view.grasps[part, :, :3] @ turn.T + view.poses[part, :3])) < _REACH


def _single_features(
    grasped: GraspedGroup, other: Float[np.ndarray, "n 3"], out: Float[np.ndarray, "3"], mate: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "8 43"]:
    """Features of each grasp of one group, in the frame of its part.

    Args:
        grasped: the group.
        other: cloud of the group that it mates with [m].
        out: direction of the group out of the mate.
        mate: position of the mated points [m].
    """
    grasps = grasped.grasps
    met = grasps.near(other)
    back = out @ grasps.rotation
    leaving = [met.shifted(-d * back) for d in MATE_RETREATS]
    own_approach, rest_approach, own_closed, rest_closed = grasped.hand_clearances
    closed = [hand_clearance(points, grasps.opening) for points in leaving]
    met_approach = hand_clearance(met, grasps.approach_opening, SHORT_RETREAT)
    clearance = np.stack(
        [own_approach, rest_approach, met_approach, own_closed, rest_closed, *closed, np.min(closed, axis=0)], axis=1
    )
    arm: list[Float[np.ndarray, "8"]] = []
    for section, (to_group, to_post) in zip(ARM_SECTIONS, grasped.arm_clearances, strict=True):
        arm += [to_group, *(arm_clearance(x, GRASPS, *section) for x in (met, leaving[-1])), to_post]
    approach, closing, up = grasps.rotation[:, :, 2], grasps.rotation[:, :, 1], grasped.world[:, 2]
    from_mate = grasps.position - mate
    features = [
        np.clip(clearance, -CUTOFF, CUTOFF) / CUTOFF,
        np.tanh(clearance / SCALE),
        np.stack(arm, axis=1) / ARM_CUTOFF,
        np.stack([approach @ out, np.abs(closing @ out), approach @ up, np.abs(closing @ up)], axis=1),
        2.0 * np.stack([np.linalg.norm(from_mate, axis=1), from_mate @ out], axis=1),
        grasped.places,
    ]
    return np.concatenate(features, axis=1)


def _pair_features(a: PlacedGrasps, b: PlacedGrasps, out: Float[np.ndarray, "3"]) -> Float[np.ndarray, "8 8 9"]:
    """Features of any grasp of u's part and any of v's."""
    offset = a.position[:, None] - b.position[None]
    distance = np.linalg.norm(offset, axis=2)
    surface, motion = _gripper_surface()
    opened = surface + b.opening[:, None, None] * motion
    surfaces = opened @ b.rotation.transpose(0, 2, 1) + b.position[:, None]
    near = a.near(surfaces.reshape(-1, 3))
    other = near.index // surfaces.shape[1]
    both = replace(near, gripper=GRASPS * near.gripper + other)
    tested = a.exists[:, None] & b.exists & (distance < _MAX_DISTANCE)
    clearance = np.stack(
        [
            hand_clearance(both, np.repeat(a.opening, GRASPS)),
            hand_clearance(both, np.repeat(a.approach_opening, GRASPS), SHORT_RETREAT),
        ]
    ).reshape(2, GRASPS, GRASPS)
    clearance = np.where(tested, clearance, CUTOFF)
    a_approach, b_approach = a.rotation[:, :, 2], b.rotation[:, :, 2]
    return np.stack(
        [
            *(np.clip(clearance, -CUTOFF, CUTOFF) / CUTOFF),
            *np.tanh(clearance / SCALE),
            a_approach @ b_approach.T,
            2.0 * distance,
            2.0 * offset @ out,
            np.einsum("abi,ai->ab", offset, a_approach) * 2.0,
            -np.einsum("abi,bi->ab", offset, b_approach) * 2.0,
        ],
        axis=-1,
    )


@cache
def _gripper_surface() -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Points on the bounding boxes of the closed gripper [m], and their motion for each metre between the pads."""
    grid = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    grid = grid[((grid == 0.0) | (grid == 1.0)).any(axis=1)]
    shape = gripper_shape()
    points = shape.low[:, None] + grid * (shape.high - shape.low)[:, None]
    return points.reshape(-1, 3), np.repeat(shape.motion, len(grid), axis=0)
