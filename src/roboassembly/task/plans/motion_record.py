"""Motions of a plan of two robots, as its file has them: for whoever plays a plan without planning it again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from jaxtyping import Float

from roboassembly.errors import InputError
from roboassembly.geometry.poses import SE3, pose_from_seven
from roboassembly.robots.body import DOF
from roboassembly.robots.kinematics import arm
from roboassembly.task.full.failure import ROBOT_NAMES, Stage, stage_text
from roboassembly.task.plans import plan_file

_JUMP = 1e-6
"""Largest distance between the end of a motion and the beginning of the robot's next one [m, rad]."""
_LIMIT = 1e-6
"""Angle by which rounding may exceed a joint's limit [rad]."""


@dataclass(frozen=True, eq=False)
class MotionSegment:
    """A motion of one robot while all else stands still."""

    stage: Stage
    robot: int
    """0 is R_a, 1 is R_b."""
    opening: float
    """Distance between the pads of the robot's hand [m]."""
    path: Float[np.ndarray, "n 10"]
    """Way-points [m, rad]."""
    payload: dict[int, SE3]
    """Parts in the robot's hand, with their poses in the frame of the finger tips."""

    @property
    def name(self) -> str:
        """Robot and stage in words."""
        return stage_text(self.stage, self.robot)


@dataclass(frozen=True, eq=False)
class MotionRecord:
    """All motions of a plan, in their order."""

    furniture: str
    """Name of the furniture."""
    parts: tuple[str, ...]
    """Names of the parts."""
    density: float
    """Density of the parts [kg/m³]."""
    initial: tuple[SE3, ...]
    """Poses of all parts at first."""
    robots: tuple[Float[np.ndarray, "10"], Float[np.ndarray, "10"]]
    """Configurations of both robots at first."""
    segments: tuple[MotionSegment, ...]
    final: tuple[SE3, ...]
    """Poses of all parts at the end, as the plan says."""


class _Placed(msgspec.Struct):
    part: int
    pose: list[float]


class _Segment(msgspec.Struct):
    stage: Stage
    robot: int
    opening: float
    path: list[list[float]]
    payload: list[_Placed]


class _Motion(msgspec.Struct):
    segments: list[_Segment]
    after: list[list[float]]


class _Upright(msgspec.Struct):
    motion: _Motion | None = None


class _Furniture(msgspec.Struct):
    name: str
    parts: list[str]


class _File(msgspec.Struct):
    furniture: _Furniture
    density: float
    initial: list[list[float]]
    robots: list[list[float]]
    steps: list[_Motion]
    upright: _Upright | None = None


def decode_motions(content: bytes, where: str) -> MotionRecord:
    """Read the motions of `plan.json`. They are taken as the file has them, without a test for collisions.

    Args:
        content: of the file.
        where: the file's name, for errors.

    Raises:
        InputError: it is no plan of two robots of the present version, or a motion is not valid.
    """
    plan_file.decode_with_robots(content, where)
    try:
        file = msgspec.json.decode(content, type=_File)
    except msgspec.DecodeError as error:
        raise InputError(
            f"'{where}': {error}; `roboassembly assemble --setting full` of this version writes the plan anew"
        ) from None
    reader = _Reader(where, len(file.furniture.parts))
    motions = [*file.steps, *([file.upright.motion] if file.upright and file.upright.motion else [])]
    robots = [reader.configurations([q], "robots")[0] for q in file.robots]
    if len(robots) != len(ROBOT_NAMES):
        raise InputError(f"'{where}': {len(robots)} robots; expected {len(ROBOT_NAMES)}")
    if not 0.0 < file.density < np.inf:
        raise InputError(f"'{where}': density {file.density}; expected a positive number of kg/m³")
    segments = reader.segments([s for motion in motions for s in motion.segments], robots)
    initial = reader.poses(file.initial, "initial")
    final = reader.poses(motions[-1].after, "after") if motions else initial
    return MotionRecord(
        file.furniture.name, tuple(file.furniture.parts), file.density, initial, (robots[0], robots[1]), segments, final
    )


@dataclass(frozen=True)
class _Reader:
    """Checks of numbers in a file."""

    where: str
    parts: int
    """Number of parts."""

    def poses(self, rows: Sequence[Sequence[float]], name: str) -> tuple[SE3, ...]:
        if len(rows) != self.parts:
            raise InputError(f"'{self.where}': {name}: {len(rows)} poses; expected {self.parts}, one a part")
        return tuple(self.pose(row, name) for row in rows)

    def pose(self, row: Sequence[float], name: str) -> SE3:
        numbers = np.array(row, dtype=float)
        if numbers.shape != (7,) or not np.isfinite(numbers).all() or abs(np.linalg.norm(numbers[3:]) - 1.0) > 1e-3:
            raise InputError(f"'{self.where}': {name}: pose {list(row)}; expected (x, y, z, qw, qx, qy, qz)")
        return pose_from_seven(row)

    def configurations(self, rows: Sequence[Sequence[float]], name: str) -> Float[np.ndarray, "n 10"]:
        if not rows or any(len(row) != DOF for row in rows) or not np.isfinite(np.array(rows, dtype=float)).all():
            raise InputError(f"'{self.where}': {name}: expected configurations of {DOF} numbers")
        q = np.array(rows, dtype=float)
        over = np.maximum(q[:, 3:] - arm().high, arm().low - q[:, 3:])
        if over.max() > _LIMIT:
            row, joint = np.unravel_index(int(over.argmax()), over.shape)
            low, high = arm().low[joint], arm().high[joint]
            raise InputError(
                f"'{self.where}': {name}: joint {joint + 1} at {q[row, 3 + joint]:.4f} rad; "
                f"the Panda's goes from {low:.4f} to {high:.4f}"
            )
        return q

    def segments(
        self, segments: Sequence[_Segment], robots: Sequence[Float[np.ndarray, "10"]]
    ) -> tuple[MotionSegment, ...]:
        at = list(robots)
        out: list[MotionSegment] = []
        for index, segment in enumerate(segments):
            name = f"segment {index} ({segment.stage.value})"
            if segment.robot not in (0, 1):
                raise InputError(f"'{self.where}': {name}: robot {segment.robot}; expected 0 or 1")
            path = self.configurations(segment.path, name)
            if np.abs(path[0] - at[segment.robot]).max() > _JUMP:
                raise InputError(f"'{self.where}': {name} does not begin where {ROBOT_NAMES[segment.robot]} stands")
            if not 0.0 <= segment.opening < 1.0:
                raise InputError(f"'{self.where}': {name}: opening {segment.opening} m; expected 0 to 0.08")
            if any(not 0 <= placed.part < self.parts for placed in segment.payload):
                raise InputError(f"'{self.where}': {name}: payload: expected parts 0 to {self.parts - 1}")
            payload = {placed.part: self.pose(placed.pose, name) for placed in segment.payload}
            out.append(MotionSegment(segment.stage, segment.robot, segment.opening, path, payload))
            at[segment.robot] = path[-1]
        return tuple(out)
