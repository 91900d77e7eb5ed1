"""The platform: a box on hidden wheels that drives any way and turns on the spot, with the arm on its front."""

from __future__ import annotations

import numpy as np

from roboassembly.geometry.poses import SE3

LENGTH, WIDTH, HEIGHT = 0.58, 0.46, 0.40
"""Metres; the length is along x, the way that the arm looks."""
CLEARANCE = 0.02
"""Metres between its underside and the ground."""
PLATFORM_FROM_MOUNT = SE3(np.eye(3), np.array([0.14, 0.0, HEIGHT]))
"""The platform's frame lies on the ground beneath its middle."""
