"""Two mobile Frankas carried out in MuJoCo: actuated joints, gravity, fingers that close by force and hold by friction.

Robots, and what they hold, are dynamic; what stands on posts does not move and is left to the exact geometry
(`planning`), by which the states that come out are checked. In physics only the fingers' pads and what is between them
collide: MuJoCo takes meshes for convex, and a mortise is not; the pads meet the part's own surface there, cut out
around the grasp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import mujoco
import numpy as np
import pinocchio as pin
import trimesh
from jaxtyping import Float

from roboassembly.gripper import MAX_OPENING, hand_bodies, panda_folder
from roboassembly.meshes import Mesh
from roboassembly.poses import SE3, from_quaternion
from roboassembly.robots.body import tip_positions
from roboassembly.robots.kinematics import JOINTS, arm
from roboassembly.robots.platform import HEIGHT, LENGTH, PLATFORM_FROM_MOUNT, WIDTH
from roboassembly.simulation.model import rotation_to_quaternion
from roboassembly.simulation.pacing import TIME_STEP, paced

_PLATFORM_MASS = 90.0
"""Kilograms, batteries included."""
_PLATFORM_GAINS = (6e5, 6e5, 1.5e5)
"""N/m, N/m and N·m/rad of the platform's drives."""
_GAINS = (9000.0, 9000.0, 7000.0, 7000.0, 4000.0, 4000.0, 3000.0)
"""N·m/rad of the arm's joints."""
_TORQUES = (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)
"""N·m, Franka's limits."""
_DAMPING_RATIO = 1.0
_GRIP_WEIGHTS, _LIGHTEST_GRIP, _GRIP_FORCE = 10.0, 8.0, 40.0
"""Newtons of each finger; the hand's continuous limit is 70."""
_YIELDING = 0.1
"""Share of its stiffness that an arm keeps while its hand closes, so that the hand centres itself on what it holds."""
_PAD_FRICTION = [1.0, 0.02, 0.001]
"""Rubber on wood: sliding, torsional [m], rolling [m]."""
_CLIP = 0.03
"""Metres around a grasp of the part's surface that the pads can meet."""
_STIFF = [2.0 * TIME_STEP, 1.0], [0.999, 0.9999, 1e-4, 0.5, 2.0]
"""What holds fast: time constant and damping; impedances."""
_BEYOND = 1e-3
"""Metres beyond the pads, likewise."""


@dataclass(frozen=True, eq=False)
class Load:
    """A group that a robot may hold: one rigid body."""

    pose: SE3
    """`world_from_body` at the beginning."""
    mass: float
    """Kilograms."""
    center: Float[np.ndarray, "3"]
    """Of mass, in the body's frame, metres."""
    inertia: Float[np.ndarray, "3 3"]
    """About it, kg·m²."""
    between_pads: tuple[Mesh, ...]
    """Convex pieces, in the body's frame, that pads may meet."""


@dataclass(eq=False)
class Log:
    """What happened while it was carried out."""

    tracking: list[float] = field(default_factory=list)
    """Metres from where the finger tips ought to be, at every sample."""
    pad_force: float = 0.0
    """Newtons, the largest normal force on a pad."""
    samples: list[Float[np.ndarray, "10"]] = field(default_factory=list)
    """Configurations of the robot that moves, at every sample."""


