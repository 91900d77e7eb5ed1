"""Physics of two mobile Frankas in MuJoCo: actuated joints, gravity, fingers that press and hold by friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from jaxtyping import Float

from roboassembly.geometry.poses import SE3, from_quaternion
from roboassembly.robots.body import tip_positions
from roboassembly.robots.kinematics import JOINTS, arm
from roboassembly.robots.timing import TimedPath
from roboassembly.simulation.mobile_arms import GAINS, GRIP_FORCE, NAMES, TIME_STEP, Load, all_gains, lag, model_of
from roboassembly.simulation.model import rotation_to_quaternion

_GRIP_WEIGHTS, _LIGHTEST_GRIP = 10.0, 8.0
"""Force of each finger as a multiple of the load's weight, and at least [N]."""
_YIELDING = 0.1
"""Share of its stiffness that an arm keeps while its hand closes, so that the hand centres itself on the load."""


@dataclass(eq=False)
class PhysicsLog:
    """Measurements during an execution."""

    tracking: list[float] = field(default_factory=list[float])
    """Distance of the finger tips from their path at every sample [m]."""
    pad_force: float = 0.0
    """Largest normal force on a pad [N]."""
    samples: list[Float[np.ndarray, "10"]] = field(default_factory=list[Float[np.ndarray, "10"]])
    """Configuration of the moving robot at every sample."""


class StepPhysics:
    """The physics of one step: two robots and the two groups that they join, or the finished piece.

    Args:
        robots: configurations of the robots at the beginning.
        openings: distances between the pads [m].
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
        self._payloads: list[list[int]] = [[], []]
        for r, (q, opening) in enumerate(zip(robots, openings, strict=True)):
            self.data.qpos[self._addresses(r)] = q
            self.data.ctrl[self._controls(r)] = q
            for j in self._fingers[r]:
                self.data.qpos[self.model.jnt_qposadr[j]] = 0.5 * opening
            self._open(r, opening)
        mujoco.mj_forward(self.model, self.data)
        for index in range(len(loads)):
            self._weld(f"post{index}", True)
        self.log = PhysicsLog()

    @property
    def seconds(self) -> float:
        """Time simulated so far [s]."""
        return float(self.data.time)

    def _addresses(self, robot: int) -> Float[np.ndarray, "10"]:
        return self.model.jnt_qposadr[self._joints[robot]]

    def _controls(self, robot: int) -> slice:
        return slice(robot * (len(NAMES) + 2), robot * (len(NAMES) + 2) + len(NAMES))

    def configuration(self, robot: int) -> Float[np.ndarray, "10"]:
        """Return the configuration of a robot."""
        return np.array(self.data.qpos[self._addresses(robot)])

    def pose(self, load: int) -> SE3:
        """Return `world_from_body` of a load."""
        body = self._bodies[load]
        return from_quaternion(self.data.xpos[body], self.data.xquat[body])

    def tips(self, robot: int) -> SE3:
        """Return the pose of the finger tips."""
        link = self._links[robot]
        return from_quaternion(self.data.xpos[link], self.data.xquat[link]) * SE3(*arm().tips)

    def _tip_position(self, robot: int) -> Float[np.ndarray, "3"]:
        link = self._links[robot]
        return self.data.xpos[link] + self.data.xmat[link].reshape(3, 3) @ arm().tips[1]

    def _open(self, robot: int, opening: float) -> None:
        first = self._controls(robot).stop
        self.data.ctrl[first : first + 2] = 0.5 * opening

    def _weld(self, name: str, active: bool) -> None:
        """Switch a weld, which keeps the present relative pose of its bodies."""
        eq = self.model.equality(name).id
        if active:
            first, second = int(self.model.eq_obj1id[eq]), int(self.model.eq_obj2id[eq])
            a = from_quaternion(self.data.xpos[first], self.data.xquat[first])
            b = from_quaternion(self.data.xpos[second], self.data.xquat[second])
            relative = a.actInv(b)
            # The weld acts at the centre of mass: a lever would turn the load.
            anchor = self.loads[self._bodies.index(second)].center
            row = self.model.eq_data[eq]
            row[:3] = anchor
            row[3:6] = relative.act(anchor)
            row[6:10] = rotation_to_quaternion(relative.rotation)
            row[10] = 1.0
        self.data.eq_active[eq] = active

    def follow(self, robot: int, motion: TimedPath, rest: float = 0.0) -> None:
        """Move one robot along a path; the other one holds still.

        Args:
            robot: 0 or 1.
            motion: configurations over time.
            rest: time that the robot has afterwards to come to rest [s].
        """
        planned = motion.ticks()
        # The controller adds the forces that the motion takes, as Franka's does.
        controls = planned.position + planned.velocity * lag() + motion.forces(planned) / all_gains()
        reached: list[np.ndarray] = []

        def sample() -> None:
            reached.append(self._tip_position(robot))
            self.log.samples.append(self.configuration(robot))

        for control in controls:
            self.data.ctrl[self._controls(robot)] = control
            self._step()
            sample()
        for _ in range(round(rest / TIME_STEP)):
            self.data.ctrl[self._controls(robot)] = motion.end
            self._step()
        sample()
        off = np.array(reached) - tip_positions(np.vstack([planned.position, motion.end]))
        self.log.tracking += np.linalg.norm(off, axis=1).tolist()

    def _step(self) -> None:
        """Make one time step, with the torques that carry the payload of each hand."""
        self.data.qfrc_applied[:] = 0.0
        for robot, loads_in_hand in enumerate(self._payloads):
            for load in loads_in_hand:
                body, dofs = self._bodies[load], self._dofs[robot]
                place = self.data.xipos[body]
                mujoco.mj_jac(self.model, self.data, self._jacobian, None, place, self._links[robot])
                weight = -self.model.opt.gravity[2] * self.model.body_mass[body]
                self.data.qfrc_applied[dofs] += self._jacobian[2, dofs] * weight
        mujoco.mj_step(self.model, self.data)

    def grasp(self, robot: int, load: int, seconds: float) -> bool:
        """Close the hand and weld the load to it if both pads press the load. Return whether they do."""
        first = self._controls(robot).stop
        # The force depends on the load: a strong grip would push a light one askew.
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
        self._payloads[robot].append(load)
        return True

    def _stiffen(self, robot: int, share: float) -> None:
        """Set the stiffness of the arm's joints to a share of its full value."""
        joints = slice(self._controls(robot).stop - JOINTS, self._controls(robot).stop)
        self.model.actuator_gainprm[joints, 0] = share * np.array(GAINS)
        self.model.actuator_biasprm[joints, 1] = -share * np.array(GAINS)

    def pad_forces(self, robot: int, load: int) -> tuple[float, float]:
        """Return the force of each finger on a load [N]."""
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
        """Weld the loads together as they are; R_b holds both from now on."""
        self._weld("joint", True)
        self._payloads[1] = [0, 1]

    def release(self, robot: int, opening: float, seconds: float, posts: Sequence[int] = ()) -> None:
        """Open the hand in `seconds`; loads named in `posts` stay where they are, each on a raised post."""
        for load in posts:
            self._weld(f"post{load}", True)
        for load in range(len(self.loads)):
            self._weld(f"grip{'ab'[robot]}{load}", False)
        self._payloads[robot] = []
        self._open(robot, opening)
        for _ in range(round(seconds / TIME_STEP)):
            self._step()
