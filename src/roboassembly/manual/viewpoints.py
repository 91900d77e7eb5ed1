"""Choice of the side from which a step is drawn: the one that shows its joints and its parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from roboassembly.furniture.model import Furniture
from roboassembly.furniture.rays import Rays
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, transform_points
from roboassembly.geometry.triangles import areas
from roboassembly.manual.line_drawing import Figure, Projection
from roboassembly.manual.steps import ManualStep
from roboassembly.task.rules.connections import UP_AXES

_AZIMUTHS = np.deg2rad([300.0, 240.0, 330.0, 210.0, 60.0, 120.0, 30.0, 150.0])
"""Directions around the vertical, the front of the furniture first."""
_ELEVATIONS = np.deg2rad([25.0, 40.0])
_LIFT = 0.002
"""Distance of tested points from the surfaces on which they lie [m]."""
_SAMPLES = 16
"""Number of points of a part that are tested."""
_JOINT, _PART, _ARROW, _SAME, _FRONT = 2.0, 1.0, 1.0, 0.4, 0.05
"""Weights of what a view shows: joints, parts, lengths of arrows, the view of the step before, and the front."""


def cameras(up: int) -> list[Projection]:
    """Return the cameras from which a piece may be drawn, the front first.

    Args:
        up: index of the axis that points up, of `UP_AXES`.
    """
    vertical = UP_AXES[up]
    e1, e2 = np.delete(np.eye(3), int(np.argmax(np.abs(vertical))), axis=0)
    out: list[Projection] = []
    for elevation in _ELEVATIONS:
        for azimuth in _AZIMUTHS:
            level = np.cos(azimuth) * e1 + np.sin(azimuth) * e2
            out.append(Projection.looking(np.cos(elevation) * level + np.sin(elevation) * vertical, vertical))
    return out


@dataclass(frozen=True, eq=False)
class Sight:
    """Figures as obstacles of sight."""

    rays: Rays

    @classmethod
    def past(cls, figures: Sequence[Figure]) -> Sight:
        """Return the obstacles that figures are."""
        vertices = [transform_points(f.pose, f.mesh.vertices) for f in figures]
        offsets = np.cumsum([0, *map(len, vertices[:-1])])
        faces = [f.mesh.faces + offset for f, offset in zip(figures, offsets, strict=True)]
        return cls(Rays(Mesh(np.concatenate(vertices), np.concatenate(faces))))

    def sees(self, points: Float[np.ndarray, "n 3"], toward: Float[np.ndarray, "3"]) -> Bool[np.ndarray, "n"]:
        """Return which points nothing hides from a far viewer."""
        directions = np.repeat(toward[None], len(points), axis=0)
        reach, _ = self.rays.first_hits(points + _LIFT * toward, directions)
        return ~np.isfinite(reach)


def surface_points(mesh: Mesh, pose: SE3) -> Float[np.ndarray, "n 3"]:
    """Return some points spread over a mesh's surface [m]."""
    corners = mesh.vertices[mesh.faces]
    area = areas(corners)
    places: Float[np.ndarray, "n"] = (np.arange(_SAMPLES) + 0.5) / _SAMPLES * area.sum()
    chosen: Int[np.ndarray, "n"] = np.searchsorted(np.cumsum(area), places).clip(max=len(area) - 1)
    return transform_points(pose, corners[chosen].mean(axis=1))


@dataclass(frozen=True, eq=False)
class JointSpot:
    """Connection of a part that comes to one that is there, where it is drawn."""

    mover: int
    """Index of the mover in its step."""
    part: int
    other: int
    """Part that is there."""
    place: Float[np.ndarray, "3"]
    """Middle of the contact [m]."""


def joint_spots(furniture: Furniture, step: ManualStep) -> list[JointSpot]:
    """Return the connections that a step makes to what is there."""
    out: list[JointSpot] = []
    for c in furniture.connections:
        ends = ((c.part_a, c.point_a, c.part_b), (c.part_b, c.point_b, c.part_a))
        for part, point, other in ends:
            index = next((i for i, m in enumerate(step.movers) if part in m.parts), None)
            if index is None or other not in step.base:
                continue
            position = furniture.parts[part].points[point].position
            out.append(JointSpot(index, part, other, furniture.assembled[part].act(position)))
    return out


def step_figures(furniture: Furniture, step: ManualStep) -> list[Figure]:
    """Return the parts of a step where they are drawn."""
    out = [Figure(furniture.parts[p].mesh, furniture.assembled[p], p) for p in sorted(step.base)]
    for mover in step.movers:
        out += [Figure(furniture.parts[p].mesh, mover.away * furniture.assembled[p], p) for p in sorted(mover.parts)]
    for way in step.fasteners:
        fastener = furniture.fasteners[way.index]
        out.append(Figure(fastener.mesh, way.away * fastener.place, len(furniture.parts) + way.index))
    return out


def coming_keys(furniture: Furniture, step: ManualStep) -> set[int]:
    """Return the keys of the figures that come in a step: parts, and fasteners numbered after all parts."""
    parts = {p for mover in step.movers for p in mover.parts}
    return parts | {len(furniture.parts) + way.index for way in step.fasteners}


def step_camera(furniture: Furniture, step: ManualStep, before: Projection | None) -> Projection:
    """Return the camera that shows a step best.

    Args:
        furniture: whose step it is.
        step: what is drawn.
        before: camera of the step before, if the same side was up.
    """
    figures = step_figures(furniture, step)
    sight = Sight.past(figures)
    there: list[Float[np.ndarray, "3"]] = []
    directions: list[Float[np.ndarray, "3"]] = []
    for spot in joint_spots(furniture, step):
        away = step.movers[spot.mover].away.act(spot.place)
        way = away - spot.place
        length = max(1e-9, float(np.linalg.norm(way)))
        directions.append(way / length)
        there += [spot.place + s * way for s in (0.2, 0.5, 1.0 - 0.01 / length)]
    for way in step.fasteners:
        away, place = way.arrow(furniture)
        directions.append((away - place) / max(1e-9, float(np.linalg.norm(away - place))))
        there.append(away)
    moved = coming_keys(furniture, step)
    shapes = np.concatenate([surface_points(f.mesh, f.pose) for f in figures if f.key in moved])
    rest = np.concatenate([surface_points(f.mesh, f.pose) for f in figures])
    joints = np.array(there).reshape(-1, 3)

    def score(camera: Projection) -> float:
        value = _PART * (2.0 * sight.sees(shapes, camera.toward).mean() + 0.5 * sight.sees(rest, camera.toward).mean())
        if len(joints):
            along = np.abs(np.array(directions) @ camera.toward)
            value += _JOINT * float(sight.sees(joints, camera.toward).mean())
            value += _ARROW * float(np.sqrt(np.clip(1.0 - along**2, 0.0, 1.0)).mean())
        value += _FRONT * float(camera.toward[1] < 0.0)
        return float(value + _SAME * (before is not None and float(camera.toward @ before.toward) > 0.999))

    return max(cameras(step.up), key=score)


def best_camera(figures: Sequence[Figure], up: int) -> Projection:
    """Return the camera that shows most of some figures."""
    sight = Sight.past(figures)
    points = np.concatenate([surface_points(f.mesh, f.pose) for f in figures])
    return max(
        cameras(up),
        key=lambda camera: float(sight.sees(points, camera.toward).mean()) + _FRONT * float(camera.toward[1] < 0.0),
    )
