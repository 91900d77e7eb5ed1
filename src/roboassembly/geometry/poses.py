"""Poses and their representations in files, observations and networks.

Inside the package a pose is a `pinocchio.SE3`. In files it is seven numbers `(x, y, z, qw, qx, qy, qz)`.
In observations it is `(x, y, z, roll, pitch, yaw)` with `R = Rz(yaw) @ Ry(pitch) @ Rx(roll)`. For networks the
rotation is six numbers: the first two columns of R (Zhou et al. 2019, "On the Continuity of Rotation
Representations in Neural Networks"). Metres and radians throughout.

A variable named `target_from_source` maps coordinates in `source` to coordinates in `target`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from pinocchio import SE3
from scipy.spatial.transform import Rotation

from roboassembly.errors import InputError

__all__ = [
    "BOX_ROTATIONS",
    "SE3",
    "align_axis",
    "euler_from_rotations",
    "from_quaternion",
    "interpolate",
    "orthonormal",
    "pose_from_seven",
    "pose_to_euler",
    "pose_to_rotation_6d",
    "pose_to_seven",
    "poses_to_configurations",
    "rotation_angle",
    "rotation_from_quaternion",
    "rotations_from_euler",
    "storable",
    "transform_points",
]

BOX_ROTATIONS: Float[np.ndarray, "24 3 3"] = np.asarray(Rotation.create_group("O").as_matrix()).round()
"""The 24 rotations that map a cube to itself."""

_ROUND_TRIPS = 4
"""Number of round trips after which a pose no longer changes."""
_EXACT = 9
"""Decimals of a rotation matrix from which angles are computed."""
_LEAST_ANGLE = -3.14159265
"""Angle below which a half turn counts as pi [rad]."""
_DECIMALS = 14
"""Decimals of quaternions in files: fewer than a conversion from and to a matrix changes."""


def rotation_from_quaternion(wxyz: Sequence[float] | Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation matrix of the quaternion `(w, x, y, z)`, normalised first."""
    w, x, y, z = (float(c) for c in wxyz)
    quaternion = pin.Quaternion(w, x, y, z)
    norm = quaternion.norm()
    if not np.isfinite(norm) or norm < 1e-6:
        raise InputError(f"quaternion {[w, x, y, z]} has no direction; give four finite numbers, not all zero")
    quaternion.normalize()
    return quaternion.toRotationMatrix()


def from_quaternion(
    position: Sequence[float] | Float[np.ndarray, "3"], wxyz: Sequence[float] | Float[np.ndarray, "4"]
) -> SE3:
    """Return the pose of a position [m] and a quaternion `(w, x, y, z)`."""
    return SE3(rotation_from_quaternion(wxyz), np.asarray(position, dtype=float))


def pose_to_seven(pose: SE3) -> list[float]:
    """Return `[x, y, z, qw, qx, qy, qz]` with `qw >= 0`, the quaternion rounded to 14 decimals."""
    q = pin.Quaternion(pose.rotation)
    sign = -1.0 if q.w < 0 else 1.0
    return [*map(float, pose.translation), *(round(sign * c, _DECIMALS) + 0.0 for c in (q.w, q.x, q.y, q.z))]


def pose_from_seven(numbers: Sequence[float]) -> SE3:
    """Return the pose of `[x, y, z, qw, qx, qy, qz]`.

    Raises:
        InputError: not seven finite numbers, or a zero quaternion.
    """
    values = np.asarray(numbers, dtype=float)
    if values.shape != (7,) or not np.isfinite(values).all():
        raise InputError(f"a pose is seven finite numbers x, y, z, qw, qx, qy, qz; got {list(numbers)!r}")
    return from_quaternion(values[:3].tolist(), values[3:].tolist())


def storable(pose: SE3) -> SE3:
    """Return the pose, rounded so that writing it as seven numbers and reading it again changes no bit."""
    # Reading normalises the rounded quaternion, which may change its last digit; two rounds were enough in all tests.
    for _ in range(_ROUND_TRIPS):
        pose = pose_from_seven(pose_to_seven(pose))
    return pose


def pose_to_euler(pose: SE3) -> Float[np.ndarray, "6"]:
    """Return `(x, y, z, roll, pitch, yaw)` [m, rad]; `R = Rz(yaw) Ry(pitch) Rx(roll)`.

    Rounding errors of the rotation do not change the angles: a half turn is always pi, never -pi.
    """
    return np.concatenate([pose.translation, euler_from_rotations(pose.rotation[None])[0]])


