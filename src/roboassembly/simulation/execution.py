"""Two mobile Frankas in MuJoCo: actuated joints, gravity, fingers that close by force and hold by friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from jaxtyping import Float

from roboassembly.geometry.poses import SE3, from_quaternion
from roboassembly.robots.body import tip_positions
from roboassembly.robots.kinematics import JOINTS, arm
from roboassembly.simulation.mobile_arms import GAINS, GRIP_FORCE, NAMES, Load, lag, model_of
from roboassembly.simulation.model import rotation_to_quaternion
from roboassembly.simulation.pacing import TIME_STEP, paced

_GRIP_WEIGHTS, _LIGHTEST_GRIP = 10.0, 8.0
"""Each finger presses with so many times the load's weight, and with no fewer newtons."""
_YIELDING = 0.1
"""Share of its stiffness that an arm keeps while its hand closes, so that the hand centres itself on what it holds."""


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
    """The physics of one step: two robots and the two groups that they join, or the finished piece.

    Args:
        robots: configurations at the beginning.
        openings: metres between the pads.
        loads: u's group and v's group, or the finished piece, on their posts at the beginning.
    """

    def __init__(
        self, robots: Sequence[Float[np.ndarray, "10"]], openings: Sequence[float], loads: Sequence[Load]
    ) -> None:
        self.model = model_of(loads)
        self.data = mujoco.MjData(self.model)
        self.loads = tuple(loads)
        self._joints = [[self.model.joint(f"{n}/{j}").id for j in NAMES] for n in "ab"]
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
        return slice(robot * (len(NAMES) + 2), robot * (len(NAMES) + 2) + len(NAMES))

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
            self.data.ctrl[self._controls(robot)] = q + velocity * lag()
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
        limit = float(np.clip(_GRIP_WEIGHTS * weight, _LIGHTEST_GRIP, GRIP_FORCE))
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
        self.model.actuator_gainprm[joints, 0] = share * np.array(GAINS)
        self.model.actuator_biasprm[joints, 1] = -share * np.array(GAINS)

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
