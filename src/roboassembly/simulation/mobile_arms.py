"""The MuJoCo model of two mobile Frankas and the two groups that they join: bodies, actuators, and what may hold what.

Robots, and what they hold, are dynamic; what stands on posts does not move and is left to the exact geometry
(`planning`), by which the states that come out are checked. In physics only the fingers' pads and what is between them
collide: MuJoCo takes meshes for convex, and a mortise is not; the pads meet the part's own surface there, cut out
around the grasp. A finished piece that is set on the floor meets it with its parts' convex hulls, as when it settles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np
import pinocchio as pin
import trimesh
from jaxtyping import Float

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3
from roboassembly.robots.dynamics import ROTOR_INERTIA
from roboassembly.robots.gripper import MAX_OPENING, hand_bodies, panda_folder
from roboassembly.robots.kinematics import JOINTS, arm
from roboassembly.robots.limits import JOINT_TORQUES
from roboassembly.robots.platform import HEIGHT, LENGTH, MASS, PLATFORM_FROM_MOUNT, WIDTH
from roboassembly.robots.timing import TICK as TIME_STEP
from roboassembly.simulation.model import FLOOR_FRICTION, rotation_to_quaternion

GAINS = (9000.0, 9000.0, 7000.0, 7000.0, 4000.0, 4000.0, 3000.0)
"""Stiffness of the arm's joints [N·m/rad]."""
GRIP_FORCE = 40.0
"""Largest force of each finger [N]; the hand's continuous limit is 70 N."""
NAMES = ("x", "y", "turn", *(f"q{i + 1}" for i in range(JOINTS)))
"""Names of a robot's joints, after `a/` or `b/`; actuators have the names of their joints."""
_PLATFORM_GAINS = (6e5, 6e5, 1.5e5)
"""Stiffness of the platform's drives [N/m, N/m, N·m/rad]."""
_DAMPING_RATIO = 1.0
PAD_FRICTION = [1.0, 0.02, 0.001]
"""Friction of rubber on wood: sliding, torsional [m], rolling [m]."""
_CLIP = 0.03
"""Half the extent around a grasp of the part's surface that the pads can touch [m]."""
_STIFF = [2.0 * TIME_STEP, 1.0], [0.999, 0.9999, 1e-4, 0.5, 2.0]
"""Solver parameters of welds: time constant [s] and damping ratio; impedances."""
_BEYOND = 1e-3
"""Extent of that surface beyond the pads [m]."""


@dataclass(frozen=True, eq=False)
class Load:
    """Group that a robot may hold, as one rigid body."""

    pose: SE3
    """Pose `world_from_body` at the beginning."""
    mass: float
    """Mass [kg]."""
    center: Float[np.ndarray, "3"]
    """Centre of mass in the body's frame [m]."""
    inertia: Float[np.ndarray, "3 3"]
    """Inertia about the centre of mass [kg·m²]."""
    between_pads: tuple[Mesh, ...]
    """Convex pieces, in the body's frame, that pads may touch."""
    feet: tuple[Mesh, ...] = ()
    """Meshes, in the body's frame, whose convex hulls may touch the floor; empty if the load is never set on it."""


