"""Omnidirectional platform: a box on hidden wheels that turns on the spot, with the arm on its front."""

from __future__ import annotations

import numpy as np

from roboassembly.geometry.poses import SE3

LENGTH, WIDTH, HEIGHT = 0.58, 0.46, 0.40
"""Dimensions; the length is along x, in the direction that the arm faces [m]."""
MASS = 90.0
"""Mass, batteries included [kg]."""
CLEARANCE = 0.02
"""Distance between underside and ground [m]."""
PLATFORM_FROM_MOUNT = SE3(np.eye(3), np.array([0.14, 0.0, HEIGHT]))
"""Pose of the arm's mount; the platform's frame lies on the ground beneath its middle."""
