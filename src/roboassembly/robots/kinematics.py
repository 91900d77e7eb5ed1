"""Batched forward and inverse kinematics of the Panda.

Poses are those of the frame between the finger tips (`gripper.hand_pose`), in the frame of the arm's mount.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float

from roboassembly.robots.gripper import TIPS, panda_folder

JOINTS = 7
_STEPS = 6
"""Largest number of Newton steps; three or four suffice from a near guess, and more find no more solutions."""
_LONGEST = 0.35
"""Largest rotation of a joint in one step [rad]."""
_DAMPING = 1e-4
"""Damping of the least-squares step."""
POSITION_TOLERANCE = 1e-7
"""Largest error of position, far below the clearance of a joint between parts [m]."""
ROTATION_TOLERANCE = 1e-7
"""Largest error of rotation [rad]."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Batch of poses."""

    rotation: Float[np.ndarray, "n 3 3"]
    translation: Float[np.ndarray, "n 3"]


@dataclass(frozen=True, eq=False)
class Arm:
    """Chain of the Panda's seven joints, each of which turns about the z axis of its own frame."""

    placements: Poses
    """Pose of each joint's frame in the previous one at angle zero."""
    tips: tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]
    """Rotation and translation of `last_joint_from_tips`."""
    low: Float[np.ndarray, "7"]
    """Lower limits of the joints [rad]."""
    high: Float[np.ndarray, "7"]
    """Upper limits of the joints [rad]."""

    def frames(self, q: Float[np.ndarray, "n 7"]) -> tuple[Float[np.ndarray, "n 7 3 3"], Float[np.ndarray, "n 7 3"]]:
        """Return rotation and origin of each joint's moving frame, in the mount's frame."""
        n = len(q)
        rotations, origins = np.empty((n, JOINTS, 3, 3)), np.empty((n, JOINTS, 3))
        rotation, translation = np.broadcast_to(np.eye(3), (n, 3, 3)), np.zeros((n, 3))
        cosine, sine = np.cos(q)[..., None], np.sin(q)[..., None]
        for j in range(JOINTS):
            translation = translation + rotation @ self.placements.translation[j]
            # One product of tall matrices is quicker than many small ones.
            before = (rotation.reshape(-1, 3) @ self.placements.rotation[j]).reshape(n, 3, 3)
            x, y, c, s = before[..., 0], before[..., 1], cosine[:, j], sine[:, j]
            rotation = rotations[:, j]
            rotation[..., 0], rotation[..., 1], rotation[..., 2] = c * x + s * y, c * y - s * x, before[..., 2]
            origins[:, j] = translation
        return rotations, origins

    def poses(self, q: Float[np.ndarray, "n 7"]) -> Poses:
        """Return `mount_from_tips`."""
        return self._tips(*self.frames(q))

    def jacobians(self, q: Float[np.ndarray, "n 7"]) -> tuple[Poses, Float[np.ndarray, "n 6 7"]]:
        """Return `mount_from_tips` and the geometric Jacobians: linear rows first, in the mount's axes, at the tips."""
        rotations, origins = self.frames(q)
        tips, axes = self._tips(rotations, origins), rotations[..., 2]
        jacobian = np.empty((len(q), 6, JOINTS))
        arms = tips.translation[:, None] - origins
        # `np.cross` takes ten times as long.
        for row, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
            jacobian[:, row] = axes[..., i] * arms[..., j] - axes[..., j] * arms[..., i]
        jacobian[:, 3:] = axes.transpose(0, 2, 1)
        return tips, jacobian

    def _tips(self, rotations: Float[np.ndarray, "n 7 3 3"], origins: Float[np.ndarray, "n 7 3"]) -> Poses:
        last = rotations[:, -1]
        return Poses(last @ self.tips[0], origins[:, -1] + last @ self.tips[1])

    def solve(
        self, targets: Poses, guess: Float[np.ndarray, "n 7"]
    ) -> tuple[Float[np.ndarray, "n 7"], Bool[np.ndarray, "n"]]:
        """Return configurations that bring the tips to target poses, and which are solutions within the joint limits.

        The method is a damped Newton iteration on the whole batch.

        Args:
            targets: poses `mount_from_tips`.
            guess: configurations to start from.
        """
        q = np.array(guess, dtype=float)
        done = np.zeros(len(q), dtype=bool)
        active = np.arange(len(q))
        for _ in range(_STEPS):
            tips, jacobian = self.jacobians(q[active])
            off = targets.translation[active] - tips.translation
            turn = rotation_vectors(targets.rotation[active] @ tips.rotation.transpose(0, 2, 1))
            near = (np.linalg.norm(off, axis=1) < POSITION_TOLERANCE) & (
                np.linalg.norm(turn, axis=1) < ROTATION_TOLERANCE
            )
            done[active[near]] = True
            keep = ~near
            if not keep.any():
                break
            active, jacobian = active[keep], jacobian[keep]
            error = np.concatenate([off, turn], axis=1)[keep]
            square = jacobian @ jacobian.transpose(0, 2, 1) + _DAMPING**2 * np.eye(6)
            step = np.einsum("nij,ni->nj", jacobian, np.linalg.solve(square, error[..., None])[..., 0])
            step *= np.minimum(1.0, _LONGEST / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
            q[active] += step
        return q, done & self.within(q)

    def within(self, q: Float[np.ndarray, "n 7"]) -> Bool[np.ndarray, "n"]:
        """Return whether configurations keep the joint limits."""
        return np.asarray(((q >= self.low) & (q <= self.high)).all(axis=1))

    def manipulability(self, q: Float[np.ndarray, "n 7"]) -> Float[np.ndarray, "n"]:
        """Return the volume of the velocity ellipsoid (Yoshikawa 1985, "Manipulability of Robotic Mechanisms")."""
        _, jacobian = self.jacobians(q)
        return np.sqrt(np.maximum(np.linalg.det(jacobian @ jacobian.transpose(0, 2, 1)), 0.0))


@cache
def arm() -> Arm:
    """Return the Panda's arm, from its URDF."""
    model = pin.buildModelFromUrdf(str(panda_folder() / "urdf/panda.urdf"))
    placements = [model.jointPlacements[i] for i in range(1, JOINTS + 1)]
    tips = model.frames[model.getFrameId(TIPS)].placement
    return Arm(
        Poses(np.array([p.rotation for p in placements]), np.array([p.translation for p in placements])),
        (np.array(tips.rotation), np.array(tips.translation)),
        np.array(model.lowerPositionLimit[:JOINTS]),
        np.array(model.upperPositionLimit[:JOINTS]),
    )


def rotation_vectors(rotation: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Return rotation vectors; only approximate near half a turn, which Newton's method tolerates."""
    skew = 0.5 * np.stack(
        [
            rotation[:, 2, 1] - rotation[:, 1, 2],
            rotation[:, 0, 2] - rotation[:, 2, 0],
            rotation[:, 1, 0] - rotation[:, 0, 1],
        ],
        axis=1,
    )
    sine = np.linalg.norm(skew, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(rotation, axis1=1, axis2=2) - 1.0))
    return skew * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0)[:, None]
