"""The view that a policy has of a state, and of the state that it expects after a merge."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from roboassembly.geometry.mating import mating_poses, point_frames
from roboassembly.geometry.poses import euler_from_rotations, rotations_from_euler
from roboassembly.learning.datasets import LabeledState, SampleSet, group_labels
from roboassembly.task.part_frames import FramesName
from roboassembly.task.rules.connections import GRASPS, UP_AXES

CONTACT_DISTANCE = 0.004
"""Distance below which two connection points touch [m]."""
CONTACT_COSINE = -0.99
"""Cosine between the normals of two points below which they can touch."""


@dataclass(frozen=True, eq=False)
class PolicyView:
    """One state of P parts with K connection points each, as arrays of `envs.observation`."""

    clouds: Float[np.ndarray, "P C 3"]
    """Surface points of each part in its frame [m]."""
    points: Float[np.ndarray, "P K 9"]
    """Position [m], normal and tangent of each connection point in its part's frame."""
    connections: Float[np.ndarray, "P P 6"]
    """`i_from_j` of two parts of one group, translation [m] and Euler angles; else zeros."""
    free: Bool[np.ndarray, "P K"]
    """Whether each connection point exists and touches nothing."""
    group: Int[np.ndarray, "P"]
    """Group of each part, as the number of the group's first part."""
    grasps: Float[np.ndarray, "P 8 6"]
    """`part_from_tips` of each grasp; zeros where there is none or where grasps do not matter."""
    poses: Float[np.ndarray, "P 6"]
    """`world_from_part` of each part, translation [m] and Euler angles."""
    digests: Sequence[bytes]
    """Hash of each part's cloud."""
    frames: FramesName = "aligned"
    """Frames in which the parts are described."""
    moved: frozenset[int] = frozenset()
    """Groups that expected merges made: nobody knows yet where they will be put down."""

    @staticmethod
    def from_observation(
        observation: dict[str, np.ndarray], mask: Bool[np.ndarray, "P P K K ..."], frames: FramesName = "aligned"
    ) -> PolicyView:
        """Return the view of an observation, with the mask of the actions that exist."""
        connections, clouds = observation["connections"].astype(float), observation["shapes"].astype(float)
        return PolicyView(
            clouds,
            observation["connection_points"].astype(float),
            connections,
            np.asarray(mask.reshape(*mask.shape[:4], -1).any(axis=(1, 3, 4))),  # of u and k; the mask is symmetric
            group_labels(connections),
            observation["grasp_regions"].reshape(len(connections), -1, 6).astype(float),
            observation["poses"].astype(float),
            digests_of(clouds),
            frames,
        )

    @staticmethod
    def from_sample(samples: SampleSet, sample: LabeledState) -> PolicyView:
        """Return the view of a training sample, one of `samples`."""
        clouds = samples.clouds.astype(float)
        return PolicyView(
            clouds,
            sample.points.astype(float),
            sample.connections.astype(float),
            sample.free,
            sample.group,
            np.zeros((len(samples.clouds), GRASPS, 6)) if samples.grasps is None else samples.grasps.astype(float),
            sample.poses.astype(float),
            digests_of(clouds),
            samples.frames,
        )

    @property
    def action_shape(self) -> tuple[int, int, int, int, int]:
        """Shape of the object-centric mask of actions `(u, v, k, l, w)`."""
        parts, points = self.free.shape
        return parts, parts, points, points, len(UP_AXES)

    @property
    def complete(self) -> bool:
        """Whether all parts are one group; rows that only pad the arrays do not count."""
        return len(np.unique(self.group[self.points.any(axis=(1, 2))])) < 2

    def after_merge(self, u: int, k: int, v: int, l: int) -> PolicyView:  # noqa: E741
        """Return the view after point `k` of part `u` mates with point `l` of part `v`.

        The two groups are one, and their points that touch are no longer free. Gaps between mated points are neglected.
        The pose of v's group stays as it is.
        """
        moving, waiting = np.flatnonzero(self.group == self.group[u]), np.flatnonzero(self.group == self.group[v])
        members = np.concatenate([moving, waiting])
        v_from_u = self.mating_pose(u, k, v, l)
        u_rotations, u_translations = self.part_from_members(u, moving)
        v_rotations, v_translations = self.part_from_members(v, waiting)
        rotations = np.concatenate([v_from_u[0] @ u_rotations, v_rotations])
        translations = np.concatenate([u_translations @ v_from_u[0].T + v_from_u[1], v_translations])

        world_from_v = rotations_from_euler(self.poses[v, 3:])
        poses = self.poses.copy()
        poses[moving, :3] = translations[: len(moving)] @ world_from_v.T + self.poses[v, :3]
        poses[moving, 3:] = euler_from_rotations(world_from_v @ rotations[: len(moving)])
        connections, free, group = self.connections.copy(), self.free.copy(), self.group.copy()
        connections[np.ix_(members, members)] = _relative_poses(rotations, translations)
        group[members] = members.min()
        row, point = np.nonzero(free[members])
        points = self.points[members[row], point]
        position = np.einsum("nij,nj->ni", rotations[row], points[:, :3]) + translations[row]
        normal = np.einsum("nij,nj->ni", rotations[row], points[:, 3:6])
        near = np.linalg.norm(position[:, None] - position[None], axis=2) < CONTACT_DISTANCE
        moves = row < len(moving)
        touch = near & (normal @ normal.T < CONTACT_COSINE) & (moves[:, None] != moves[None])
        occupied = touch.any(axis=1)
        free[members[row[occupied]], point[occupied]] = False
        free[u, k] = free[v, l] = False
        moved = self.moved | {int(members.min())}
        return replace(self, connections=connections, free=free, group=group, poses=poses, moved=moved)

    def mating_pose(self, u: int, k: int, v: int, l: int) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:  # noqa: E741
        """Return `v_from_u` of two parts when point `k` of part `u` mates with point `l` of part `v`, without a gap."""
        a, b = self.points[u, k][None], self.points[v, l][None]
        rotation, translation = mating_poses(point_frames(a), a[:, :3], point_frames(b), b[:, :3])
        return rotation[0, 0], translation[0, 0]

    def part_from_members(
        self, part: int, members: Int[np.ndarray, "m"]
    ) -> tuple[Float[np.ndarray, "m 3 3"], Float[np.ndarray, "m 3"]]:
        """Return the poses of some members of a part's group in the part's frame; the part itself may be one."""
        poses = self.connections[part, members]
        return rotations_from_euler(poses[:, 3:]), poses[:, :3]


def digests_of(clouds: Float[np.ndarray, "P C 3"]) -> list[bytes]:
    """Return a hash of each cloud."""
    return [hashlib.blake2b(cloud.tobytes(), digest_size=16).digest() for cloud in clouds]


def _relative_poses(
    rotations: Float[np.ndarray, "m 3 3"], translations: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, "m m 6"]:
    """`i_from_j` of any two of some parts in one frame, translation and Euler angles; zeros on the diagonal."""
    back = rotations.transpose(0, 2, 1)
    relative = back[:, None] @ rotations[None]
    offset = (back[:, None] @ (translations[None] - translations[:, None])[..., None])[..., 0]
    angles = euler_from_rotations(relative.reshape(-1, 3, 3)).reshape(offset.shape)
    poses = np.concatenate([offset, angles], axis=-1)
    poses[np.arange(len(poses)), np.arange(len(poses))] = 0.0
    return poses
