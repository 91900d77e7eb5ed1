"""Drawing functions that the scripts for pictures share."""

from collections.abc import Iterable, Sequence

import numpy as np

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3
from roboassembly.rendering.camera import box_corners
from roboassembly.rendering.colors import Color
from roboassembly.robots.gripper import hand_bodies
from roboassembly.viewer.film import render_meshes

Piece = tuple[Mesh, SE3, Color]
PALM, FINGER = (0.86, 0.88, 0.90), (0.25, 0.28, 0.32)


def drawn(pieces: Sequence[Piece], width: int, height: int) -> np.ndarray:
    """Draw meshes above the ground, from where all of them are visible."""
    points = np.concatenate([box_corners(mesh, pose) for mesh, pose, _ in pieces])
    lift = SE3(np.eye(3), np.array([0.0, 0.0, 0.03 - min(points[:, 2].min(), 0.03)]))
    meshes, poses, colors = zip(*pieces, strict=True)
    return render_meshes(meshes, [lift * pose for pose in poses], colors, width, height)


def hand(tips: SE3, width: float) -> Iterable[Piece]:
    """Return the pieces of a hand at the frame of its tips, with the given distance between the pads [m]."""
    for color, (mesh, tips_from_body) in zip((PALM, FINGER, FINGER), hand_bodies(width), strict=True):
        yield mesh, tips * tips_from_body, color
