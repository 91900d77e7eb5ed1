"""Peer: the workcell in RoboPlan, whose RRT-Connect and collision checks are compiled, on Pinocchio and Coal as ours.

The robot is a tree of two sliding joints, one turning joint and the Panda's seven. All shapes are the triangles that
ours has; nothing is solid, so that a shape wholly inside another one goes unnoticed.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from roboassembly.errors import MissingExtraError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3
from roboassembly.planning.pools import GROUND, WORLD_FROM_GROUND
from roboassembly.planning.robot_path import Configuration, nearest_turn
from roboassembly.planning.robot_shapes import own_pairs
from roboassembly.robots.body import HAND, PLATFORM, hand_links, joint_placements, links
from roboassembly.robots.kinematics import arm
from roboassembly.task.full.cell_state import Segment

_LONGEST = 1.5
"""Largest extension of a tree, as of ours [m, rad]."""
_TURNS = 4.0 * np.pi
"""Largest angle of the platform [rad]."""
_NODES = 1_000_000
"""Largest number of nodes of a tree: only time limits a search."""


class RoboPlanCell:
    """Workcell in RoboPlan, one segment at a time.

    Raises:
        MissingExtraError: RoboPlan is not installed.
    """

    def __init__(self) -> None:
        try:
            self._core: Any = importlib.import_module("roboplan.core")
            self._rrt: Any = importlib.import_module("roboplan.rrt")
        except ImportError:
            raise MissingExtraError("roboplan", "bench") from None
        self._folder = TemporaryDirectory()
        self._files: dict[int, tuple[Path, Mesh]] = {}
        """File of each mesh, by the mesh's identity; the mesh is kept, so that no other one has it."""
        self._scene: Any = None

    def close(self) -> None:
        """Remove the files of meshes."""
        self._folder.cleanup()

    def set_up(self, furniture: Furniture, segment: Segment, floor: float) -> None:
        """Replace the scene by that of a segment.

        Args:
            furniture: furniture of the groups.
            segment: motion of one robot.
            floor: distance from the middle to the walls [m].
        """
        self._scene = scene = self._core.Scene(
            "cell", self._core.loadUrdfSceneDescriptionFromXml(mobile_panda_urdf(floor))
        )
        state, robot = segment.before, segment.robot
        own = state.robots[robot]
        moving = [
            self._add(f"own{i}", _frame(link.carrier), SE3.Identity(), link.mesh) for i, link in enumerate(links())
        ]
        hand = [
            self._add(f"hand{i}", _frame(HAND), pose, link.mesh)
            for i, (link, pose) in enumerate(hand_links(own.opening))
        ]
        tips = SE3(*arm().tips)
        load = [
            self._add(f"load{i}", _frame(HAND), tips * s.body_from_mesh, s.mesh)
            for i, s in enumerate(own.payload_shapes(furniture))
        ]
        still = [
            self._add(f"{body.name}/{i}", "universe", body.pose * s.body_from_mesh, s.mesh)
            for body in state.around(furniture, robot)
            for i, s in enumerate(body.shapes)
        ]
        scene.addBoxGeometry("ground", "universe", self._core.Box(*GROUND), _matrix(WORLD_FROM_GROUND), np.ones(4))
        robot_shapes = [*moving, *hand]
        tested = {(robot_shapes[a], robot_shapes[b]) for a, b in own_pairs()}
        tested |= {(a, b) for a, link in zip(moving, links(), strict=True) if link.carrier != HAND for b in load}
        alike = [*robot_shapes, *load]
        off = [(a, b) for i, a in enumerate(alike) for b in alike[i + 1 :] if (a, b) not in tested]
        off += [(a, b) for i, a in enumerate(still) for b in still[i + 1 :]]
        # The platform drives on the ground.
        scene.setCollisions([*off, *((a, "ground") for a in still), (moving[PLATFORM], "ground")], False)

    def is_free(self, q: Configuration) -> bool:
        """Return whether a configuration of the segment's robot is free."""
        return not self._scene.hasCollisions(q)

    def plan(self, start: Configuration, goal: Configuration, step: float, seconds: float, seed: int) -> bool:
        """Return whether RRT-Connect finds a path.

        Args:
            start: first configuration.
            goal: last configuration.
            step: distance between two states that are tested, in the norm of configurations [m, rad].
            seconds: time after which the search is stopped [s].
            seed: seed of the search.
        """
        names = list(self._scene.getJointNames())
        begin = nearest_turn(start, np.zeros_like(start))
        ends = [self._core.JointConfiguration(names, q) for q in (begin, nearest_turn(goal, begin))]
        options = self._rrt.RRTOptions(
            max_nodes=_NODES, max_connection_distance=_LONGEST, collision_check_step_size=step,
            max_planning_time=seconds, rrt_connect=True,
        )  # fmt: skip
        planner = self._rrt.RRT(self._scene, options)
        planner.setRngSeed(seed)
        try:
            return planner.plan(*ends) is not None
        except RuntimeError:
            # It raises where it finds no path, or an end is not free.
            return False

    def _add(self, name: str, frame: str, pose: SE3, mesh: Mesh) -> str:
        """Add a mesh to the scene, fixed to a frame; returns its name."""
        if id(mesh) not in self._files:
            path = Path(self._folder.name) / f"{len(self._files)}.stl"
            trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)
            self._files[id(mesh)] = path, mesh
        file = self._core.Mesh(self._files[id(mesh)][0])
        self._scene.addMeshGeometry(name, frame, file, _matrix(pose), np.ones(4))
        return name


def mobile_panda_urdf(floor: float) -> str:
    """Return the kinematics of a mobile Panda as URDF, without shapes.

    Args:
        floor: distance from the middle to the walls [m].
    """
    joints = [
        ("x", "prismatic", "base", "slide", SE3.Identity(), "1 0 0", -floor, floor),
        ("y", "prismatic", "slide", "turntable", SE3.Identity(), "0 1 0", -floor, floor),
        ("angle", "revolute", "turntable", _frame(PLATFORM), SE3.Identity(), "0 0 1", -_TURNS, _TURNS),
        *(
            (f"joint{j + 1}", "revolute", _frame(j), _frame(j + 1), placement, "0 0 1", arm().low[j], arm().high[j])
            for j, placement in enumerate(joint_placements())
        ),
    ]
    lines = ['<robot name="mobile_panda">', '<link name="base"/>']
    for name, kind, parent, child, pose, axis, low, high in joints:
        place = " ".join(repr(float(x)) for x in pose.translation)
        turn = " ".join(repr(float(x)) for x in Rotation.from_matrix(pose.rotation).as_euler("xyz"))
        lines.append(
            f'<link name="{child}"/><joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{place}" rpy="{turn}"/><axis xyz="{axis}"/>'
            f'<limit lower="{float(low)!r}" upper="{float(high)!r}" velocity="1" effort="1"/></joint>'
        )
    return "\n".join([*lines, "</robot>"])


def _frame(carrier: int) -> str:
    """Return the name of a carrier's frame."""
    return "platform" if carrier == PLATFORM else f"link{carrier}"


def _matrix(pose: SE3) -> np.ndarray:
    return np.asfortranarray(pose.homogeneous)