def model_of(loads: Sequence[Load]) -> mujoco.MjModel:
    """Return a model of robots `a` and `b`, bodies `load0` and, with two loads, `load1`, and welds, all inactive.

    `post0` holds a load to the world, `gripa0` to a robot's last link, `joint` two loads together.

    Args:
        loads: u's group and v's group, or the finished piece.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = TIME_STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0
    for name in "ab":
        add_robot(spec, name)
    for index, load in enumerate(loads):
        _add_load(spec, f"load{index}", load)
        add_weld(spec, f"post{index}", "world", f"load{index}")
        for name in "ab":
            add_weld(spec, f"grip{name}{index}", f"{name}/link{JOINTS}", f"load{index}")
    if len(loads) == 2:
        add_weld(spec, "joint", "load1", "load0")
    if any(load.feet for load in loads):
        spec.worldbody.add_geom(
            name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], contype=4, conaffinity=8,
            friction=FLOOR_FRICTION, condim=6,
        )  # fmt: skip
    return spec.compile()


@cache
def all_gains() -> Float[np.ndarray, "10"]:
    """Return the stiffness of the platform's drives and of the arm's joints [N/m, N·m/rad]."""
    return np.array([*_PLATFORM_GAINS, *GAINS])


@cache
def _dampings() -> Float[np.ndarray, "10"]:
    """Return damping that is about critical for the inertia that each joint moves."""
    inertia = np.array([MASS + 20.0, MASS + 20.0, 12.0, 2.0, 2.0, 1.2, 1.2, 0.3, 0.25, 0.15])
    return 2.0 * _DAMPING_RATIO * np.sqrt(all_gains() * inertia)


@cache
def lag() -> Float[np.ndarray, "10"]:
    """Return the delay of each joint without velocity feed-forward [s]."""
    return _dampings() / all_gains()


def add_robot(spec: mujoco.MjSpec, name: str) -> None:
    """Add a robot with its drives, joints and fingers; of its shapes only the fingers."""
    platform = spec.worldbody.add_body(name=f"{name}/platform", gravcomp=1.0)
    platform.explicitinertial = True
    platform.mass = MASS
    platform.ipos = [0.0, 0.0, 0.5 * HEIGHT]
    sides = np.array([LENGTH, WIDTH, HEIGHT]) ** 2
    platform.inertia = MASS / 12.0 * (sides.sum() - sides)
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    for joint, kind, axis in (("x", slide, [1, 0, 0]), ("y", slide, [0, 1, 0]), ("turn", hinge, [0, 0, 1])):
        platform.add_joint(name=f"{name}/{joint}", type=kind, axis=axis)
    model = pin.buildModelFromUrdf(str(panda_folder() / "urdf/panda.urdf"))
    node, chain = platform, arm().placements
    for j in range(JOINTS):
        placement = SE3(chain.rotation[j], chain.translation[j])
        placement = PLATFORM_FROM_MOUNT * placement if j == 0 else placement
        node = node.add_body(
            name=f"{name}/link{j + 1}", pos=placement.translation, quat=rotation_to_quaternion(placement.rotation),
            gravcomp=1.0,
        )  # fmt: skip
        _set_inertia(node, model.inertias[j + 1])
        node.add_joint(name=f"{name}/q{j + 1}", type=hinge, axis=[0, 0, 1], armature=ROTOR_INERTIA)
    rotation, origin = arm().tips
    pieces = hand_bodies(0.0)[1:]
    for k, (mesh, _) in enumerate(pieces):
        finger = node.add_body(
            name=f"{name}/finger{k}", pos=origin, quat=rotation_to_quaternion(rotation), gravcomp=1.0
        )
        finger.explicitinertial = True
        # Without a place given, MuJoCo takes the frame's offset from the link for it, once more.
        finger.mass, finger.inertia, finger.ipos = 0.1, [1e-4, 1e-4, 1e-4], np.zeros(3)
        axis = hand_bodies(1.0)[1 + k][1].translation * 2.0
        finger.add_joint(
            name=f"{name}/finger{k}", type=slide, axis=axis, limited=True, range=[-0.001, 0.5 * MAX_OPENING],
            damping=20.0,
        )  # fmt: skip
        mesh_name = f"finger{k}"
        if name == "a":
            add_mesh(spec, mesh_name, mesh)
        finger.add_geom(
            name=f"{name}/finger{k}", type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh_name, mass=0.0,
            contype=1, conaffinity=2, friction=PAD_FRICTION, condim=4, solref=[0.004, 1.0],
        )  # fmt: skip
    _couple(spec, f"{name}/finger0", f"{name}/finger1")
    damping = _dampings()
    limits = [1e5, 1e5, 1e5, *JOINT_TORQUES]
    for i, joint in enumerate(NAMES):
        actuator = spec.add_actuator(name=f"{name}/{joint}", target=f"{name}/{joint}")
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        actuator.set_to_position(kp=float(all_gains()[i]), kv=float(damping[i]))
        actuator.forcelimited, actuator.forcerange = True, [-limits[i], limits[i]]
    for k in (0, 1):
        actuator = spec.add_actuator(name=f"{name}/finger{k}", target=f"{name}/finger{k}")
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        actuator.set_to_position(kp=4000.0, kv=100.0)
        actuator.forcelimited, actuator.forcerange = True, [-GRIP_FORCE, GRIP_FORCE]


def _couple(spec: mujoco.MjSpec, first: str, second: str) -> None:
    """Couple two joints so that they move equally, as the fingers of Franka's hand do."""
    gear = spec.add_equality(name=f"{first} gear", name1=first, name2=second)
    gear.type = mujoco.mjtEq.mjEQ_JOINT
    gear.objtype = mujoco.mjtObj.mjOBJ_JOINT
    gear.data[:5] = [0.0, 1.0, 0.0, 0.0, 0.0]
    gear.solref, gear.solimp = _STIFF


