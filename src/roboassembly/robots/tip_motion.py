"""Small motions of the finger tips of one arm, and of its elbow alone, as changes of the seven joint angles.

Poses are those of the frame between the finger tips, in the frame of the arm's mount.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from roboassembly.geometry.poses import SE3
from roboassembly.robots.gripper import TIPS, panda_folder
from roboassembly.robots.kinematics import JOINTS, arm

_STEPS = 4
"""Newton steps at most; the motion of one command takes two or three."""
_DAMPING = 0.005
"""Damping near singular postures."""
_EXACT = 1e-7
"""Error of the finger tips that is left [m, rad]."""
_OTHERS = np.array([[k for k in range(JOINTS) if k != j] for j in range(JOINTS)])
"""Joints but one, for each joint."""
_SIGNS = (-1.0) ** np.arange(JOINTS)
TipMotion = Float[np.ndarray, "7"]
"""Translation [m] and rotation vector [rad] of the finger tips in the mount's frame, then the motion of the elbow: the
length of a change of the joint angles that leaves the finger tips where they are [rad]."""


class _Kinematics:
    """Pinocchio's model of the arm, without a platform."""

    def __init__(self) -> None:
        self._model = pin.buildModelFromUrdf(str(panda_folder() / "urdf/panda.urdf"))
        self._data = self._model.createData()
        self._tips = self._model.getFrameId(TIPS)
        self._q = pin.neutral(self._model)

    def pose(self, q: Float[np.ndarray, "7"]) -> SE3:
        """Return `mount_from_tips`."""
        self._q[:JOINTS] = q
        pin.framesForwardKinematics(self._model, self._data, self._q)
        return self._data.oMf[self._tips].copy()

    def jacobian(self, q: Float[np.ndarray, "7"]) -> Float[np.ndarray, "6 7"]:
        """Return the geometric Jacobian: linear rows first, in the mount's axes, at the tips."""
        self._q[:JOINTS] = q
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return pin.computeFrameJacobian(self._model, self._data, self._q, self._tips, frame)[:, :JOINTS]


@cache
def _kinematics() -> _Kinematics:
    return _Kinematics()


def elbow_motion(q: Float[np.ndarray, "7"]) -> Float[np.ndarray, "7"]:
    """Return the unit change of the joint angles that leaves the finger tips where they are and moves the elbow.

    Its numbers are the signed minors of the Jacobian, which change smoothly with the posture.
    """
    minors = np.linalg.det(_kinematics().jacobian(q)[:, _OTHERS].transpose(1, 0, 2)) * _SIGNS
    return minors / max(float(np.linalg.norm(minors)), 1e-9)


def tip_motion(q: Float[np.ndarray, "7"], goal: Float[np.ndarray, "7"]) -> TipMotion:
    """Return the motion of finger tips and elbow from joint angles to others nearby."""
    here, there = _kinematics().pose(q), _kinematics().pose(goal)
    turn = pin.log3(there.rotation @ here.rotation.T)
    return np.array([*(there.translation - here.translation), *turn, (goal - q) @ elbow_motion(q)])


def follow_tip_motion(q: Float[np.ndarray, "7"], motion: TipMotion) -> Float[np.ndarray, "7"]:
    """Return the joint angles, within their limits, after a small motion of finger tips and elbow.

    Args:
        q: joint angles before it.
        motion: motion of finger tips and elbow.
    """
    if not motion.any():
        return np.clip(q, arm().low, arm().high)
    kinematics = _kinematics()
    here = kinematics.pose(q)
    position, rotation = here.translation + motion[:3], pin.exp3(motion[3:6]) @ here.rotation
    reached = np.clip(q + motion[6] * elbow_motion(q), arm().low, arm().high)
    for _ in range(_STEPS):
        tips = kinematics.pose(reached)
        error = np.concatenate([position - tips.translation, pin.log3(rotation @ tips.rotation.T)])
        if np.abs(error).max() < _EXACT:
            break
        jacobian = kinematics.jacobian(reached)
        step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + _DAMPING**2 * np.eye(6), error)
        reached = np.clip(reached + step, arm().low, arm().high)
    return reached
