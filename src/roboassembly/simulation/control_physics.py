"""Physics of a workcell under control: commands at 20 Hz, time steps of 2 ms, hands that grip by contact.

The rules of grasps are those of dynamic execution: a hand closes with a force that depends on what it touches, the arm
yields meanwhile, and a body is fixed to the hand only once both pads press it and the fingers have come to rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import mujoco
import numpy as np
from jaxtyping import Float

from roboassembly.geometry.poses import SE3, from_quaternion
from roboassembly.robots.gripper import MAX_OPENING
from roboassembly.robots.kinematics import JOINTS, arm
from roboassembly.robots.timing import TICK as TIME_STEP
from roboassembly.simulation.control_model import CellBody, CellContents, PhysicsScales, body_of_geom, model_of_cell
from roboassembly.simulation.mobile_arms import GRIP_FORCE, lag

CONTROL_RATE = 20
"""Commands per second [1/s]."""
SUBSTEPS = round(1.0 / (CONTROL_RATE * TIME_STEP))
"""Time steps of the physics per command."""
DRIVEN = 3 + JOINTS
"""Driven joints of a robot: x, y and yaw of the platform, then the arm's."""
CLOSED = 1e-3
"""Commanded opening at and below which a hand closes with force [m]."""
_ROBOT = DRIVEN + 2
"""Joints of a robot with its two fingers."""
_PRESS = -0.02
"""Commanded position of the fingers of a hand that presses [m]."""
_GRIP_WEIGHTS, _LIGHTEST_GRIP = 10.0, 8.0
"""Force of each finger as a multiple of the weight that it holds, and at least [N]."""
_YIELDING = 0.1
"""Share of its stiffness that an arm keeps while its hand closes, so that the hand centres itself."""
_LEAST_FORCE, _STILL_FINGER = 1.0, 2e-3
"""Force of each pad at least [N], and speed of the fingers at most [m/s], when a body is gripped."""
_LOAD_INTERVAL = 5
"""Time steps between two computations of the torques that carry a load."""
_Value = TypeVar("_Value")


@dataclass(frozen=True, eq=False)
class HandContact:
    """Body between the pads of a hand."""

    body: int
    """Key of the body that the pads press most."""
    forces: tuple[float, float]
    """Normal force of each pad on it [N]."""