def _set_inertia(node: mujoco.MjsBody, inertia: pin.Inertia) -> None:
    node.explicitinertial = True
    node.mass = inertia.mass
    node.ipos = inertia.lever
    node.fullinertia = inertia.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _add_load(spec: mujoco.MjSpec, name: str, load: Load) -> None:
    body = spec.worldbody.add_body(
        name=name, pos=load.pose.translation, quat=rotation_to_quaternion(load.pose.rotation)
    )
    body.add_freejoint()
    body.explicitinertial = True
    body.mass, body.ipos = load.mass, load.center
    body.fullinertia = load.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    for i, mesh in enumerate(load.between_pads):
        add_mesh(spec, f"{name}/{i}", mesh)
        body.add_geom(
            name=f"{name}/{i}", type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"{name}/{i}", mass=0.0,
            contype=2, conaffinity=1, friction=PAD_FRICTION, condim=4, solref=[0.004, 1.0],
        )  # fmt: skip
    for i, mesh in enumerate(load.feet):
        add_mesh(spec, f"{name}/foot{i}", mesh)
        body.add_geom(
            name=f"{name}/foot{i}", type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"{name}/foot{i}", mass=0.0,
            contype=8, conaffinity=4, friction=FLOOR_FRICTION, condim=6,
        )  # fmt: skip


def add_mesh(spec: mujoco.MjSpec, name: str, mesh: Mesh) -> None:
    """Add the convex hull of a mesh."""
    hull = mesh.hull
    spec.add_mesh(
        name=name, uservert=hull.vertices.ravel(), userface=hull.faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )  # fmt: skip


def add_weld(spec: mujoco.MjSpec, name: str, first: str, second: str) -> None:
    """Add a weld of two bodies, inactive."""
    weld = spec.add_equality(name=name, name1=first, name2=second, active=False)
    weld.type = mujoco.mjtEq.mjEQ_WELD
    weld.objtype = mujoco.mjtObj.mjOBJ_BODY
    weld.solref, weld.solimp = _STIFF


def between_pads(mesh: Mesh, frame: SE3, width: float) -> Mesh:
    """Return the part's surface that pads can touch: the convex hull of what lies around a grasp, in the mesh's frame.

    Args:
        mesh: mesh of the part.
        frame: `mesh_from_tips`.
        width: distance between the pads when they touch [m]; what lies beyond them, such as the other limb of a frame,
            is left out.
    """
    solid = mesh.trimesh
    box = trimesh.creation.box(grasp_box(width))
    box.apply_transform(frame.homogeneous)
    clipped = trimesh.boolean.intersection([solid, box], engine="manifold")
    return Mesh.from_trimesh(clipped.convex_hull)


def grasp_box(width: float) -> list[float]:
    """Return the sides of the box around a grasp, in the frame of the tips, outside of which pads touch nothing [m].

    Args:
        width: distance between the pads when they touch [m].
    """
    return [2.0 * _CLIP, width + 2.0 * _BEYOND, 2.0 * _CLIP]
