"""Dynamics of a mobile Franka: forces that a motion takes, with what the hand holds."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from roboassembly.geometry.poses import SE3
from roboassembly.robots.gripper import TIPS, panda_folder
from roboassembly.robots.kinematics import JOINTS
from roboassembly.robots.platform import HEIGHT, LENGTH, MASS, PLATFORM_FROM_MOUNT, WIDTH

ROTOR_INERTIA = 0.1
"""Inertia of each motor, as its joint feels it [kg·m²]; Franka publishes none, the usual models of MuJoCo have this."""


def motion_forces(
    position: Float[np.ndarray, "n 10"],
    velocity: Float[np.ndarray, "n 10"],
    acceleration: Float[np.ndarray, "n 10"],
    payload: pin.Inertia | None = None,
) -> Float[np.ndarray, "n 10"]:
    """Return the forces of the platform's drives and the torques of all joints that accelerate the robot [N, N·m].

    The weight of the robot and its payload is left out: a motion that takes twice as long needs a quarter.

    Args:
        position: configurations [m, rad].
        velocity: derivatives of the configurations.
        acceleration: second derivatives.
        payload: inertia of what the hand holds, in the frame of the finger tips.
    """
    model, last_from_tips = _model()
    if payload is not None:
        model = model.copy()
        model.appendBodyToJoint(model.njoints - 1, payload, last_from_tips)
    data = model.createData()
    forces = [pin.rnea(model, data, *state) for state in zip(position, velocity, acceleration, strict=True)]
    return np.array(forces).reshape(-1, model.nv)


@cache
def _model() -> tuple[pin.Model, SE3]:
    """Return the model without gravity, and the pose `last_joint_from_tips`."""
    whole = pin.buildModelFromUrdf(str(panda_folder() / "urdf/panda.urdf"))
    fingers = [i for i in range(1, whole.njoints) if i > JOINTS]
    arm = pin.buildReducedModel(whole, fingers, pin.neutral(whole))
    platform = pin.Model()
    turned = 0
    for name, joint in (("x", pin.JointModelPX()), ("y", pin.JointModelPY()), ("turn", pin.JointModelRZ())):
        turned = platform.addJoint(turned, joint, SE3.Identity(), name)
    platform.appendBodyToJoint(turned, pin.Inertia.FromBox(MASS, LENGTH, WIDTH, HEIGHT), SE3.Identity())
    frame = platform.addFrame(pin.Frame("mount", turned, 0, PLATFORM_FROM_MOUNT, pin.FrameType.OP_FRAME))
    model = pin.appendModel(platform, arm, frame, SE3.Identity())
    model.gravity.linear = np.zeros(3)
    model.armature = np.array([0.0] * 3 + [ROTOR_INERTIA] * JOINTS)
    return model, model.frames[model.getFrameId(TIPS)].placement
