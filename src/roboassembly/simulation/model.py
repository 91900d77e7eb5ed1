"""MuJoCo model of a scene: parts as convex hulls, masses from volumes."""

from __future__ import annotations

import mujoco
import numpy as np

from roboassembly.geometry.meshes import WOOD_DENSITY
from roboassembly.geometry.scene import Body, Scene

TIME_STEP = 0.004
"""Time step of the physics of settling [s]."""
FLOOR_FRICTION = [0.7, 0.01, 0.005]
"""Friction of wood on a floor: sliding, torsional [m] and rolling [m]. Round parts must come to rest."""


def compile_scene(scene: Scene) -> mujoco.MjModel:
    """Return a MuJoCo model with one body per body of the scene, in the scene's order; moving ones have a free joint.

    Bodies and their joints bear the scene's names. Mesh geoms collide as convex hulls.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = TIME_STEP
    spec.compiler.fitaabb = False
    if scene.ground:
        spec.worldbody.add_geom(
            name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], friction=FLOOR_FRICTION, condim=6
        )
    known: dict[int, str] = {}
    for body in scene.bodies:
        _add_body(spec, body, known)
    return spec.compile()


def _add_body(spec: mujoco.MjSpec, body: Body, known: dict[int, str]) -> None:
    node = spec.worldbody.add_body(
        name=body.name, pos=body.pose.translation, quat=rotation_to_quaternion(body.pose.rotation)
    )
    if body.moves:
        node.add_freejoint(name=body.name)
        mass, center, inertia = mass_properties(body)
        node.explicitinertial = True
        node.mass = mass
        node.ipos = center
        node.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    for index, shape in enumerate(body.shapes):
        if id(shape.mesh) not in known:
            name = f"mesh{len(known)}"
            known[id(shape.mesh)] = name
            hull = shape.mesh.hull
            # The shell inertia never refuses a thin mesh; the body's own inertia is given explicitly.
            spec.add_mesh(
                name=name,
                uservert=hull.vertices.ravel(),
                userface=hull.faces.ravel(),
                inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
            )
        node.add_geom(
            name=f"{body.name}/{index}",
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=known[id(shape.mesh)],
            pos=shape.body_from_mesh.translation,
            quat=rotation_to_quaternion(shape.body_from_mesh.rotation),
            friction=FLOOR_FRICTION,
            condim=6,
            mass=0.0 if body.moves else 1.0,
        )


def mass_properties(body: Body) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass [kg], centre of mass [m] and inertia about it [kg·m²] in the body's frame, at `WOOD_DENSITY`."""
    masses = np.array([WOOD_DENSITY * shape.mesh.volume for shape in body.shapes])
    centers = np.array([shape.body_from_mesh.act(shape.mesh.center_of_mass) for shape in body.shapes])
    total = float(masses.sum())
    center = masses @ centers / total
    inertia = np.zeros((3, 3))
    for mass, own_center, shape in zip(masses, centers, body.shapes, strict=True):
        turn, arm = shape.body_from_mesh.rotation, own_center - center
        inertia += turn @ (WOOD_DENSITY * shape.mesh.inertia) @ turn.T
        inertia += mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return total, center, inertia


def rotation_to_quaternion(rotation: np.ndarray) -> np.ndarray:
    """Return the quaternion `w, x, y, z` of a rotation, in MuJoCo's order."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
    return quaternion
