"""Light, sizes and meshes that the renderer of pictures shares with the cameras of the workcell, which MuJoCo draws."""

from __future__ import annotations

from typing import Any

import numpy as np

from roboassembly.errors import ArgumentError
from roboassembly.geometry.meshes import Mesh
from roboassembly.rendering.shading import shade

LIGHT_DIRECTION = np.array([0.24, 0.34, -1.0]) / np.linalg.norm([0.24, 0.34, -1.0])
"""Unit vector along which the light falls: past the usual camera, from its upper left."""
LARGEST_PICTURE = 8192
"""Largest width and height of a picture [pixels]."""


def add_shaded_mesh(spec: Any, name: str, mesh: Mesh, mujoco: Any) -> None:
    """Add a mesh with the normals of its shading to a model that is drawn and not simulated.

    Args:
        spec: MuJoCo's specification of the model.
        name: name of the mesh there.
        mesh: the mesh.
        mujoco: the module, imported for rendering.
    """
    shaded = shade(mesh)
    faces = shaded.faces
    normals = shaded.normals
    vertices = shaded.vertices
    if not mesh.is_solid:
        # Open surfaces are drawn from both sides.
        faces = np.concatenate([faces, faces[:, ::-1] + len(vertices)])
        vertices, normals = np.concatenate([vertices, vertices]), np.concatenate([normals, -normals])
    spec.add_mesh(
        name=name,
        uservert=vertices.reshape(-1),
        userface=faces.reshape(-1).astype(np.int32),
        usernormal=normals.reshape(-1),
        userfacenormal=faces.reshape(-1).astype(np.int32),
        # Other inertia modes refuse meshes that are open, flat or inside out.
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )


def check_size(width: int, height: int) -> None:
    """Raise `ArgumentError` unless a picture can have this size in pixels."""
    if not (1 <= width <= LARGEST_PICTURE and 1 <= height <= LARGEST_PICTURE):
        raise ArgumentError(
            f"picture size {width} x {height}: width and height must be between 1 and {LARGEST_PICTURE} pixels"
        )
