"""URDF of both robots in one world, for programs that show or control them: two platforms, each with a Panda."""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from roboassembly.geometry.poses import SE3, rotations_from_euler
from roboassembly.robots.gripper import panda_folder
from roboassembly.robots.kinematics import JOINTS
from roboassembly.robots.limits import DRIVE, TURN
from roboassembly.robots.platform import CLEARANCE, HEIGHT, LENGTH, MASS, PLATFORM_FROM_MOUNT, WIDTH

PREFIXES = ("a_", "b_")
"""Prefixes of the names of links and joints of R_a and R_b."""
WORLD = "world"
"""Name of the root link."""
JOINT_NAMES = (
    "x", "y", "turn", *(f"panda_joint{i + 1}" for i in range(JOINTS)), "panda_finger_joint1", "panda_finger_joint2",
)  # fmt: skip
"""Names of a robot's joints without the prefix: the platform, the arm, the fingers."""
_FARTHEST = "100"
"""Distance from the origin up to which platforms may drive, as text [m]."""


@dataclass(frozen=True, eq=False)
class DescribedJoint:
    """Joint of the URDF."""

    name: str
    parent: str
    """Name of the parent link."""
    child: str
    """Name of the child link."""
    origin: SE3
    """Pose of the child in the parent at value zero."""
    axis: Float[np.ndarray, "3"]
    kind: str
    """`fixed`, `prismatic`, `revolute` or `continuous`."""

    def pose(self, value: float) -> SE3:
        """Return the pose of the child in the parent at a value of the joint [m, rad]."""
        if self.kind == "fixed":
            return self.origin
        if self.kind == "prismatic":
            return self.origin * SE3(np.eye(3), value * self.axis)
        x, y, z = self.axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turn = np.eye(3) + np.sin(value) * cross + (1.0 - np.cos(value)) * cross @ cross
        return self.origin * SE3(turn, np.zeros(3))


@cache
def robots_urdf() -> str:
    """Return the URDF; its meshes are those of the `example-robot-data` package."""
    panda = ET.parse(panda_folder() / "urdf/panda.urdf").getroot()
    root = ET.Element("robot", name="two_mobile_pandas")
    ET.SubElement(root, "link", name=WORLD)
    seen: set[str] = set()
    for prefix in PREFIXES:
        _add_platform(root, prefix)
        for element in panda:
            if element.tag == "material" and element.get("name", "") not in seen:
                seen.add(element.get("name", ""))
                root.append(copy.deepcopy(element))
            if element.tag in ("link", "joint"):
                root.append(_prefixed(element, prefix))
        mount = ET.SubElement(root, "joint", name=f"{prefix}mount", type="fixed")
        ET.SubElement(mount, "parent", link=f"{prefix}platform")
        ET.SubElement(mount, "child", link=f"{prefix}{_root_link(panda)}")
        ET.SubElement(mount, "origin", xyz=" ".join(f"{x:.6g}" for x in PLATFORM_FROM_MOUNT.translation), rpy="0 0 0")
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


@cache
def described_joints() -> tuple[DescribedJoint, ...]:
    """Return all joints of the URDF, fixed ones included."""
    out: list[DescribedJoint] = []
    for joint in ET.fromstring(robots_urdf()).findall("joint"):
        origin, axis = joint.find("origin"), joint.find("axis")
        xyz, rpy = (_numbers(None if origin is None else origin.get(key)) for key in ("xyz", "rpy"))
        along = np.array([1.0, 0.0, 0.0]) if axis is None else _numbers(axis.get("xyz"))
        ends = [joint.find(end) for end in ("parent", "child")]
        parent, child = ("" if end is None else end.get("link", "") for end in ends)
        name, kind = joint.get("name", ""), joint.get("type", "")
        out.append(DescribedJoint(name, parent, child, SE3(rotations_from_euler(rpy), xyz), along, kind))
    return tuple(out)


def _add_platform(root: ET.Element, prefix: str) -> None:
    """Add links and joints of a platform that drives and turns on the floor."""
    parent = WORLD
    for name, kind, axis, limits in (
        ("x", "prismatic", "1 0 0", DRIVE), ("y", "prismatic", "0 1 0", DRIVE), ("turn", "continuous", "0 0 1", TURN),
    ):  # fmt: skip
        child = f"{prefix}platform" if name == "turn" else f"{prefix}{name}_slide"
        link = ET.SubElement(root, "link", name=child)
        if name == "turn":
            _add_box(link)
        joint = ET.SubElement(root, "joint", name=prefix + name, type=kind)
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=child)
        ET.SubElement(joint, "axis", xyz=axis)
        bounds = {} if kind == "continuous" else {"lower": f"-{_FARTHEST}", "upper": _FARTHEST}
        ET.SubElement(joint, "limit", bounds | {"effort": "1000", "velocity": f"{limits[0]:g}"})
        parent = child


def _add_box(link: ET.Element) -> None:
    size = np.array([LENGTH, WIDTH, HEIGHT - CLEARANCE])
    middle = f"0 0 {0.5 * (HEIGHT + CLEARANCE):g}"
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=middle, rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=f"{MASS:g}")
    diagonal = MASS / 12.0 * ((size**2).sum() - size**2)
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    ET.SubElement(inertial, "inertia", {n: f"{x:g}" for n, x in zip(names, (*diagonal, 0, 0, 0), strict=True)})
    for kind in ("visual", "collision"):
        shape = ET.SubElement(link, kind)
        ET.SubElement(shape, "origin", xyz=middle, rpy="0 0 0")
        ET.SubElement(ET.SubElement(shape, "geometry"), "box", size=" ".join(f"{x:g}" for x in size))


def _prefixed(element: ET.Element, prefix: str) -> ET.Element:
    """Return a copy of a link or joint with a prefix to its name and to those that it refers to."""
    out = copy.deepcopy(element)
    out.set("name", prefix + out.get("name", ""))
    for tag, key in (("parent", "link"), ("child", "link"), ("mimic", "joint")):
        for part in out.findall(tag):
            part.set(key, prefix + part.get(key, ""))
    return out


def _root_link(panda: ET.Element) -> str:
    children = {end.get("link") for end in panda.findall("joint/child")}
    return next(name for link in panda.findall("link") if (name := link.get("name", "")) not in children)


def _numbers(text: str | None) -> Float[np.ndarray, "3"]:
    return np.zeros(3) if text is None else np.array([float(x) for x in text.split()])
