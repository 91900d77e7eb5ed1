"""Vectors and poses of furniture in the making: metres, z up, a sitter looks along -y and has +x on the left hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from roboassembly.geometry.poses import SE3

Vector = Float[np.ndarray, "3"]
Points = Float[np.ndarray, "k 3"]

X, Y, Z = np.eye(3)


def vector(x: float, y: float, z: float) -> Vector:
    """Return three numbers as an array."""
    return np.array([x, y, z], dtype=float)


def unit(direction: Sequence[float] | Vector) -> Vector:
    """Return the direction at length one."""
    array = np.asarray(direction, dtype=float)
    return array / np.linalg.norm(array)


def leaning(rake: float) -> tuple[Vector, Vector]:
    """Return the directions of a back that leans by `rake` radians: up along it, and out of its front."""
    return vector(0, np.sin(rake), np.cos(rake)), vector(0, -np.cos(rake), np.sin(rake))


def turn(axis: Vector, angle: float) -> Float[np.ndarray, "3 3"]:
    """Return the rotation by `angle` radians about the unit vector `axis` (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)


def move(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> SE3:
    """Return a translation."""
    return SE3(np.eye(3), vector(x, y, z))


def spin(angle: float, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> SE3:
    """Return a turn about the vertical by `angle` radians, followed by a translation."""
    return SE3(turn(Z, angle), vector(x, y, z))
