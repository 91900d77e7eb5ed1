"""Shapes that a mobile Franka is drawn with: the URDF's visual meshes with fewer faces, and a platform on four wheels.

They are for pictures alone; plans are checked with the convex shapes of `body`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import fast_simplification
import numpy as np
import pinocchio as pin
import trimesh
from jaxtyping import Float

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, transform_points
from roboassembly.robots.body import HAND, PLATFORM, carrier_poses
from roboassembly.robots.gripper import TIPS, hand_bodies, panda_folder
from roboassembly.robots.kinematics import JOINTS, arm
from roboassembly.robots.platform import HEIGHT, LENGTH, PLATFORM_FROM_MOUNT, WIDTH

KEPT = 0.05
"""Share of a mesh's faces that is kept; the Panda's have 134,000, which films do not show."""
FEWEST = 350
"""Number of faces that is kept of a mesh in any case."""
_DARK = 0.5
"""Brightness of a material below which it does not have the robot's colour."""


@dataclass(frozen=True, eq=False)
class VisualLink:
    """Shape that is drawn, all of one colour."""

    name: str
    carrier: int
    """Index of the carrier, as of `body.Link`."""
    finger: int | None
    """Finger that it belongs to, 0 or 1; it moves as the hand opens."""
    mesh: Mesh
    """Mesh in the carrier's frame; that of a finger in the frame between the tips, of the closed hand."""
    dark: bool
    """Whether it is dark, as joints and wheels are, rather than of the robot's colour."""


@cache
def visual_links() -> tuple[VisualLink, ...]:
    """Return the shapes of a robot: platform, arm, palm and fingers.

    Raises:
        MissingRobotError: the Panda is not installed.
    """
    model = pin.buildModelFromUrdf(str(panda_folder() / "urdf/panda.urdf"))
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    last = data.oMi[JOINTS]
    out = [VisualLink(name, PLATFORM, None, mesh, dark) for name, mesh, dark in _platform()]
    for k in range(JOINTS + 1):
        pose = SE3.Identity() if k else PLATFORM_FROM_MOUNT
        out += [VisualLink(name, k, None, mesh, dark) for name, mesh, dark in _shapes(f"link{k}", pose)]
    hand = last.actInv(data.oMf[model.getFrameId("panda_hand")])
    out += [VisualLink(name, HAND, None, mesh, dark) for name, mesh, dark in _shapes("hand", hand)]
    for finger, frame in enumerate(("panda_leftfinger", "panda_rightfinger")):
        # The file describes the left finger; the right one is the same shape, rotated.
        turn = SE3(np.diag([1.0, 1.0, 1.0] if finger == 0 else [-1.0, -1.0, 1.0]), np.zeros(3))
        pose = data.oMf[model.getFrameId(TIPS)].actInv(data.oMf[model.getFrameId(frame)]) * turn
        out += [VisualLink(name, HAND, finger, mesh, dark) for name, mesh, dark in _shapes("finger", pose)]
    return tuple(out)


def visual_poses(configuration: Float[np.ndarray, "10"], opening: float) -> list[SE3]:
    """Return `world_from_mesh` of each of `visual_links`.

    Args:
        configuration: place and heading of the platform, then the angles of the arm.
        opening: distance between the pads of the fingers [m].
    """
    carriers = carrier_poses(configuration)
    tips = carriers[HAND] * SE3(*arm().tips)
    fingers = [tips * pose for _, pose in hand_bodies(opening)[1:]]
    return [carriers[link.carrier] if link.finger is None else fingers[link.finger] for link in visual_links()]


def _shapes(name: str, pose: SE3) -> list[tuple[str, Mesh, bool]]:
    """Return the light and the dark faces of one of the Panda's visual meshes, placed."""
    scene = trimesh.load_scene(panda_folder() / "meshes/visual" / f"{name}.dae")
    out: list[tuple[str, Mesh, bool]] = []
    for dark in (False, True):
        pieces = [piece for piece in scene.dump() if (_brightness(piece) < _DARK) == dark]
        if pieces:
            whole = _together(pieces)
            whole.merge_vertices()
            vertices, faces = whole.vertices, whole.faces
            kept = max(FEWEST, round(KEPT * len(faces)))
            if kept < len(faces):
                vertices, faces = fast_simplification.simplify(vertices, faces, target_count=kept)
            mesh = Mesh(transform_points(pose, np.array(vertices, float)), np.array(faces))
            out.append((f"{name}_dark" if dark else name, mesh, dark))
    return out


def _together(pieces: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Return one mesh of several."""
    firsts = np.cumsum([0, *(len(piece.vertices) for piece in pieces[:-1])])
    faces = [piece.faces + first for piece, first in zip(pieces, firsts, strict=True)]
    return trimesh.Trimesh(np.concatenate([piece.vertices for piece in pieces]), np.concatenate(faces), process=False)


def _brightness(piece: trimesh.Trimesh) -> float:
    material: Any = getattr(piece.visual, "material", None)
    if material is None:
        return 1.0
    color = np.asarray(material.main_color, float)
    return float(color[:3].mean()) / 255.0


def _platform() -> list[tuple[str, Mesh, bool]]:
    """Return the platform's shell, its dark parts and its wheels, within the box that plans are checked with."""
    half, side = 0.5 * LENGTH, 0.5 * WIDTH
    shell = _chamfered((-half + 0.006, half - 0.006), (-side + 0.004, side - 0.004), (0.115, HEIGHT - 0.014), 0.028)
    chassis = _chamfered((-half + 0.03, half - 0.03), (-0.155, 0.155), (0.045, 0.125), 0.01)
    deck = _chamfered((-half + 0.045, half - 0.045), (-side + 0.045, side - 0.045), (HEIGHT - 0.02, HEIGHT), 0.006)
    bands = [_chamfered((x, x + 0.012), (-0.15, 0.15), (0.24, 0.30), 0.003) for x in (-half, half - 0.012)]
    wheels = [
        _wheel(np.array([x, y, 0.08])) for x in (-half + 0.105, half - 0.105) for y in (-side + 0.032, side - 0.032)
    ]
    dark = _together([chassis, deck, *bands, *wheels])
    return [("platform", Mesh.from_trimesh(shell), False), ("platform_dark", Mesh.from_trimesh(dark), True)]


def _wheel(middle: Float[np.ndarray, "3"]) -> trimesh.Trimesh:
    wheel = _together([trimesh.creation.cylinder(0.08, 0.05, 40), trimesh.creation.cylinder(0.045, 0.06, 24)])
    # Cylinders stand upright; an axle lies along y.
    wheel.apply_transform([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    wheel.apply_translation(middle)
    return wheel


def _chamfered(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float], edge: float) -> trimesh.Trimesh:
    """Return a box with bevelled edges."""
    corners: list[tuple[float, float, float]] = []
    for i in (0, 1):
        for j in (0, 1):
            for k in (0, 1):
                at, inward = (x[i], y[j], z[k]), (edge * (1 - 2 * i), edge * (1 - 2 * j), edge * (1 - 2 * k))
                for axis in range(3):
                    moved = [a + d * (other != axis) for other, (a, d) in enumerate(zip(at, inward, strict=True))]
                    corners.append((moved[0], moved[1], moved[2]))
    return trimesh.convex.convex_hull(np.array(corners))
