"""Overlays on parts in the scene: balls on connection points, frames of these points, and grasp regions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from scipy.spatial import ConvexHull
from viser import ArrowsHandle, BatchedMeshHandle, LineSegmentsHandle, SceneApi

from roboassembly.furniture.model import Furniture, GraspRegion
from roboassembly.rendering.colors import MOVING, WAITING, Color, to_bytes
from roboassembly.robots.gripper import hand_pose

PointId = tuple[int, int]
"""Part, and connection point of that part."""
ChosenPoints = tuple[PointId | None, PointId | None]
"""Chosen point of the moving part and of the waiting part."""
_BALL_COLOR: Color = (0.16, 0.32, 0.62)
_BALL_RADIUS, _CHOSEN_RADIUS = 0.007, 0.012
"""Radii of the balls [m]."""
_PIN, _LONGEST_PIN = 0.012, 0.06
"""Distance [m] of a ball from the hull of its part along the point's normal, and largest distance from the point. The
ball must be visible: points lie in the middle of a contact, often inside a tenon or at the bottom of a mortise."""
_AXIS = 0.04
"""Length of the axes of a frame [m]."""
_FINGER, _APPROACH = 0.03, 0.06
"""Lengths of the lines for a finger and for the approach of a hand [m]."""
_ARROW = 0.16
"""Length of the arrow that shows which way is up [m]."""
_AXES = np.array([[220, 60, 50], [60, 160, 70], [50, 100, 210]], np.uint8)
_GRASP = np.array([150, 60, 160], np.uint8)
_SPHERE: trimesh.Trimesh = trimesh.creation.icosphere(subdivisions=2, radius=1.0)


@dataclass(eq=False)
class Overlays:
    """Overlays on the parts of a piece. They are children of the parts' meshes and move with them.

    Args:
        scene: scene of one client.
        furniture: furniture that is shown.
        names: name of each part's mesh in the scene.
        enlarged: factor on the size of the balls.
    """

    scene: SceneApi
    furniture: Furniture
    names: Sequence[str]
    enlarged: float = 1.0
    centers: Float[np.ndarray, "parts K 3"] = field(init=False)
    """Centre of each ball in its part's frame [m]."""
    radii: Float[np.ndarray, "parts K"] = field(init=False)
    """Radius of each ball [m]; 0 if it is hidden."""
    _balls: list[BatchedMeshHandle] = field(default_factory=list[BatchedMeshHandle], init=False)
    _pins: list[LineSegmentsHandle] = field(default_factory=list[LineSegmentsHandle], init=False)
    _frames: list[LineSegmentsHandle] = field(default_factory=list[LineSegmentsHandle], init=False)
    _grasps: list[LineSegmentsHandle] = field(default_factory=list[LineSegmentsHandle], init=False)
    _choices: list[LineSegmentsHandle | ArrowsHandle] = field(
        default_factory=list[LineSegmentsHandle | ArrowsHandle], init=False
    )
    _shown: tuple[Bool[np.ndarray, "P K"], ChosenPoints] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.centers = np.zeros((len(self.names), 0, 3))
        self.radii = np.zeros((len(self.names), 0))

    def draw(
        self,
        points: Float[np.ndarray, "P K 9"],
        free: Bool[np.ndarray, "P K"],
        frames: bool,
        grasps: Sequence[Sequence[GraspRegion]],
    ) -> None:
        """Replace all overlays.

        Args:
            points: position [m], normal and tangent of each connection point in its part's frame.
            free: whether each point is free.
            frames: whether to draw the frames of the points.
            grasps: grasp regions of each part; empty to draw none.
        """
        self.clear()
        self.centers = np.stack([self._ball_centers(part, points[part]) for part in range(len(self.names))])
        for part, (name, centers) in enumerate(zip(self.names, self.centers, strict=True)):
            self._balls.append(self._add_balls(name, centers))
            self._pins.append(self._add_pins(name, points[part, :, :3], centers))
            if frames and free[part].any():
                self._frames.append(self._add_frames(name, points[part][free[part]]))
            if grasps and grasps[part]:
                self._grasps.append(self._add_grasps(name, grasps[part]))

    def show(self, free: Bool[np.ndarray, "P K"], chosen: ChosenPoints) -> None:
        """Show the free points, and highlight the chosen ones."""
        if self._shown is not None and self._shown[1] == chosen and np.array_equal(self._shown[0], free):
            return
        self._shown = free, chosen
        radii = np.zeros(self.centers.shape[:2])
        for part, (handle, pins) in enumerate(zip(self._balls, self._pins, strict=True)):
            pins.visible = bool(free[part].any())
            sizes = np.where(free[part], self.enlarged * _BALL_RADIUS, 0.0)
            colors = np.tile(np.array(to_bytes(_BALL_COLOR), np.uint8), (len(sizes), 1))
            for end, color in zip(chosen, (MOVING, WAITING), strict=True):
                if end is not None and end[0] == part:
                    sizes[end[1]], colors[end[1]] = self.enlarged * _CHOSEN_RADIUS, to_bytes(color)
            handle.batched_scales = sizes.astype(np.float32)
            handle.batched_colors = colors
            radii[part] = sizes
        self.radii = radii

    def show_up_axis(self, part: int, up: Float[np.ndarray, "3"]) -> None:
        """Show which way is up while a part waits, with an arrow on it.

        Args:
            part: part that waits.
            up: the direction in the part's frame, a unit vector.
        """
        hull = self.furniture.parts[part].mesh.hull_vertices
        middle = 0.5 * (hull.min(axis=0) + hull.max(axis=0))
        start = middle + up * max(0.0, float((hull @ up).max() - middle @ up) + 0.01)
        arrow = np.array([[start, start + _ARROW * up]], np.float32)
        name = f"/{self.names[part]}/up"
        self._choices.append(
            self.scene.add_arrows(
                name, arrow, to_bytes(WAITING), shaft_radius=0.006, head_radius=0.018, head_length=0.045
            )
        )

    def show_grasp(self, part: int, region: GraspRegion, direction: int) -> None:
        """Show how a hand holds a part, with lines for the fingers.

        Args:
            part: part that is held.
            region: place of the fingers.
            direction: index of the direction that the hand comes from.
        """
        lines = _hand_lines(region, region.approaches[direction])
        self._choices.append(
            self._add_lines(f"/{self.names[part]}/grasp", np.array(lines), np.tile(_GRASP, (len(lines), 2, 1)), 5.0)
        )

    def clear_choices(self) -> None:
        """Remove the arrow and the lines of the chosen action."""
        for handle in self._choices:
            handle.remove()
        self._choices = []

    def clear(self) -> None:
        """Remove all overlays."""
        self.clear_choices()
        for handle in (*self._balls, *self._pins, *self._frames, *self._grasps):
            handle.remove()
        self._balls, self._pins, self._frames, self._grasps = [], [], [], []
        self.radii = np.zeros_like(self.radii)
        self._shown = None

    def _ball_centers(self, part: int, rows: Float[np.ndarray, "10 9"]) -> Float[np.ndarray, "K 3"]:
        """Return the centres of a part's balls in its frame [m]."""
        position, normal = rows[:, :3], rows[:, 3:6]
        planes = ConvexHull(self.furniture.parts[part].mesh.hull_vertices).equations
        toward = normal @ planes[:, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            exits = np.where(toward > 1e-6, -(position @ planes[:, :3].T + planes[:, 3]) / toward, np.inf)
        return position + np.clip(exits.min(axis=1) + _PIN, _PIN, _LONGEST_PIN)[:, None] * normal

    def _add_pins(
        self, name: str, points: Float[np.ndarray, "K 3"], centers: Float[np.ndarray, "K 3"]
    ) -> LineSegmentsHandle:
        return self._add_lines(
            f"/{name}/pins", np.stack([points, centers], axis=1), np.tile(to_bytes(_BALL_COLOR), (len(points), 2, 1))
        )

    def _add_balls(self, name: str, positions: Float[np.ndarray, "K 3"]) -> BatchedMeshHandle:
        return self.scene.add_batched_meshes_simple(
            f"/{name}/points",
            _SPHERE.vertices.astype(np.float32),
            _SPHERE.faces.astype(np.uint32),
            batched_wxyzs=np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (len(positions), 1)),
            batched_positions=positions.astype(np.float32),
            batched_scales=np.zeros(len(positions), np.float32),
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )

    def _add_frames(self, name: str, rows: Float[np.ndarray, "n 9"]) -> LineSegmentsHandle:
        position, normal, tangent = rows[:, :3], rows[:, 3:6], rows[:, 6:]
        axes = np.stack([tangent, np.cross(normal, tangent), normal], axis=1)
        lines = np.stack([np.repeat(position[:, None], 3, 1), position[:, None] + _AXIS * axes], axis=2)
        colors = np.tile(_AXES[None, :, None], (len(rows), 1, 2, 1)).reshape(-1, 2, 3)
        return self._add_lines(f"/{name}/frames", lines.reshape(-1, 2, 3), colors)

    def _add_grasps(self, name: str, grasps: Sequence[GraspRegion]) -> LineSegmentsHandle:
        lines = [line for grasp in grasps for approach in grasp.approaches for line in _hand_lines(grasp, approach)]
        colors = np.tile(_GRASP, (len(lines), 2, 1))
        return self._add_lines(f"/{name}/grasps", np.array(lines), colors)

    def _add_lines(
        self, name: str, lines: Float[np.ndarray, "n 2 3"], colors: np.ndarray, thickness: float = 2.0
    ) -> LineSegmentsHandle:
        return self.scene.add_line_segments(
            name, lines.astype(np.float32), colors, thickness=thickness, thickness_units="screen"
        )


def _hand_lines(grasp: GraspRegion, approach: Float[np.ndarray, "3"]) -> list[list[Float[np.ndarray, "3"]]]:
    """Return lines for the two fingers, the palm and the approach of a hand."""
    hand = hand_pose(grasp.position, grasp.closing, approach)
    pads = [grasp.position + side * 0.5 * grasp.width * hand.rotation[:, 1] for side in (-1.0, 1.0)]
    return [
        *([pad, pad - _FINGER * approach] for pad in pads),
        [grasp.position - _FINGER * approach, grasp.position - _APPROACH * approach],
        [pad - _FINGER * approach for pad in pads],
    ]
