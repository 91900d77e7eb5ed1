"""Shapes of a mobile Franka and the links that carry them, for planning, physics and rendering."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pinocchio as pin
import trimesh
from jaxtyping import Float

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, transform_points, turn_about_vertical
from roboassembly.robots.gripper import hand_bodies, panda_folder, shape_corners
from roboassembly.robots.kinematics import JOINTS, arm
from roboassembly.robots.platform import CLEARANCE, HEIGHT, LENGTH, PLATFORM_FROM_MOUNT, WIDTH

PLATFORM, HAND = 0, JOINTS
"""Indices of carriers: 0 is the platform, 1 to 7 are the joints; the hand is fixed to the last joint."""
DOF = 3 + JOINTS


@dataclass(frozen=True, eq=False)
class Link:
    """Convex shape and its carrier."""

    name: str
    carrier: int
    """Index of the carrier: 0 for the platform, 1 to 7 for the joint that turns the link."""
    mesh: Mesh
    """Mesh in the carrier's frame."""


@cache
def links() -> tuple[Link, ...]:
    """Return platform and arm, without the hand, as convex hulls of the URDF's collision meshes."""
    box = trimesh.creation.box((LENGTH, WIDTH, HEIGHT - CLEARANCE))
    box.apply_translation([0.0, 0.0, 0.5 * (HEIGHT + CLEARANCE)])
    out = [Link("platform", PLATFORM, Mesh.from_trimesh(box))]
    folder = panda_folder()
    urdf = str(folder / "urdf/panda.urdf")
    model = pin.buildModelFromUrdf(urdf)
    geometry = pin.buildGeomFromUrdf(
        model, urdf, pin.GeometryType.COLLISION, package_dirs=[str(folder.parent.parent.parent)]
    )
    for shape in geometry.geometryObjects:
        name = model.frames[shape.parentFrame].name
        if name.startswith("panda_link"):
            carrier = shape.parentJoint
            placement = shape.placement if carrier else PLATFORM_FROM_MOUNT * shape.placement
            hull = trimesh.convex.convex_hull(transform_points(placement, shape_corners(shape.geometry)))
            out.append(Link(name.removeprefix("panda_"), carrier, Mesh.from_trimesh(hull)))
    return tuple(out)


def joint_placements() -> list[SE3]:
    """Return the placement of each joint of the arm on its carrier, the first one's on the platform, at angle zero."""
    chain = arm().placements
    first, *rest = (SE3(r, t) for r, t in zip(chain.rotation, chain.translation, strict=True))
    return [PLATFORM_FROM_MOUNT * first, *rest]


def hand_links(opening: float) -> tuple[tuple[Link, SE3], ...]:
    """Return palm and fingers, each with its `last_joint_from_mesh`, the pads `opening` metres apart."""
    tips = SE3(*arm().tips)
    return tuple(
        (Link(name, HAND, mesh), tips * pose)
        for name, (mesh, pose) in zip(("palm", "left_finger", "right_finger"), hand_bodies(opening), strict=True)
    )


def placed(configuration: Float[np.ndarray, "10"], opening: float) -> list[tuple[Link, SE3]]:
    """Return every link with its `world_from_mesh`."""
    carriers = carrier_poses(configuration)
    out = [(link, carriers[link.carrier]) for link in links()]
    return out + [(link, carriers[HAND] * pose) for link, pose in hand_links(opening)]


def carrier_poses(configuration: Float[np.ndarray, "10"]) -> list[SE3]:
    """Return the pose `world_from_carrier` of the platform and of each joint of the arm."""
    rotations, origins = arm().frames(configuration[None, 3:])
    platform = world_from_platform(configuration)
    mount = platform * PLATFORM_FROM_MOUNT
    return [platform, *(mount * SE3(r, t) for r, t in zip(rotations[0], origins[0], strict=True))]


def world_from_platform(configuration: Float[np.ndarray, "10"]) -> SE3:
    """Return the pose `world_from_platform` of a configuration."""
    x, y, angle = configuration[:3]
    return SE3(turn_about_vertical(angle), np.array([x, y, 0.0]))


def tip_positions(configurations: Float[np.ndarray, "n 10"]) -> Float[np.ndarray, "n 3"]:
    """Return the positions of the finger tips in many configurations [m]."""
    local = arm().poses(configurations[:, 3:]).translation + PLATFORM_FROM_MOUNT.translation
    cosine, sine = np.cos(configurations[:, 2]), np.sin(configurations[:, 2])
    x, y, z = local.T
    return np.stack(
        [configurations[:, 0] + cosine * x - sine * y, configurations[:, 1] + sine * x + cosine * y, z], axis=1
    )


def world_from_tips(configuration: Float[np.ndarray, "10"]) -> SE3:
    """Return the pose `world_from_tips` of a configuration."""
    tips = arm().poses(configuration[None, 3:])
    mount = world_from_platform(configuration) * PLATFORM_FROM_MOUNT
    return mount * SE3(tips.rotation[0], tips.translation[0])
