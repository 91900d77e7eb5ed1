"""Observations: the paper's state as arrays of fixed shape (geometry, points, grasps, poses, connections).

| key | shape | meaning | unit |
|---|---|---|---|
| `shapes` | (P, C, 3) | points on each part's surface, part frame | m |
| `connection_points` | (P, K, 9) | position, outward normal, tangent, part frame | m, 1, 1 |
| `grasp_regions` | (P, 2, 4, 6) | hand in four directions, part frame: translation, Euler angles | m, rad |
| `poses` | (P, 6) | world pose of each part: translation and Euler angles | m, rad |
| `connections` | (P, P, 6) | connection tensor: pose of part j in part i's frame in one group, else 0 | m, rad |

P, K and C are `max_parts`, `max_points` and `cloud_points`. Rows of missing parts, points and
grasp regions are 0. A hand's frame lies between the finger tips: z along the approach, y
along the fingers' closing. Region i and direction j are grasp 4i + j.
Euler angles are roll, pitch and yaw with `R = Rz(yaw) Ry(pitch) Rx(roll)`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
import trimesh
from jaxtyping import Float, Float32

from roboassembly.errors import ArgumentError
from roboassembly.furniture.jaws import APPROACHES
from roboassembly.furniture.model import GRASP_REGIONS, ConnectionPoint, Furniture
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, euler_from_rotations, pose_to_euler, rotations_and_translations
from roboassembly.robots.gripper import hand_pose
from roboassembly.task.part_frames import FramesName, PartFrames
from roboassembly.task.rules.groups import TaskState, part_from_points

if TYPE_CHECKING:
    from gymnasium import spaces

REACH = 100.0
"""Bound of every coordinate in the observation space [m]."""

CloudsName = Literal["shared", "resampled"]
_FRAMES, _CLOUDS = get_args(FramesName), get_args(CloudsName)
_LARGEST_NOISE = 0.1
"""Largest noise that is accepted [m]."""
Observation = dict[str, Float32[np.ndarray, "..."]]


def observation_space(max_parts: int, max_points: int, cloud_points: int) -> spaces.Dict:
    """Return the observation space of the table above."""
    from gymnasium import spaces  # Policies make observations without it.

    pose = np.array([REACH] * 3 + [np.pi] * 3)

    def box(high: np.ndarray) -> spaces.Box:
        # Rounding to 32 bits may carry an angle of pi just past a bound of pi.
        high = np.nextafter(high.astype(np.float32), np.float32(np.inf))
        return spaces.Box(-high, high, dtype=np.float32)

    return spaces.Dict(
        {
            "shapes": box(np.full((max_parts, cloud_points, 3), REACH)),
            "connection_points": box(np.tile([REACH] * 3 + [1.0] * 6, (max_parts, max_points, 1))),
            "grasp_regions": box(np.tile(pose, (max_parts, GRASP_REGIONS, APPROACHES, 1))),
            "poses": box(np.tile(pose, (max_parts, 1))),
            "connections": box(np.tile(pose, (max_parts, max_parts, 1))),
        }
    )


@dataclass(frozen=True)
class ObservationConfig:
    """Configuration of observations; the default is as in the paper."""

    frames: FramesName = "aligned"
    """`aligned`: part frames are parallel to the furniture's. `own`: they are the principal axes of each part, in an
    order and with signs drawn for each episode, and `w` names axes of v's part."""
    clouds: CloudsName = "shared"
    """`shared`: parts of one shape have the same cloud. `resampled`: each part has points of its own, drawn for each
    episode."""
    noise: float = 0.0
    """Standard deviation of each coordinate of the clouds [m]."""

    def __post_init__(self) -> None:
        for name, value, known in (("frames", self.frames, _FRAMES), ("clouds", self.clouds, _CLOUDS)):
            if value not in known:
                raise ArgumentError(f"{name} is {value!r}; expected {' or '.join(map(repr, known))}")
        if not 0.0 <= self.noise <= _LARGEST_NOISE:
            raise ArgumentError(f"noise is {self.noise} m; expected 0 to {_LARGEST_NOISE}")

    @property
    def is_default(self) -> bool:
        """Whether observations are as in the paper; then they draw nothing."""
        return self == AS_IN_PAPER


AS_IN_PAPER = ObservationConfig()
"""The paper's observations."""


