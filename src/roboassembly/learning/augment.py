"""More lessons from the same: a chair that faces another way, is mirrored or of another size is assembled alike."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from roboassembly.learning.lessons import Course, Lesson
from roboassembly.poses import euler_from_rotations, rotations_from_euler
from roboassembly.task.object_centric import UP_AXES

_SCALES = (0.7, 1.4)


@dataclass(frozen=True)
class Change:
    """Of the furniture's frame, which all part frames are parallel to: mirrored first, then turned, and scaled."""

    quarter_turns: int = 0
    """About z, counter-clockwise: the furniture faces another way; up stays up."""
    mirrored: bool = False
    """Along x."""
    scale: float = 1.0

    @staticmethod
    def draw(rng: np.random.Generator) -> Change:
        """Any of them, sizes evenly in their logarithm."""
        scale = float(np.exp(rng.uniform(*np.log(_SCALES))))
        return Change(int(rng.integers(4)), bool(rng.integers(2)), scale)

    @property
    def mirror(self) -> Float[np.ndarray, "3 3"]:
        """Of the world."""
        return np.diag([-1.0 if self.mirrored else 1.0, 1.0, 1.0])

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """`new_from_old` for directions in a part's frame; its determinant is -1 if mirrored."""
        cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[self.quarter_turns % 4]
        turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        return turn @ self.mirror


def changed(course: Course, change: Change) -> Course:
    """The same lessons about furniture so changed."""
    clouds = (change.scale * course.clouds @ change.matrix.T).astype(np.float32)
    return replace(course, clouds=clouds, lessons=tuple(_lesson(lesson, change) for lesson in course.lessons))


def _lesson(lesson: Lesson, change: Change) -> Lesson:
    m, scale = change.matrix, change.scale
    points = lesson.points.reshape(*lesson.points.shape[:2], 3, 3) @ m.T
    points[:, :, 0] *= scale
    order = np.argmax(UP_AXES @ m.T @ UP_AXES.T, axis=1)  # old w to new w
    joints = lesson.joints.copy()
    joints[:, 5 + order] = lesson.joints[:, 5:]
    values = lesson.values
    if values is not None:
        values = values.copy()
        values[..., order] = lesson.values
    return replace(
        lesson,
        points=points.reshape(lesson.points.shape).astype(np.float32),
        connections=_poses(lesson.connections, m, m, scale),
        poses=_poses(lesson.poses, change.mirror, m, scale),
        joints=joints,
        values=values,
    )


def _poses(
    poses: Float[np.ndarray, "*n 6"], left: Float[np.ndarray, "3 3"], right: Float[np.ndarray, "3 3"], scale: float
) -> Float[np.ndarray, "*n 6"]:
    """Poses of frames changed by `right` in frames changed by `left`; rows of zeros, which say "none", stay so."""
    out = np.zeros_like(poses)
    some = (poses != 0).any(axis=-1)
    turns = left @ rotations_from_euler(poses[some][:, 3:].astype(float)) @ right.T
    out[some] = np.concatenate([scale * poses[some][:, :3] @ left.T, euler_from_rotations(turns)], axis=-1)
    return out