def rotations_from_euler(angles: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3 3"]:
    """Return rotations of many roll, pitch and yaw angles: `R = Rz(yaw) Ry(pitch) Rx(roll)`, as in `pose_to_euler`."""
    return Rotation.from_euler("ZYX", angles[..., ::-1]).as_matrix()


def euler_from_rotations(rotations: Float[np.ndarray, "*n 3 3"]) -> Float[np.ndarray, "*n 3"]:
    """Return roll, pitch and yaw of many rotations, as in `pose_to_euler`: the inverse of `rotations_from_euler`.

    At a pitch of 90 degrees, which is frequent in furniture, the yaw is 0.
    """
    # Adding 0 makes 0 of -0, which atan2 would tell apart.
    r = np.moveaxis(np.round(rotations, _EXACT) + 0.0, (-2, -1), (0, 1))
    yaw = np.arctan2(r[1, 0], r[0, 0])
    cos, sin = np.cos(yaw), np.sin(yaw)
    pitch = np.arctan2(-r[2, 0], np.hypot(r[2, 1], r[2, 2]))
    # The roll follows from the rotation without its yaw, which is well defined at any pitch.
    roll = np.arctan2(sin * r[0, 2] - cos * r[1, 2], cos * r[1, 1] - sin * r[0, 1])
    angles = np.stack([roll, pitch, yaw], axis=-1)
    return np.where(angles < _LEAST_ANGLE, np.pi, angles)


def pose_to_rotation_6d(pose: SE3) -> Float[np.ndarray, "9"]:
    """Return the translation and the first two columns of the rotation matrix."""
    return np.concatenate([pose.translation, pose.rotation[:, 0], pose.rotation[:, 1]])


def transform_points(pose: SE3, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Return points of the pose's own frame in its parent frame."""
    return points @ pose.rotation.T + pose.translation


def rotations_and_translations(poses: Sequence[SE3]) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, "n 3"]]:
    """Return the rotations and the translations [m] of some poses."""
    return np.array([pose.rotation for pose in poses]), np.array([pose.translation for pose in poses])


def shifted(pose: SE3, offset: Float[np.ndarray, "3"]) -> SE3:
    """Return a pose moved by an offset in the outer frame [m]."""
    return SE3(pose.rotation, pose.translation + offset)


def orthonormal(pose: SE3) -> SE3:
    """Return the pose with an orthonormal rotation again: products of many rotations drift."""
    quaternion = pin.Quaternion(pose.rotation)
    quaternion.normalize()
    return SE3(quaternion.toRotationMatrix(), pose.translation)


def rotation_angle(rotation: Float[np.ndarray, "3 3"]) -> float:
    """Return the angle of a rotation matrix, in `[0, pi]` [rad]."""
    return float(np.linalg.norm(pin.log3(rotation)))


def pose_difference(a: SE3, b: SE3, point: Float[np.ndarray, "3"]) -> tuple[float, float]:
    """Return how far two poses of a body bring one of its points apart, and the angle between them [m, rad].

    Args:
        a: one pose.
        b: the other pose.
        point: the point, in the body's frame [m].
    """
    return float(np.linalg.norm(a.act(point) - b.act(point))), rotation_angle(a.rotation.T @ b.rotation)


def interpolate(start: SE3, end: SE3, fractions: Float[np.ndarray, "n"]) -> Float[np.ndarray, "7 n"]:
    """Return configurations `(x, y, z, qx, qy, qz, qw)` along an edge, one per column.

    Translation is interpolated linearly and rotation spherical-linearly, as in every path of this package and in
    OMPL's SE(3). The order of the quaternion is Pinocchio's.
    """
    fractions = np.asarray(fractions, dtype=float)
    a = pin.Quaternion(start.rotation).coeffs()
    b = pin.Quaternion(end.rotation).coeffs()
    cosine = float(a @ b)
    if cosine < 0:
        b, cosine = -b, -cosine
    out = np.empty((7, len(fractions)), order="F")
    out[:3] = start.translation[:, None] + np.outer(end.translation - start.translation, fractions)
    angle = np.arccos(min(1.0, cosine))
    if angle < 1e-9:
        out[3:] = a[:, None]
        return out
    scale = 1.0 / np.sin(angle)
    out[3:] = np.outer(a, np.sin((1.0 - fractions) * angle) * scale) + np.outer(b, np.sin(fractions * angle) * scale)
    return out


def poses_to_configurations(poses: Sequence[SE3]) -> Float[np.ndarray, "7 n"]:
    """Return free-flyer configurations `(x, y, z, qx, qy, qz, qw)`, one per column, Fortran order."""
    out = np.empty((7, len(poses)), order="F")
    for column, pose in enumerate(poses):
        out[:, column] = pin.SE3ToXYZQUAT(pose)
    return out


def turn_about_vertical(angle: float) -> Float[np.ndarray, "3 3"]:
    """Return the rotation by an angle about z [rad]."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def align_axis(source: Float[np.ndarray, "3"], target: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return the smallest rotation that maps the unit vector `source` to the unit vector `target`."""
    quaternion = pin.Quaternion.FromTwoVectors(np.asarray(source, float), np.asarray(target, float))
    # Its length is off by up to 1e-3 where the two vectors are nearly opposite.
    quaternion.normalize()
    return quaternion.toRotationMatrix()
