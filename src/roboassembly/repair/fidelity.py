"""Distances between a solid and the surface that it was made from, in both directions."""

from __future__ import annotations

import manifold3d as m3
import numpy as np

from roboassembly.repair.proximity import Shell, shell_of
from roboassembly.repair.surface import Surface, sample, to_surface

SPACING = 0.016
"""Distance between sample points [m]."""
MAX_POINTS = 3_000
QUANTILE = 0.99
_NEAR = 5e-4
"""Distance below which a point counts as on the surface [m]."""


def lost(surface: Surface, body: m3.Manifold) -> float:
    """Return how far the delivered surface sticks out of the solid: 99th percentile of evenly sampled points [m]."""
    points = _sample_evenly(surface)
    shell = shell_of(body)
    distance = shell.distances_to(points)
    deep = np.flatnonzero(distance > _NEAR)
    out = body.bounding_box()
    beyond = np.array([out[3] + 0.1, out[4] + 0.137, out[5] + 0.0713])
    allowed = int((1.0 - QUANTILE) * len(points)) + 1
    outside = 0
    for k in deep[np.argsort(-distance[deep], kind="stable")].tolist():
        if len(body.ray_cast(points[k], beyond)) % 2 == 0:
            outside += 1
            if outside > allowed:
                break
        else:
            distance[k] = 0.0
    return float(np.quantile(distance, QUANTILE))


def added(surface: Surface, body: m3.Manifold) -> float:
    """Return how far the solid's skin lies from the delivered surface: 99th percentile of evenly sampled points [m].

    Caps over open ends count: a filled tube gives half its width.
    """
    shell = Shell(surface)
    return float(np.quantile(shell.distances_to(_sample_evenly(to_surface(body))), QUANTILE))


def _sample_evenly(surface: Surface) -> np.ndarray:
    points, _ = sample(surface, SPACING, MAX_POINTS)
    return points[np.linspace(0, len(points) - 1, min(len(points), MAX_POINTS)).astype(int)]
