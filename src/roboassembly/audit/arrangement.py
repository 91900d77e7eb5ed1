"""Final checks of an audit: whether the parts are the furniture, and whether it stands. Uses SciPy alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3

SAME_POSITION = 1e-5
"""Distance by which two records of one pose may differ [m]."""
SAME_ANGLE = 1e-4
"""Angle by which two records of one pose may differ [rad]."""
_LEAN = float(np.deg2rad(10.0))
"""Angle from the vertical of a standing piece at most [rad]; a rocking chair at rest leans by a few degrees."""
_ABOVE_GROUND, _FEET, _BALANCE = 0.002, 0.003, 0.005
"""Tolerances of `stands` [m]."""


def misplaced(furniture: Furniture, poses: Sequence[SE3]) -> tuple[int, ...]:
    """Return parts without a slot of their own, however the furniture is laid over them.

    Equivalent parts may be swapped, and turned by symmetries of their shape.

    Args:
        furniture: furniture that should be assembled.
        poses: `world_from_part` of its parts.
    """
    best: tuple[int, ...] = tuple(range(len(poses)))
    for _, astray in _layings(furniture, poses):
        if not astray:
            return ()
        best = min(best, astray, key=len)
    return best


def stands(furniture: Furniture, poses: Sequence[SE3]) -> bool:
    """Whether an assembled piece stands on its feet: the furniture's z axis points up, within `_LEAN`; its lowest
    vertex is at most `_ABOVE_GROUND` above the ground; its centre of mass is above what it stands on, the vertices less
    than `_FEET` above the lowest.

    Args:
        furniture: furniture that is assembled.
        poses: `world_from_part` of its parts.
    """
    up = [f.rotation[2, 2] for f, astray in _layings(furniture, poses) if not astray]
    if max(up, default=-1.0) < np.cos(_LEAN):
        return False
    meshes = [part.mesh for part in furniture.parts]
    points = np.concatenate([m.vertices @ p.rotation.T + p.translation for m, p in zip(meshes, poses, strict=True)])
    lowest = float(points[:, 2].min())
    feet = points[points[:, 2] < lowest + _FEET, :2]
    volumes = np.array([mesh.volume for mesh in meshes])
    centers = np.array([p.act(m.center_of_mass) for m, p in zip(meshes, poses, strict=True)])
    middle = (volumes @ centers / volumes.sum())[:2]
    # Weights of the feet, none negative and one in all, with which they balance nearest to the centre of mass.
    _, off = nnls(np.vstack([(feet - middle).T, np.ones(len(feet))]), np.array([0.0, 0.0, 1.0]))
    return 0.0 <= lowest <= _ABOVE_GROUND and float(off) < _BALANCE


def _layings(furniture: Furniture, poses: Sequence[SE3]) -> Iterator[tuple[SE3, tuple[int, ...]]]:
    """Yield ways to lay the furniture over its parts: `world_from_furniture`, and parts without a slot of their own.

    In each, a part with the fewest equivalents is exactly in a slot; all its slots and symmetries are tried.
    """
    slots: list[_Slots] = [(furniture.classes[c].members, furniture.classes[c].symmetries) for c in furniture.class_of]
    anchor = min(range(len(poses)), key=lambda p: len(slots[p][0]) * len(slots[p][1]))
    for slot in slots[anchor][0]:
        for turn in slots[anchor][1]:
            in_slot = furniture.assembled[slot] * SE3(turn, np.zeros(3))
            furniture_from_world = in_slot * poses[anchor].inverse()
            yield furniture_from_world.inverse(), _astray(furniture, poses, furniture_from_world, slots)


_Slots = tuple[tuple[int, ...], Float[np.ndarray, "s 3 3"]]


def _astray(
    furniture: Furniture, poses: Sequence[SE3], furniture_from_world: SE3, slots: Sequence[_Slots]
) -> tuple[int, ...]:
    """Return parts without a slot of their own after a motion."""
    used: set[int] = set()
    out: list[int] = []
    for part, pose in enumerate(poses):
        here = furniture_from_world * pose
        for slot in slots[part][0]:
            there = furniture.assembled[slot]
            near = float(np.linalg.norm(here.translation - there.translation)) < 10 * SAME_POSITION
            left = there.rotation.T @ here.rotation
            if slot not in used and near and min(angle_of(t.T @ left) for t in slots[part][1]) < 10 * SAME_ANGLE:
                used.add(slot)
                break
        else:
            out.append(part)
    return tuple(out)


def angle_of(rotation: Float[np.ndarray, "3 3"]) -> float:
    """Return the angle of a rotation matrix [rad]."""
    return float(Rotation.from_matrix(rotation).magnitude())
