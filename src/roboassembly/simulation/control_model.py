"""MuJoCo model of a workcell under control: two mobile Frankas, bodies that stand on posts, bodies that move, a floor.

Robots collide with posts, bodies, the floor and each other; links of one robot do not collide with each other. Bodies
collide with fingers, links, posts and the floor. Two moving bodies do not collide, nor does a moving body with one
that stands: pieces are convex, and a mortise is not. A body does not collide with the robot that holds it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from jaxtyping import Float

from roboassembly.geometry.poses import SE3
from roboassembly.geometry.scene import Shape
from roboassembly.robots.body import hand_links, links
from roboassembly.robots.kinematics import JOINTS
from roboassembly.robots.timing import TICK as TIME_STEP
from roboassembly.simulation.mobile_arms import PAD_FRICTION, add_mesh, add_robot, add_weld
from roboassembly.simulation.model import FLOOR_FRICTION, rotation_to_quaternion

_FINGERS, _LINKS = (1, 2), (4, 8)
"""Bits of the fingers and of the other links of robots 0 and 1."""
_BODY, _POST, _FLOOR = 16, 32, 64
"""Bits of bodies, posts and the floor."""
POST_RADIUS, _POST_LENGTH = 0.018, 2.0
"""Radius of a post and its length, most of it below the floor [m]."""


@dataclass(frozen=True, eq=False)
class CellBody:
    """Rigid body that robots may hold."""

    mass: float
    """Mass [kg]."""
    center: Float[np.ndarray, "3"]
    """Centre of mass in the body's frame [m]."""
    inertia: Float[np.ndarray, "3 3"]
    """Inertia about the centre of mass [kg·m²]."""
    pieces: tuple[Shape, ...]
    """Convex pieces of its surface."""


@dataclass(frozen=True)
class PhysicsScales:
    """Factors on constants of the physics."""

    friction: float = 1.0
    """Factor on all coefficients of friction."""
    stiffness: float = 1.0
    """Factor on the stiffness of drives and joints; their damping changes by its square root."""


@dataclass(frozen=True, eq=False)
class CellContents:
    """Bodies in the cell, and what holds them."""

    bodies: Mapping[int, CellBody]
    on_posts: Mapping[int, SE3] = field(default_factory=dict[int, SE3])
    """Pose of each body that stands on posts."""
    moving: Mapping[int, SE3] = field(default_factory=dict[int, SE3])
    """Pose of each other body."""
    posts: Mapping[int, tuple[Float[np.ndarray, "3"], ...]] = field(
        default_factory=dict[int, tuple[Float[np.ndarray, "3"], ...]]
    )
    """Tops of the posts beneath each body that stands [m]."""
    grips: Mapping[tuple[int, int], SE3] = field(default_factory=dict[tuple[int, int], SE3])
    """Pose `hand_from_body` of each moving body in each hand that holds it, by robot and body; the hand's frame is that
    of the arm's last link."""