class StepPhysics:
    """The physics of one step: two robots and the two groups that they join.

    Args:
        robots: configurations at the beginning.
        openings: metres between the pads.
        loads: u's group and v's group, on their posts at the beginning.
    """

    def __init__(
        self, robots: Sequence[Float[np.ndarray, "10"]], openings: Sequence[float], loads: Sequence[Load]
    ) -> None:
        spec = mujoco.MjSpec()
        spec.option.timestep = TIME_STEP
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.impratio = 10.0
        for name in "ab":
            _add_robot(spec, name)
        for index, load in enumerate(loads):
            _add_load(spec, f"load{index}", load, index)
            _add_weld(spec, f"post{index}", "world", f"load{index}")
            for name in "ab":
                _add_weld(spec, f"grip{name}{index}", f"{name}/link{JOINTS}", f"load{index}")
        _add_weld(spec, "joint", "load1", "load0")
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.loads = tuple(loads)
        self._joints = [[self.model.joint(f"{n}/{j}").id for j in _names()] for n in "ab"]
        self._fingers = [[self.model.joint(f"{n}/finger{k}").id for k in (0, 1)] for n in "ab"]
        self._links = [self.model.body(f"{n}/link{JOINTS}").id for n in "ab"]
        self._bodies = [self.model.body(f"load{index}").id for index in range(len(loads))]
        self._dofs = [self.model.jnt_dofadr[joints] for joints in self._joints]
        self._jacobian = np.zeros((3, self.model.nv))
        self._held: list[list[int]] = [[], []]
        for r, (q, opening) in enumerate(zip(robots, openings, strict=True)):
            self.data.qpos[self._addresses(r)] = q
            self.data.ctrl[self._controls(r)] = q
            for j in self._fingers[r]:
                self.data.qpos[self.model.jnt_qposadr[j]] = 0.5 * opening
            self._open(r, opening)
        mujoco.mj_forward(self.model, self.data)
        for index in range(len(loads)):
            self._weld(f"post{index}", True)
        self.log = Log()

    @property
    def seconds(self) -> float:
        """Simulated so far."""
        return float(self.data.time)

    def _addresses(self, robot: int) -> Float[np.ndarray, "10"]:
        return self.model.jnt_qposadr[self._joints[robot]]

    def _controls(self, robot: int) -> slice:
        return slice(robot * (len(_names()) + 2), robot * (len(_names()) + 2) + len(_names()))

    def configuration(self, robot: int) -> Float[np.ndarray, "10"]:
        """Where a robot is."""
        return np.array(self.data.qpos[self._addresses(robot)])

    def pose(self, load: int) -> SE3:
        """`world_from_body` of a load."""
        body = self._bodies[load]
        return from_quaternion(self.data.xpos[body], self.data.xquat[body])

    def tips(self, robot: int) -> SE3:
        """Where the finger tips are."""
        link = self._links[robot]
        return from_quaternion(self.data.xpos[link], self.data.xquat[link]) * SE3(*arm().tips)

    def _tip_position(self, robot: int) -> Float[np.ndarray, "3"]:
        link = self._links[robot]
        return self.data.xpos[link] + self.data.xmat[link].reshape(3, 3) @ arm().tips[1]

    def _open(self, robot: int, opening: float) -> None:
        first = self._controls(robot).stop
        self.data.ctrl[first : first + 2] = 0.5 * opening

    def _weld(self, name: str, active: bool) -> None:
        """Switch a weld; what it holds together is held as it is now."""
        eq = self.model.equality(name).id
        if active:
            one, two = int(self.model.eq_obj1id[eq]), int(self.model.eq_obj2id[eq])
            a = from_quaternion(self.data.xpos[one], self.data.xquat[one])
            b = from_quaternion(self.data.xpos[two], self.data.xquat[two])
            relative = a.actInv(b)
            # Held where its weight pulls: a lever would turn it.
            anchor = self.loads[self._bodies.index(two)].center
            row = self.model.eq_data[eq]
            row[:3] = anchor
            row[3:6] = relative.act(anchor)
            row[6:10] = rotation_to_quaternion(relative.rotation)
            row[10] = 1.0
        self.data.eq_active[eq] = active

    def follow(self, robot: int, path: Sequence[Float[np.ndarray, "10"]], slower: float = 1.0) -> None:
        """Move one robot along a path, at its own pace; the other one holds still."""
        wanted: list[np.ndarray] = []
        got: list[np.ndarray] = []

        def sample(q: Float[np.ndarray, "10"]) -> None:
            wanted.append(q)
            got.append(self._tip_position(robot))
            self.log.samples.append(self.configuration(robot))

        for q, velocity in paced(path, slower):
            self.data.ctrl[self._controls(robot)] = q + velocity * _lag()
            self._step()
            sample(q)
        for _ in range(round(0.1 / TIME_STEP)):
            self.data.ctrl[self._controls(robot)] = path[-1]
            self._step()
        sample(path[-1])
        off = np.array(got) - tip_positions(np.array(wanted))
        self.log.tracking += np.linalg.norm(off, axis=1).tolist()

    def _step(self) -> None:
        """One time step, with the torques that carry what each hand holds."""
        self.data.qfrc_applied[:] = 0.0
        for robot, held in enumerate(self._held):
            for load in held:
                body, dofs = self._bodies[load], self._dofs[robot]
                place = self.data.xipos[body]
                mujoco.mj_jac(self.model, self.data, self._jacobian, None, place, self._links[robot])
                weight = -self.model.opt.gravity[2] * self.model.body_mass[body]
                self.data.qfrc_applied[dofs] += self._jacobian[2, dofs] * weight
        mujoco.mj_step(self.model, self.data)

    def grasp(self, robot: int, load: int, seconds: float = 0.6) -> bool:
        """Close the hand; once both pads press the load it is held fast. Whether they do."""
        first = self._controls(robot).stop
        # As much as the load needs: a light one would be pushed askew.
        weight = -self.model.opt.gravity[2] * self.model.body_mass[self._bodies[load]]
        limit = float(np.clip(_GRIP_WEIGHTS * weight, _LIGHTEST_GRIP, _GRIP_FORCE))
        self.model.actuator_forcerange[first : first + 2] = [-limit, limit]
        self._stiffen(robot, _YIELDING)
        for _ in range(round(seconds / TIME_STEP)):
            self.data.ctrl[first : first + 2] = -0.02
            self._step()
        self._stiffen(robot, 1.0)
        forces = self.pad_forces(robot, load)
        self.log.pad_force = max(self.log.pad_force, *forces)
        if min(forces) < 1.0:
            return False
        self._weld(f"grip{'ab'[robot]}{load}", True)
        self._weld(f"post{load}", False)
        self._held[robot].append(load)
        return True

    def _stiffen(self, robot: int, share: float) -> None:
        """Let the arm's joints hold with a share of their stiffness."""
        joints = slice(self._controls(robot).stop - JOINTS, self._controls(robot).stop)
        self.model.actuator_gainprm[joints, 0] = share * np.array(_GAINS)
        self.model.actuator_biasprm[joints, 1] = -share * np.array(_GAINS)

    def pad_forces(self, robot: int, load: int) -> tuple[float, float]:
        """Newtons that each finger presses on a load."""
        out = [0.0, 0.0]
        force = np.zeros(6)
        body = self._bodies[load]
        fingers = [self.model.body(f"{'ab'[robot]}/finger{k}").id for k in (0, 1)]
        for i in range(self.data.ncon):
            contact = self.data.contact[i]
            owners = [int(self.model.geom_bodyid[g]) for g in contact.geom]
            for k, finger in enumerate(fingers):
                if body in owners and finger in owners:
                    mujoco.mj_contactForce(self.model, self.data, i, force)
                    out[k] += float(force[0])
        return out[0], out[1]

    def join(self) -> None:
        """Weld the loads as they are: R_b holds both from now on."""
        self._weld("joint", True)
        self._held[1] = [0, 1]

    def release(self, robot: int, opening: float, posts: Sequence[int] = ()) -> None:
        """Open the hand; loads named in `posts` stay where they are, on a post that has risen."""
        for load in posts:
            self._weld(f"post{load}", True)
        for load in range(len(self.loads)):
            self._weld(f"grip{'ab'[robot]}{load}", False)
        self._held[robot] = []
        self._open(robot, opening)
        for _ in range(round(0.4 / TIME_STEP)):
            self._step()


