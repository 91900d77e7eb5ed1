"""Limits of motion of a mobile Franka: position, velocity, acceleration and jerk of the platform and of each joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

JOINT_VELOCITIES = (2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61)
"""Largest velocities of the Panda's joints [rad/s]: Franka, `libfranka/include/franka/rate_limiting.h`, and the
documentation of its control interface, "Limits for Franka Emika Robot". The URDF has the same."""
JOINT_ACCELERATIONS = (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0)
"""Largest accelerations of the joints [rad/s²]; same sources."""
JOINT_JERKS = (7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0)
"""Largest jerks of the joints [rad/s³]; same sources."""
DRIVE = (1.2, 3.0, 50.0)
"""Largest speed [m/s], acceleration [m/s²] and jerk [m/s³] of the platform, in any direction. The platform is this
project's, and so are its limits: at 7 m/s² it would tip over."""
TURN = (2.5, 5.0, 100.0)
"""Largest angular velocity [rad/s], acceleration [rad/s²] and jerk [rad/s³] of the platform; ours as well."""
JOINT_TORQUES = (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)
"""Largest torques of the joints [N·m]; same sources."""
MOTION_SHARE = 0.7
"""Share of the torques that may go into acceleration; the rest is for weight and control."""
TIP_SPEED = 2.0
"""Largest speed of the finger tips in the cell [m/s]: Franka, data sheet of the arm."""
FINGER_SPEED = 0.05
"""Largest speed of each finger [m/s]: Franka Hand, data sheet."""


@dataclass(frozen=True)
class MotionLimits:
    """Limits within which a motion is timed."""

    velocity: tuple[float, ...]
    """Largest speed of the platform, angular velocity of the platform, and velocities of the joints
    [m/s, rad/s, 7 × rad/s]."""
    acceleration: tuple[float, ...]
    """Largest accelerations, in the same order [m/s², rad/s²]."""
    jerk: tuple[float, ...]
    """Largest jerks, in the same order [m/s³, rad/s³]."""
    tip_speed: float | None = None
    """Largest speed of the finger tips [m/s]; None for whatever the joints allow."""


LIMITS = MotionLimits(
    (DRIVE[0], TURN[0], *JOINT_VELOCITIES),
    (DRIVE[1], TURN[1], *JOINT_ACCELERATIONS),
    (DRIVE[2], TURN[2], *JOINT_JERKS),
    TIP_SPEED,
)
"""Limits of the robots."""


def magnitudes(rows: Float[np.ndarray, "n 10"]) -> Float[np.ndarray, "n 9"]:
    """Return derivatives of configurations as limits count them: the platform's way as one number, then the others."""
    return np.concatenate([np.linalg.norm(rows[:, :2], axis=1)[:, None], np.abs(rows[:, 2:])], axis=1)
