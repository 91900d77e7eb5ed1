"""The hand against a part by other means than the package's: python-fcl and the URDF read without Pinocchio."""

from __future__ import annotations

from xml.etree import ElementTree

import fcl
import numpy as np
import pytest
import trimesh

from roboassembly.furniture.jaws import CLEARANCE
from roboassembly.furniture.model import GraspRegion
from roboassembly.furniture.opposite_sides import FRICTION
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, rotations_from_euler
from roboassembly.robots.gripper import MAX_OPENING, RETREAT, WIDER, hand_pose, panda_folder

STEP = 0.01
"""Metres between the places where the independent checker looks at the coming hand."""


class FclHand:
    """The URDF's own boxes and mesh, read without Pinocchio, against a part in python-fcl."""

    def __init__(self, mesh: Mesh) -> None:
        self._part = fcl.CollisionObject(_fcl_mesh(mesh.vertices, mesh.faces), fcl.Transform())
        urdf = ElementTree.parse(panda_folder() / "urdf/panda.urdf")
        links = {link.get("name"): link for link in urdf.iter("link")}
        joints = {joint.get("name"): joint for joint in urdf.iter("joint")}
        hand_from_tips = _origin(joints["panda_hand_tcp_joint"])
        self._bodies = []
        for link, joint in (
            ("panda_hand", None), ("panda_leftfinger", "panda_finger_joint1"),
            ("panda_rightfinger", "panda_finger_joint2"),
        ):  # fmt: skip
            base = hand_from_tips.inverse() * (_origin(joints[joint]) if joint else SE3.Identity())
            axis = np.array(joints[joint].find("axis").get("xyz").split(), float) if joint else np.zeros(3)
            for collision in links[link].findall("collision"):
                self._bodies.append((_shape(collision), base * _origin(collision), axis))

    def collides(self, part_from_tips: SE3, opening: float) -> bool:
        for shape, placement, axis in self._bodies:
            pose = part_from_tips * SE3(np.eye(3), 0.5 * opening * axis) * placement
            body = fcl.CollisionObject(shape, fcl.Transform(pose.rotation, pose.translation))
            if fcl.collide(body, self._part, fcl.CollisionRequest(), fcl.CollisionResult()):
                return True
        return False


def _fcl_mesh(vertices: np.ndarray, faces: np.ndarray) -> fcl.BVHModel:
    model = fcl.BVHModel()
    model.beginModel(len(vertices), len(faces))
    model.addSubModel(vertices, faces)
    model.endModel()
    return model


def _origin(element: ElementTree.Element) -> SE3:
    origin = element.find("origin")
    if origin is None:
        return SE3.Identity()
    xyz, rpy = (np.array(origin.get(key, "0 0 0").split(), float) for key in ("xyz", "rpy"))
    return SE3(rotations_from_euler(rpy), xyz)


def _shape(collision: ElementTree.Element) -> fcl.CollisionGeometry:
    box = collision.find("geometry/box")
    if box is not None:
        return fcl.Box(*map(float, box.get("size").split()))
    name = collision.find("geometry/mesh").get("filename").rsplit("/", 1)[1]
    mesh = trimesh.load_mesh(panda_folder() / "meshes/collision" / name)
    return _fcl_mesh(np.array(mesh.vertices), np.array(mesh.faces))


def check_region(mesh: Mesh, region: GraspRegion, checker: FclHand, *, fan: float = 15.0, uneven: bool = False) -> None:
    """Everything that is promised of a region, by other means than those that found it.

    Args:
        mesh: the part.
        region: on it.
        checker: of the hand and the part.
        fan: smallest angle between two approaches [degrees].
        uneven: whether the hand comes only as far open as robots open it.
    """
    opening = min(MAX_OPENING, region.width + WIDER) if uneven else MAX_OPENING
    closing, approaches = region.closing, region.approaches
    assert np.linalg.norm(closing) == pytest.approx(1.0)
    assert np.allclose(np.linalg.norm(approaches, axis=1), 1.0)
    assert np.abs(approaches @ closing).max() < 1e-9
    between = np.degrees(np.arccos(np.clip(approaches @ approaches.T, -1, 1)))[np.triu_indices(4, 1)]
    assert between.min() > fan - 1e-6
    assert 0.0 < region.width <= MAX_OPENING - 2.0 * CLEARANCE
    for approach in approaches:
        tips = hand_pose(region.position, closing, approach)
        assert not checker.collides(tips, region.width + 2.0 * CLEARANCE)
        # It does hold something: closed by another 4 mm, the fingers go into the part.
        assert checker.collides(tips, region.width - 0.004)
        for back in np.arange(0.0, RETREAT + 1e-9, STEP):
            assert not checker.collides(tips * SE3(np.eye(3), np.array([0.0, 0.0, -back])), opening)
    # Where the pads' middles meet the part its sides face each other, within the cone of friction.
    surface = mesh.trimesh
    start = region.position + np.outer([0.5, -0.5], opening * closing)
    face = surface.ray.intersects_first(start, np.array([-closing, closing]))
    assert (face >= 0).all()
    normals = surface.face_normals[face] * [[1.0], [-1.0]]
    assert (normals @ closing).min() > np.cos(np.arctan(FRICTION)) - 1e-6