class Observer:
    """Makes observations of one piece of furniture; constant arrays are computed once.

    Args:
        furniture: the piece.
        max_parts: padding P.
        max_points: padding K.
        cloud_points: points C of each cloud.
        config: configuration of the observations.
        rng: draws own frames, resampled clouds and noise; not used by the default `config`.
    """

    def __init__(
        self, furniture: Furniture, max_parts: int, max_points: int, cloud_points: int,
        config: ObservationConfig = AS_IN_PAPER, rng: np.random.Generator | None = None,
    ) -> None:  # fmt: skip
        rng = rng or np.random.default_rng(0)
        self.frames = PartFrames.draw(config.frames, furniture, rng)
        """Frames in which the parts are described."""
        self._own_from_part = self.frames.part_from_own.transpose(0, 2, 1)
        # Aligned poses stay as they are: Euler angles depend on the signs of zeros.
        aligned = config.frames == "aligned"
        self._part_from_own = None if aligned else [SE3(turn, np.zeros(3)) for turn in self.frames.part_from_own]
        self._parts = len(furniture.parts)
        self._shapes = np.zeros((max_parts, cloud_points, 3), np.float32)
        self._furniture = furniture
        self._points = np.zeros((max_parts, max_points, 9), np.float32)
        self._grasps = np.zeros((max_parts, GRASP_REGIONS, APPROACHES, 6), np.float32)
        self._max_parts = max_parts
        shared = part_clouds(furniture, cloud_points) if config.clouds == "shared" else None
        for p, part in enumerate(furniture.parts):
            cloud = surface_points(part.mesh, cloud_points, rng) if shared is None else shared[p]
            if config.noise:
                cloud = cloud + rng.normal(0.0, config.noise, cloud.shape)
            self._shapes[p] = cloud @ self.frames.part_from_own[p]
            self._points[p, : len(part.points)] = _point_rows(part.points, self._own_from_part[p])
            for g, grasp in enumerate(part.grasps[:GRASP_REGIONS]):
                hand_poses = [hand_pose(grasp.position, grasp.closing, approach) for approach in grasp.approaches]
                if self._part_from_own is not None:
                    hand_poses = [self._part_from_own[p].actInv(hand) for hand in hand_poses]
                self._grasps[p, g] = [pose_to_euler(hand) for hand in hand_poses]

    def _described(self, parts: Iterable[int], poses: Sequence[SE3]) -> Sequence[SE3]:
        """Return the poses of the frames in which parts are described, from those of their frames in `Furniture`."""
        frames = self._part_from_own
        return poses if frames is None else [pose * frames[p] for p, pose in zip(parts, poses, strict=True)]

    @property
    def meshes(self) -> tuple[Mesh, ...]:
        """Mesh of each part in the frame in which it is described."""
        parts = self._furniture.parts
        if self._part_from_own is None:
            return tuple(part.mesh for part in parts)
        # Equal parts keep one mesh each, so that what is computed from it is computed once.
        turned = {id(p.mesh): p.mesh.stretched(turn) for p, turn in zip(parts, self._own_from_part, strict=True)}
        return tuple(turned[id(part.mesh)] for part in parts)

    @property
    def grasp_poses(self) -> Float32[np.ndarray, "P 8 6"]:
        """Grasps of each part in one axis, as in `grasp_regions`; 0 in furniture without grasps."""
        return self._grasps.reshape(self._max_parts, -1, 6).copy()

    def observe(self, state: TaskState) -> Observation:
        """Return the observation of a state in new arrays."""
        poses = np.zeros((self._max_parts, 6), np.float32)
        turns, positions = rotations_and_translations(self._described(range(self._parts), state.part_poses))
        poses[: self._parts] = np.concatenate([positions, euler_from_rotations(turns)], axis=1)
        points = self._points.copy()
        connections = np.zeros((self._max_parts, self._max_parts, 6), np.float32)
        for group in state.groups:
            if len(group.parts) == 1:
                continue
            for part in group.parts:
                turn = part_from_points(self._furniture, group, part).rotation
                rows = _point_rows(group.points_of(self._furniture, part), self._own_from_part[part] @ turn)
                points[part] = 0.0
                points[part, : len(rows)] = rows
            turns, positions = rotations_and_translations(self._described(group.parts, group.furniture_from_part))
            back = turns.transpose(0, 2, 1)[:, None]
            offsets = (back @ (positions[None] - positions[:, None])[..., None])[..., 0]
            relative = np.concatenate([offsets, euler_from_rotations(back @ turns[None])], axis=-1)
            members = np.array(group.parts)
            connections[members[:, None], members] = relative
            connections[members, members] = 0.0
        return {
            "shapes": self._shapes.copy(),
            "connection_points": points,
            "grasp_regions": self._grasps.copy(),
            "poses": poses,
            "connections": connections,
        }


def _point_rows(points: Sequence[ConnectionPoint], turn: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "k 9"]:
    """Return position, normal and tangent of each point, rotated by `turn`."""
    rows = np.array([[p.position, p.normal, p.tangent] for p in points]).reshape(-1, 3, 3)
    return (rows @ turn.T).reshape(-1, 9)


def part_clouds(furniture: Furniture, count: int) -> Float32[np.ndarray, "P count 3"]:
    """Return points on the surface of each part, in its frame; parts of one class have those of its first member.

    Args:
        furniture: the piece.
        count: number of points of each part.
    """
    first = [furniture.classes[c].members[0] for c in furniture.class_of]
    clouds = {i: surface_points(furniture.parts[i].mesh, count) for i in dict.fromkeys(first)}
    return np.array([clouds[i] for i in first], np.float32)


def surface_points(mesh: Mesh, count: int, rng: np.random.Generator | None = None) -> Float32[np.ndarray, "count 3"]:
    """Return points sampled on the surface by area.

    Args:
        mesh: the surface.
        count: number of points.
        rng: draws the points; the same mesh gives the same points if None.
    """
    seed = rng or np.random.default_rng(int(mesh.content_hash, 16))
    return np.asarray(trimesh.sample.sample_surface(mesh.trimesh, count, seed=seed)[0], dtype=np.float32)