class CellPhysics:
    """Robots, bodies on posts and bodies in hands.

    The model is compiled anew whenever a body changes hands, so that it has degrees of freedom only for what moves.

    Args:
        robots: configurations at the beginning.
        openings: distances between the pads at the beginning [m].
        contents: bodies in the cell; all stand on posts.
        scales: factors on constants of the physics.
    """

    def __init__(
        self,
        robots: Sequence[Float[np.ndarray, "10"]],
        openings: Sequence[float],
        contents: CellContents,
        scales: PhysicsScales | None = None,
    ) -> None:
        self.contents = contents
        self._scales = scales or PhysicsScales()
        self.commands: Float[np.ndarray, "2 10"] = np.array(robots)
        """Configuration that each robot was last told to have."""
        state = np.zeros((2, 2 * _ROBOT))
        for robot, opening in enumerate(openings):
            state[0, _ROBOT * robot : _ROBOT * (robot + 1)] = [*robots[robot], 0.5 * opening, 0.5 * opening]
        self.touching = False
        """Whether a robot touched a post, the floor, the other robot or a body, but with its pads, at the last time
        step."""
        self._closing = [False, False]
        self.stable = True
        """Whether the physics has stayed within bounds: MuJoCo starts again from nothing when it does not."""
        self._grip_contacts: dict[int, HandContact] = {}
        self._grip_places = [0.0, 0.0]
        self._hold_force = [_LIGHTEST_GRIP, _LIGHTEST_GRIP]
        self._compile(state, {}, 0.0)

    def _compile(self, robots: Float[np.ndarray, "2 24"], speeds: Mapping[int, np.ndarray], time: float) -> None:
        contents = self.contents
        self.model = model_of_cell(contents, self._scales)
        self.data = mujoco.MjData(self.model)
        self._key_of_geom = body_of_geom(self.model)
        self._links = [self.model.body(f"{n}/link{JOINTS}").id for n in "ab"]
        self._fingers = {self.model.geom(f"{n}/finger{k}").id: (r, k) for r, n in enumerate("ab") for k in (0, 1)}
        self._floor = self.model.geom("floor").id
        passive = {*self._fingers, *self._key_of_geom}
        self._arm_geoms = {g for g in range(self.model.ngeom) if g not in passive and self.model.geom(g).name[1] == "/"}
        self._contacts: dict[int, HandContact] = {}
        self._poses: dict[int, SE3] = {}
        self._ids = {key: self.model.body(f"body{key}").id for key in (*contents.on_posts, *contents.moving)}
        self._stiff = np.array(self.model.actuator_gainprm[:, 0])
        self._jacobian = np.zeros((3, self.model.nv))
        data, first = self.data, 2 * _ROBOT
        data.time = time
        data.qpos[:first], data.qvel[:first] = robots
        for index, key in enumerate(contents.moving):
            data.qvel[first + 6 * index : first + 6 * (index + 1)] = speeds.get(key, np.zeros(6))
        for robot, key in contents.grips:
            data.eq_active[self.model.equality(f"grip{robot}/{key}").id] = True
        for robot in (0, 1):
            self.data.ctrl[_ROBOT * robot : _ROBOT * robot + DRIVEN] = self.commands[robot]
        mujoco.mj_forward(self.model, data)

    def _recompile(self, contents: CellContents, speeds: Mapping[int, np.ndarray] | None = None) -> None:
        """Change what is in the cell; robots keep their state, moving bodies their speeds."""
        first = 2 * _ROBOT
        kept = {key: self._speed(index) for index, key in enumerate(self.contents.moving)} | dict(speeds or {})
        robots = np.stack([self.data.qpos[:first], self.data.qvel[:first]])
        moving = {key: self.pose(key) if key in self._ids else pose for key, pose in contents.moving.items()}
        self.contents = replace(contents, moving=moving)
        self._compile(robots, kept, float(self.data.time))

    def _speed(self, index: int) -> Float[np.ndarray, "6"]:
        first = 2 * _ROBOT + 6 * index
        return np.array(self.data.qvel[first : first + 6])

    @property
    def seconds(self) -> float:
        """Time simulated so far [s]."""
        return float(self.data.time)

    def configuration(self, robot: int) -> Float[np.ndarray, "10"]:
        """Return the configuration of a robot."""
        return np.array(self.data.qpos[_ROBOT * robot : _ROBOT * robot + DRIVEN])

    def velocity(self, robot: int) -> Float[np.ndarray, "10"]:
        """Return the speed of each driven joint [m/s, rad/s]."""
        return np.array(self.data.qvel[_ROBOT * robot : _ROBOT * robot + DRIVEN])

    def opening(self, robot: int) -> float:
        """Return the distance between the pads of a hand [m]."""
        return float(self.data.qpos[_ROBOT * robot + DRIVEN : _ROBOT * (robot + 1)].sum())

    def pose(self, body: int) -> SE3:
        """Return `world_from_body`."""
        if body not in self._poses:
            index = self._ids[body]
            self._poses[body] = from_quaternion(self.data.xpos[index], self.data.xquat[index])
        return self._poses[body]

    def center(self, body: int) -> Float[np.ndarray, "3"]:
        """Return the centre of mass of a body in the world [m]."""
        return self.data.xipos[self._ids[body]]

    def speed(self, body: int) -> float:
        """Return the speed of a body's frame [m/s]; 0 of one on posts."""
        moving = list(self.contents.moving)
        return float(np.linalg.norm(self._speed(moving.index(body))[:3])) if body in moving else 0.0

    def hand(self, robot: int) -> SE3:
        """Return the pose of the arm's last link, to which the hand is fixed."""
        link = self._links[robot]
        return from_quaternion(self.data.xpos[link], self.data.xquat[link])

    def tips(self, robot: int) -> SE3:
        """Return the pose of the finger tips."""
        return self.hand(robot) * SE3(*arm().tips)

    def holders(self, body: int) -> tuple[int, ...]:
        """Return the robots that hold a body."""
        return tuple(robot for robot, other in self.contents.grips if other == body)

    def grasped(self, robot: int) -> int | None:
        """Return the key of the body that a robot holds; None if its hand is empty."""
        return next((body for r, body in self.contents.grips if r == robot), None)

    def advance(self, targets: Float[np.ndarray, "2 10"], openings: Sequence[float]) -> None:
        """Simulate one period of control, in which commands move from their last values to the targets.

        Args:
            targets: configuration that each robot is to have at the end.
            openings: distance between the pads of each hand [m]; at most `CLOSED` to close with force.
        """
        data, model = self.data, self.model
        share = np.arange(1, SUBSTEPS + 1)[:, None] / SUBSTEPS
        for robot in (0, 1):
            self._set_hand(robot, openings[robot])
        way = targets - self.commands
        ahead = way * (CONTROL_RATE * lag())
        rows = np.empty((SUBSTEPS, 2 * _ROBOT))
        for robot in (0, 1):
            first = _ROBOT * robot
            rows[:, first : first + DRIVEN] = self.commands[robot] + ahead[robot] + share * way[robot]
            rows[:, first + DRIVEN : first + _ROBOT] = data.ctrl[first + DRIVEN : first + _ROBOT]
        self.commands, begun = np.array(targets), float(data.time)
        for k, row in enumerate(rows):
            data.ctrl[:] = row
            if self.contents.grips and k % _LOAD_INTERVAL == 0:
                self._carry()
            mujoco.mj_step(model, data)
        self.stable = self.stable and data.time > begun and bool(np.isfinite(data.qpos).all())
        self._poses.clear()
        self._look_at_contacts()

    def _set_hand(self, robot: int, opening: float) -> None:
        """Set position and force of the fingers, and let the arm yield while they close on something."""
        first = _ROBOT * robot + DRIVEN
        closing = opening <= CLOSED
        self.data.ctrl[first : first + 2] = _PRESS if closing else 0.5 * min(opening, MAX_OPENING)
        if self.grasped(robot) is not None:
            # What a hand holds is fixed to it, and so are the fingers to where they are.
            self.data.ctrl[first : first + 2] = self._grip_places[robot]
        contact = self.contact(robot)
        if closing and contact is not None and self.grasped(robot) is None:
            weight = 9.81 * self.contents.bodies[contact.body].mass
            self._hold_force[robot] = float(np.clip(_GRIP_WEIGHTS * weight, _LIGHTEST_GRIP, GRIP_FORCE))
        force = self._hold_force[robot] if closing else GRIP_FORCE
        self.model.actuator_forcerange[first : first + 2] = [-force, force]
        self._closing[robot] = closing
        yields = closing and self.grasped(robot) is None and self.opening(robot) > CLOSED
        joints = slice(first - JOINTS, first)
        stiffness = self._stiff[joints] * (_YIELDING if yields else 1.0)
        self.model.actuator_gainprm[joints, 0] = stiffness
        self.model.actuator_biasprm[joints, 1] = -stiffness

    def _carry(self) -> None:
        """Apply the torques with which the arms carry what they hold; two arms that hold a body share its weight."""
        data, model = self.data, self.model
        data.qfrc_applied[:] = 0.0
        for robot, body in self.contents.grips:
            dofs = slice(_ROBOT * robot, _ROBOT * robot + DRIVEN)
            index = self._ids[body]
            mujoco.mj_jac(model, data, self._jacobian, None, data.xipos[index], self._links[robot])
            share = 9.81 * self.contents.bodies[body].mass / len(self.holders(body))
            data.qfrc_applied[dofs] += self._jacobian[2, dofs] * share

    def _look_at_contacts(self) -> None:
        """Note the forces of the pads and whether anything else of a robot touches something."""
        data = self.data
        forces: dict[tuple[int, int], list[float]] = {}
        self.touching, force = False, np.zeros(6)
        for i in range(data.ncon):
            geom_a, geom_b = (int(g) for g in data.contact[i].geom)
            if geom_b in self._fingers:
                geom_a, geom_b = geom_b, geom_a
            finger, key = self._fingers.get(geom_a), self._key_of_geom.get(geom_b)
            if finger is not None and key is not None:
                mujoco.mj_contactForce(self.model, data, i, force)
                forces.setdefault((finger[0], key), [0.0, 0.0])[finger[1]] += float(force[0])
            elif finger is not None or geom_a in self._arm_geoms or geom_b in self._arm_geoms:
                self.touching = True
        self._contacts = {}
        for (robot, key), (left, right) in forces.items():
            known = self._contacts.get(robot)
            if known is None or left + right > sum(known.forces):
                self._contacts[robot] = HandContact(key, (left, right))

    def contact(self, robot: int) -> HandContact | None:
        """Return what the pads of a hand pressed at the last time step; None if nothing.

        Of a hand that holds a body it is what they pressed when they gripped it.
        """
        return self._contacts.get(robot) if self.grasped(robot) is None else self._grip_contacts[robot]

    def pressed_body(self, robot: int) -> int | None:
        """Return the key of the body that a closing, empty hand has between its pads; None if there is none yet."""
        contact = self.contact(robot)
        if contact is None or not self._closing[robot] or self.grasped(robot) is not None:
            return None
        fingers = self.data.qvel[_ROBOT * robot + DRIVEN : _ROBOT * (robot + 1)]
        if min(contact.forces) < _LEAST_FORCE or np.abs(fingers).max() > _STILL_FINGER:
            return None
        return contact.body

    def on_floor(self, body: int) -> bool:
        """Whether a body touches the floor."""
        pairs = (tuple(int(g) for g in self.data.contact[i].geom) for i in range(self.data.ncon))
        return any(self._floor in pair and body in (self._key_of_geom.get(g) for g in pair) for pair in pairs)

    def grip(self, robot: int, body: int) -> None:
        """Fix a body to a hand as it is; the posts beneath it sink."""
        contents, pose = self.contents, self.pose(body)
        self._grip_places[robot] = 0.5 * self.opening(robot)
        self._grip_contacts[robot] = self._contacts[robot]
        grips = {**contents.grips, (robot, body): self.hand(robot).actInv(pose)}
        self._recompile(
            replace(
                contents, on_posts=_without(contents.on_posts, body), posts=_without(contents.posts, body), grips=grips,
                moving={**contents.moving, body: pose},
            )
        )  # fmt: skip

    def release(self, robot: int) -> None:
        """Let go of what a hand holds, which falls unless something else holds it."""
        kept = {pair: pose for pair, pose in self.contents.grips.items() if pair[0] != robot}
        self._recompile(replace(self.contents, grips=kept))

    def stand(self, body: int, tops: Sequence[Float[np.ndarray, "3"]]) -> None:
        """Fix a body that no hand holds to posts that rise beneath it.

        Args:
            body: its key.
            tops: tops of the posts [m].
        """
        contents = self.contents
        on_posts, posts = {**contents.on_posts, body: self.pose(body)}, {**contents.posts, body: tuple(tops)}
        moving = _without(contents.moving, body)
        self._recompile(replace(contents, on_posts=on_posts, posts=posts, moving=moving))

    def join(self, first: int, second: int, whole: CellBody, pose: SE3) -> None:
        """Replace two bodies by one that has the key of the second; hands that hold either of them hold it.

        Args:
            first: key of a body; it is free afterwards.
            second: key of another body, whose speed the whole has.
            whole: both as one body.
            pose: its pose.
        """
        contents = self.contents
        grips = {
            (robot, second if body == first else body): self.hand(robot).actInv(pose) if body in (first, second) else at
            for (robot, body), at in contents.grips.items()
        }
        speeds = {key: self._speed(i) for i, key in enumerate(contents.moving) if key == second}
        rest = {key: at for key, at in contents.moving.items() if key not in (first, second)}
        bodies = {**_without(contents.bodies, first), second: whole}
        for robot, contact in self._grip_contacts.items():
            self._grip_contacts[robot] = replace(contact, body=second if contact.body == first else contact.body)
        self._ids.pop(second)
        self._recompile(
            CellContents(
                bodies, _without(_without(contents.on_posts, first), second), {**rest, second: pose},
                _without(_without(contents.posts, first), second), grips,
            ),
            speeds,
        )  # fmt: skip


def _without(mapping: Mapping[int, _Value], key: int) -> dict[int, _Value]:
    return {k: value for k, value in mapping.items() if k != key}
