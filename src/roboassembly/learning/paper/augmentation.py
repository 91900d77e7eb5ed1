"""More lessons from the same: a chair that faces another way, is mirrored or of another size is assembled alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from roboassembly.geometry.poses import euler_from_rotations, rotations_from_euler
from roboassembly.learning.relational.augmentation import Change, ways_after
from roboassembly.learning.relational.oracle_dataset import Course, Lesson


def changed(course: Course, change: Change) -> Course:
    """The same lessons about furniture so changed."""
    clouds = (change.scale * course.clouds @ change.matrix.T).astype(np.float32)
    hands = course.hands
    if hands is not None:
        # A hand is its own mirror image.
        hands = _poses(hands, change.matrix, change.side, change.scale).astype(np.float32)
    lessons = tuple(_lesson(lesson, change) for lesson in course.lessons)
    return replace(course, clouds=clouds, hands=hands, lessons=lessons)


def _lesson(lesson: Lesson, change: Change) -> Lesson:
    m, scale = change.matrix, change.scale
    points = lesson.points.reshape(*lesson.points.shape[:2], 3, 3) @ m.T
    points[:, :, 0] *= scale
    order = ways_after(change)
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
