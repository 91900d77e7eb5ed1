"""Timing of full steps: how quickly robots move in each stage, and how long their hands take.

Physics (`execution`) and exported trajectories (`trajectories`) are timed by this module alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from roboassembly.geometry.meshes import WOOD_DENSITY
from roboassembly.geometry.poses import SE3
from roboassembly.geometry.scene import Body, Shape
from roboassembly.robots.limits import LIMITS
from roboassembly.robots.timing import TimedPath
from roboassembly.simulation.model import mass_properties
from roboassembly.task.full.failure import STRAIGHT, Stage

GRASP_SECONDS = 0.6
"""Time in which the fingers close and press [s]."""
RELEASE_SECONDS = 0.4
"""Time in which the fingers open [s]."""
REST_SECONDS = 0.1
"""Time in which a robot comes to rest before its hand closes or opens [s]."""
CONTACT_SPEED = 0.25
"""Largest speed of the finger tips close to other things [m/s]: the reduced speed of ISO 10218-1."""


def timed_motion(
    stage: Stage, path: Sequence[Float[np.ndarray, "10"]], payload: Sequence[Shape] = (), density: float = WOOD_DENSITY
) -> TimedPath:
    """Return the motion of a robot in a stage.

    Args:
        stage: what the robot does.
        path: way-points.
        payload: parts in its hand, in the frame of the finger tips.
        density: density of the parts [kg/m³].
    """
    limits = replace(LIMITS, tip_speed=CONTACT_SPEED) if stage in STRAIGHT else LIMITS
    return TimedPath(path, limits, payload_inertia(payload, density) if payload else None)


def payload_inertia(payload: Sequence[Shape], density: float) -> pin.Inertia:
    """Return the inertia of parts in a hand, in the frame of the finger tips."""
    mass, center, inertia = mass_properties(Body("payload", tuple(payload), SE3.Identity()))
    share = density / WOOD_DENSITY
    return pin.Inertia(share * mass, center, share * inertia)


def rest_after(stage: Stage) -> float:
    """Return how long a robot rests after a stage, before its hand does something [s]."""
    return REST_SECONDS if stage in (Stage.APPROACH, Stage.MATE, Stage.SET_DOWN) else 0.0
