"""Mating geometry: the relative pose of two groups whose connection points meet.

A connection frame has its z axis along the outward normal and its x axis along the tangent. Two points meet when their
normals are opposed, their tangents are equal, and their origins are `gap` metres apart along the normal.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from roboassembly.geometry.poses import SE3

FACE_TO_FACE: Float[np.ndarray, "3 3"] = np.diag([1.0, -1.0, -1.0])
"""Rotation from the frame of a point to the frame of its mate: normal opposed, tangent equal."""
SAME_DIRECTION = 1.0 - 1e-6
"""Cosine above which two unit vectors count as one direction."""


def mated_frame(frame: SE3, gap: float = 0.0) -> SE3:
    """Return the frame that meets `frame`, `gap` metres away along its normal."""
    return frame * SE3(FACE_TO_FACE, np.array([0.0, 0.0, gap]))


def mating_pose(v_from_point: SE3, u_from_point: SE3, gap: float = 0.0) -> SE3:
    """Return `v_from_u` for a point of u that meets a point of v."""
    return mated_frame(v_from_point, gap) * u_from_point.inverse()


def point_frames(points: Any) -> Any:
    """Return the (..., 3, 3) rotation matrices `part_from_point` of (..., 9) points: position, normal and tangent.

    Works on NumPy and on JAX arrays.
    """
    xp = points.__array_namespace__()
    normal, tangent = points[..., 3:6], points[..., 6:9]
    return xp.stack([tangent, xp.cross(normal, tangent), normal], axis=-1)


def mating_rotations(u_frames: Any, v_frames: Any) -> Any:
    """Return `v_from_u` rotations for every point of u on every point of v.

    Works on NumPy and on JAX arrays.

    Args:
        u_frames: rotation matrices `u_from_point`, shape `(..., k, 3, 3)`.
        v_frames: rotation matrices `v_from_point`, shape `(..., l, 3, 3)`.

    Returns:
        Rotation matrices, shape `(..., k, l, 3, 3)`.
    """
    xp = u_frames.__array_namespace__()
    # v_from_u = V F Uᵀ, and F is diagonal.
    flip = xp.asarray(FACE_TO_FACE.diagonal(), dtype=v_frames.dtype)
    return xp.einsum("...lic,...kjc->...klij", v_frames * flip, u_frames)


def mating_poses(
    u_frames: Any, u_origins: Any, v_frames: Any, v_origins: Any, gaps: Any = None
) -> tuple[Any, Any]:  # fmt: skip
    """Return rotations and translations [m] of `v_from_u` for every point of u on every point of v.

    Works on NumPy and on JAX arrays.

    Args:
        u_frames: rotation matrices `u_from_point`, shape `(..., k, 3, 3)`.
        u_origins: positions of the points of u, shape `(..., k, 3)` [m].
        v_frames: rotation matrices `v_from_point`, shape `(..., l, 3, 3)`.
        v_origins: positions of the points of v, shape `(..., l, 3)` [m].
        gaps: distance between the points of each pair along the normal, one for all or shape `(..., k, l)` [m]; 0 if
            None.

    Returns:
        Rotation matrices, shape `(..., k, l, 3, 3)`, and translations, shape `(..., k, l, 3)`.
    """
    xp = u_frames.__array_namespace__()
    rotations = mating_rotations(u_frames, v_frames)
    met = v_origins[..., None, :, :]
    if gaps is not None:
        met = met + xp.asarray(gaps, dtype=v_origins.dtype)[..., None] * v_frames[..., None, :, :, 2]
    return rotations, met - xp.einsum("...klij,...kj->...kli", rotations, u_origins)


def distinct_directions(
    directions: Sequence[Float[np.ndarray, "3"]] | Float[np.ndarray, "n 3"], same: float = SAME_DIRECTION
) -> list[Float[np.ndarray, "3"]]:
    """Return the unit vectors without repetitions, in their order.

    Args:
        directions: unit vectors.
        same: cosine above which two of them count as one.
    """
    rows = np.reshape(directions, (-1, 3))
    equal = rows @ rows.T > same
    kept: list[int] = []
    for index in range(len(rows)):
        if not equal[index, kept].any():
            kept.append(index)
    return [rows[index] for index in kept]