def model_of_cell(contents: CellContents, scales: PhysicsScales) -> mujoco.MjModel:
    """Return the model; welds `grip{robot}/{body}` hold bodies in hands and have the poses of `contents.grips`.

    The first 24 positions, velocities and controls are those of the robots: ten joints and two fingers each.

    Args:
        contents: bodies in the cell.
        scales: factors on constants.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = TIME_STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0
    for robot in (0, 1):
        add_robot(spec, "ab"[robot])
        _add_links(spec, robot)
    names = _add_pieces(spec, contents)
    for key, pose in contents.on_posts.items():
        _add_body(spec, key, contents.bodies[key], pose, names, None)
        for k, top in enumerate(contents.posts.get(key, ())):
            spec.worldbody.add_geom(
                name=f"post{key}/{k}", type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[POST_RADIUS, 0.5 * _POST_LENGTH, 0.0],
                pos=[top[0], top[1], top[2] - 0.5 * _POST_LENGTH], contype=_POST,
                conaffinity=sum(_FINGERS) + sum(_LINKS),
            )  # fmt: skip
    for key, pose in contents.moving.items():
        holders = tuple(robot for robot, body in contents.grips if body == key)
        _add_body(spec, key, contents.bodies[key], pose, names, holders)
        for robot in holders:
            add_weld(spec, f"grip{robot}/{key}", f"{'ab'[robot]}/link{JOINTS}", f"body{key}")
    spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], contype=_FLOOR,
        conaffinity=sum(_FINGERS) + _BODY, friction=FLOOR_FRICTION, condim=6,
    )  # fmt: skip
    model = spec.compile()
    _set_welds(model, contents)
    _scale(model, scales)
    return model


def body_of_geom(model: mujoco.MjModel) -> dict[int, int]:
    """Return the key of the body that each geom belongs to; geoms of robots, posts and the floor are left out."""
    keys: dict[int, int] = {}
    for geom in range(model.ngeom):
        name = model.geom(geom).name
        if name.startswith("body"):
            keys[geom] = int(name.removeprefix("body").split("/")[0])
    return keys


def _add_links(spec: mujoco.MjSpec, robot: int) -> None:
    name, others = "ab"[robot], _FINGERS[1 - robot] + _LINKS[1 - robot]
    palm, palm_pose = hand_links(0.0)[0]
    shapes = [(link.name, link.carrier, link.mesh, SE3.Identity()) for link in links()]
    shapes.append((palm.name, palm.carrier, palm.mesh, palm_pose))
    for label, carrier, mesh, pose in shapes:
        if robot == 0:
            add_mesh(spec, label, mesh)
        node = spec.body(f"{name}/platform" if carrier == 0 else f"{name}/link{carrier}")
        node.add_geom(
            name=f"{name}/{label}", type=mujoco.mjtGeom.mjGEOM_MESH, meshname=label, mass=0.0, pos=pose.translation,
            quat=rotation_to_quaternion(pose.rotation), contype=_LINKS[robot], conaffinity=others,
        )  # fmt: skip
    for k in (0, 1):
        finger = spec.geom(f"{name}/finger{k}")
        finger.contype, finger.conaffinity = _FINGERS[robot], _FINGERS[1 - robot]


def _add_pieces(spec: mujoco.MjSpec, contents: CellContents) -> dict[int, str]:
    """Add the meshes of all pieces, each once, and return their names by identity."""
    names: dict[int, str] = {}
    for key in (*contents.on_posts, *contents.moving):
        for piece in contents.bodies[key].pieces:
            if id(piece.mesh) not in names:
                names[id(piece.mesh)] = f"piece{len(names)}"
                add_mesh(spec, names[id(piece.mesh)], piece.mesh)
    return names


def _add_body(
    spec: mujoco.MjSpec, key: int, body: CellBody, pose: SE3, names: Mapping[int, str], holders: Sequence[int] | None
) -> None:
    node = spec.worldbody.add_body(name=f"body{key}", pos=pose.translation, quat=rotation_to_quaternion(pose.rotation))
    if holders is not None:
        node.add_freejoint()
    node.explicitinertial = True
    node.mass, node.ipos = body.mass, body.center
    node.fullinertia = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    touched = sum(_FINGERS[robot] + _LINKS[robot] for robot in (0, 1) if robot not in (holders or ()))
    for i, piece in enumerate(body.pieces):
        node.add_geom(
            name=f"body{key}/{i}", type=mujoco.mjtGeom.mjGEOM_MESH, meshname=names[id(piece.mesh)], mass=0.0,
            pos=piece.body_from_mesh.translation, quat=rotation_to_quaternion(piece.body_from_mesh.rotation),
            contype=_BODY, conaffinity=touched + _POST, friction=PAD_FRICTION, condim=4, solref=[0.004, 1.0],
        )  # fmt: skip


def _set_welds(model: mujoco.MjModel, contents: CellContents) -> None:
    for (robot, key), hand_from_body in contents.grips.items():
        # The weld acts at the centre of mass: a lever would turn the body.
        anchor, row = contents.bodies[key].center, model.eq_data[model.equality(f"grip{robot}/{key}").id]
        row[:3] = anchor
        row[3:6] = hand_from_body.act(anchor)
        row[6:10] = rotation_to_quaternion(hand_from_body.rotation)
        row[10] = 1.0


def _scale(model: mujoco.MjModel, scales: PhysicsScales) -> None:
    model.geom_friction[:] *= scales.friction
    driven = _driven()
    model.actuator_gainprm[driven, 0] *= scales.stiffness
    model.actuator_biasprm[driven, 1] *= scales.stiffness
    model.actuator_biasprm[driven, 2] *= np.sqrt(scales.stiffness)


def _driven() -> list[int]:
    """Return the actuators of drives and joints, without fingers."""
    return [12 * robot + joint for robot in (0, 1) for joint in range(3 + JOINTS)]
