"""What is there to be joined, as a policy sees it; and what would be left after a merge, in its imagination."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from roboassembly.geometry.poses import euler_from_rotations, rotations_from_euler
from roboassembly.learning.datasets import group_labels
from roboassembly.learning.mating import FLIP
from roboassembly.task.rules.connections import UP_AXES

MEET, OPPOSED = 0.004, -0.99
"""Metres, and cosine of two normals: points that would touch."""


@dataclass(frozen=True, eq=False)
class Situation:
    """P parts with K points each, arrays as in `envs.observation`."""

    clouds: Float[np.ndarray, "P C 3"]
    points: Float[np.ndarray, "P K 9"]
    connections: Float[np.ndarray, "P P 6"]
    free: Bool[np.ndarray, "P K"]
    group: Int[np.ndarray, "P"]
    """Of each part, named by its first part."""
    hands: Float[np.ndarray, "P 8 6"]
    """Of each grasp, in the part's frame; 0 where there is none, or nobody asks."""
    poses: Float[np.ndarray, "P 6"]
    """Of parts in the world."""

    @staticmethod
    def of(observation: dict[str, np.ndarray], mask: Bool[np.ndarray, "P P K K ..."]) -> Situation:
        """Of an observation and the mask of existing actions."""
        connections = observation["connections"].astype(float)
        return Situation(
            observation["shapes"].astype(float),
            observation["connection_points"].astype(float),
            connections,
            np.asarray(mask.reshape(*mask.shape[:4], -1).any(axis=(1, 3, 4))),  # of u and k; the mask is symmetric
            group_labels(connections),
            observation["grasp_regions"].reshape(len(connections), -1, 6).astype(float),
            observation["poses"].astype(float),
        )

    @property
    def actions(self) -> tuple[int, int, int, int, int]:
        """Shape of the mask of actions `(u, v, k, l, w)`."""
        parts, points = self.free.shape
        return parts, parts, points, points, len(UP_AXES)

    @property
    def joined(self) -> bool:
        """Whether all parts are one group; rows that only fill the arrays up are none."""
        return len(np.unique(self.group[self.points.any(axis=(1, 2))])) < 2

    def after(self, u: int, k: int, v: int, l: int) -> Situation:  # noqa: E741
        """What would be left if point `k` of part `u` met point `l` of part `v`: their groups one, and their points
        that then touch no longer free. Gaps at joints are neglected."""
        movers, waiting = np.flatnonzero(self.group == self.group[u]), np.flatnonzero(self.group == self.group[v])
        turn, shift = self.mated(u, k, v, l)
        (moved, shifted), (waited, where) = self.relative(u, movers), self.relative(v, waiting)
        turns = np.concatenate([turn @ moved, waited])
        shifts = np.concatenate([shifted @ turn.T + shift, where])
        members = np.concatenate([movers, waiting])
        back = turns.transpose(0, 2, 1)
        relative = back[:, None] @ turns[None]
        apart = (back[:, None] @ (shifts[None] - shifts[:, None])[..., None])[..., 0]
        poses = np.concatenate([apart, euler_from_rotations(relative.reshape(-1, 3, 3)).reshape(apart.shape)], axis=-1)
        poses[np.arange(len(members)), np.arange(len(members))] = 0.0
        connections, free, group = self.connections.copy(), self.free.copy(), self.group.copy()
        connections[np.ix_(members, members)] = poses
        group[members] = members.min()
        # Points of the members in v's frame: which of the one group touch any of the other?
        ends, points = np.nonzero(free[members])
        at = np.einsum("nij,nj->ni", turns[ends], self.points[members[ends], points, :3]) + shifts[ends]
        out = np.einsum("nij,nj->ni", turns[ends], self.points[members[ends], points, 3:6])
        near = np.linalg.norm(at[:, None] - at[None], axis=2) < MEET
        moves = ends < len(movers)
        touch = near & (out @ out.T < OPPOSED) & (moves[:, None] != moves[None])
        taken = touch.any(axis=1)
        free[members[ends[taken]], points[taken]] = False
        free[u, k] = free[v, l] = False
        return replace(self, connections=connections, free=free, group=group)

    def mated(self, u: int, k: int, v: int, l: int) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:  # noqa: E741
        """`v_from_u`, parts, if point `k` of part `u` met point `l` of part `v`; gaps are neglected."""
        turn = (frames_of(self.points[v, l]) * FLIP) @ frames_of(self.points[u, k]).T
        return turn, self.points[v, l, :3] - turn @ self.points[u, k, :3]

    def relative(
        self, part: int, members: Int[np.ndarray, "m"]
    ) -> tuple[Float[np.ndarray, "m 3 3"], Float[np.ndarray, "m 3"]]:
        """`part_from_member`; connections say nothing of a part and itself."""
        poses = self.connections[part, members]
        return rotations_from_euler(poses[:, 3:]), poses[:, :3]


def frames_of(points: Float[np.ndarray, "*n 9"]) -> Float[np.ndarray, "*n 3 3"]:
    """`part_from_point` rotations."""
    normal, tangent = points[..., 3:6], points[..., 6:9]
    return np.stack([tangent, np.cross(normal, tangent), normal], axis=-1)