def _names() -> tuple[str, ...]:
    return ("x", "y", "turn", *(f"q{i + 1}" for i in range(JOINTS)))


def _all_gains() -> Float[np.ndarray, "10"]:
    return np.array([*_PLATFORM_GAINS, *_GAINS])


@cache
def _dampings() -> Float[np.ndarray, "10"]:
    """Critical for the inertia that each joint moves, roughly."""
    inertia = np.array([_PLATFORM_MASS + 20.0, _PLATFORM_MASS + 20.0, 12.0, 2.0, 2.0, 1.2, 1.2, 0.3, 0.25, 0.15])
    return 2.0 * _DAMPING_RATIO * np.sqrt(_all_gains() * inertia)


@cache
def _lag() -> Float[np.ndarray, "10"]:
    """Seconds by which a joint would trail behind without its velocity fed forward."""
    return _dampings() / _all_gains()


def _add_robot(spec: mujoco.MjSpec, name: str) -> None:
    platform = spec.worldbody.add_body(name=f"{name}/platform", gravcomp=1.0)
    platform.explicitinertial = True
    platform.mass = _PLATFORM_MASS
    platform.ipos = [0.0, 0.0, 0.5 * HEIGHT]
    sides = np.array([LENGTH, WIDTH, HEIGHT]) ** 2
    platform.inertia = _PLATFORM_MASS / 12.0 * (sides.sum() - sides)
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
        node.add_joint(name=f"{name}/q{j + 1}", type=hinge, axis=[0, 0, 1], armature=0.1)
    rotation, origin = arm().tips
    pieces = hand_bodies(0.0)[1:]
    for k, (mesh, _) in enumerate(pieces):
        finger = node.add_body(
            name=f"{name}/finger{k}", pos=origin, quat=rotation_to_quaternion(rotation), gravcomp=1.0
        )
        finger.explicitinertial = True
        finger.mass, finger.inertia = 0.1, [1e-4, 1e-4, 1e-4]
        axis = hand_bodies(1.0)[1 + k][1].translation * 2.0
        finger.add_joint(
            name=f"{name}/finger{k}", type=slide, axis=axis, limited=True, range=[-0.001, 0.5 * MAX_OPENING],
            damping=20.0,
        )  # fmt: skip
        mesh_name = f"finger{k}"
        if name == "a":
            _add_mesh(spec, mesh_name, mesh)
        finger.add_geom(
            name=f"{name}/finger{k}", type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh_name, mass=0.0,
            contype=1, conaffinity=2, friction=_PAD_FRICTION, condim=4, solref=[0.004, 1.0],
        )  # fmt: skip
    _couple(spec, f"{name}/finger0", f"{name}/finger1")
    damping = _dampings()
    limits = [1e5, 1e5, 1e5, *_TORQUES]
    for i, joint in enumerate(_names()):
        actuator = spec.add_actuator(name=f"{name}/{joint}", target=f"{name}/{joint}")
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        actuator.set_to_position(kp=float(_all_gains()[i]), kv=float(damping[i]))
        actuator.forcelimited, actuator.forcerange = True, [-limits[i], limits[i]]
    for k in (0, 1):
        actuator = spec.add_actuator(name=f"{name}/finger{k}", target=f"{name}/finger{k}")
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        actuator.set_to_position(kp=4000.0, kv=100.0)
        actuator.forcelimited, actuator.forcerange = True, [-_GRIP_FORCE, _GRIP_FORCE]


def _couple(spec: mujoco.MjSpec, one: str, two: str) -> None:
    """Both fingers open and close by as much, as in Franka's hand."""
    gear = spec.add_equality(name=f"{one} gear", name1=one, name2=two)
    gear.type = mujoco.mjtEq.mjEQ_JOINT
    gear.objtype = mujoco.mjtObj.mjOBJ_JOINT
    gear.data[:5] = [0.0, 1.0, 0.0, 0.0, 0.0]
    gear.solref, gear.solimp = _STIFF


def _set_inertia(node: mujoco.MjsBody, inertia: pin.Inertia) -> None:
    node.explicitinertial = True
    node.mass = inertia.mass
    node.ipos = inertia.lever
    node.fullinertia = inertia.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _add_load(spec: mujoco.MjSpec, name: str, load: Load, index: int) -> None:
    body = spec.worldbody.add_body(
        name=name, pos=load.pose.translation, quat=rotation_to_quaternion(load.pose.rotation)
    )
    body.add_freejoint()
    body.explicitinertial = True
    body.mass, body.ipos = load.mass, load.center
    body.fullinertia = load.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    for i, mesh in enumerate(load.between_pads):
        _add_mesh(spec, f"{name}/{i}", mesh)
        body.add_geom(
            name=f"{name}/{i}", type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"{name}/{i}", mass=0.0,
            contype=2, conaffinity=1, friction=_PAD_FRICTION, condim=4, solref=[0.004, 1.0],
        )  # fmt: skip


def _add_mesh(spec: mujoco.MjSpec, name: str, mesh: Mesh) -> None:
    hull = mesh.hull
    spec.add_mesh(
        name=name, uservert=hull.vertices.ravel(), userface=hull.faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )  # fmt: skip


def _add_weld(spec: mujoco.MjSpec, name: str, one: str, two: str) -> None:
    weld = spec.add_equality(name=name, name1=one, name2=two, active=False)
    weld.type = mujoco.mjtEq.mjEQ_WELD
    weld.objtype = mujoco.mjtObj.mjOBJ_BODY
    weld.solref, weld.solimp = _STIFF


def between_pads(mesh: Mesh, frame: SE3, width: float) -> Mesh:
    """The part's own surface that pads can meet: the convex hull of what lies around a grasp, in the mesh's frame.

    Args:
        mesh: of the part.
        frame: `mesh_from_tips`.
        width: metres between the pads when they touch. What lies beyond them (the other limb of a frame) is left out.
    """
    solid = mesh.trimesh
    box = trimesh.creation.box([2.0 * _CLIP, width + 2.0 * _BEYOND, 2.0 * _CLIP])
    box.apply_transform(frame.homogeneous)
    clipped = trimesh.boolean.intersection([solid, box], engine="manifold")
    return Mesh.from_trimesh(clipped.convex_hull)
