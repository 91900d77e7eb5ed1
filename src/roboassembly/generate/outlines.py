"""Closed outlines in a plane, counter-clockwise, `(n, 2)` in metres: sections of bars, seats and boards."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

Outline = Float[np.ndarray, "n 2"]


def rectangle(width: float, height: float, chamfer: float = 0.0) -> Outline:
    """Return a rectangle about the origin, its corners cut off at 45 degrees: eight corners, four without chamfer."""
    a, b, c = width / 2, height / 2, chamfer
    if c <= 0:
        return np.array([[-a, -b], [a, -b], [a, b], [-a, b]])
    return np.array(
        [[-a + c, -b], [a - c, -b], [a, -b + c], [a, b - c], [a - c, b], [-a + c, b], [-a, b - c], [-a, -b + c]]
    )


def rectangles(widths: ArrayLike, heights: ArrayLike, chamfers: ArrayLike) -> Float[np.ndarray, "k n 2"]:
    """Return the rectangles of a bar that changes its section; a single number stands for all of them."""
    return np.array([rectangle(w, h, c) for w, h, c in np.broadcast(widths, heights, chamfers)])


def circle(radius: float, sides: int = 12) -> Outline:
    """Return a regular polygon with its corners on the circle, the first corner on the first axis."""
    angle = 2 * np.pi * np.arange(sides) / sides
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def rounded_trapezoid(bottom: float, top: float, height: float, radius: float, steps: int = 3) -> Outline:
    """Return an isosceles trapezoid about the origin with rounded corners.

    `bottom` is its width at the second coordinate `-height / 2`, `top` at `+height / 2`.
    """
    corners = np.array(
        [[-bottom / 2, -height / 2], [bottom / 2, -height / 2], [top / 2, height / 2], [-top / 2, height / 2]]
    )
    points: list[Float[np.ndarray, "2"]] = []
    for k in range(4):
        here = corners[k]
        back, forth = corners[k - 1] - here, corners[(k + 1) % 4] - here
        back, forth = back / np.linalg.norm(back), forth / np.linalg.norm(forth)
        half = float(np.arccos(np.clip(back @ forth, -1, 1)) / 2)
        centre = here + (back + forth) / np.linalg.norm(back + forth) * radius / np.sin(half)
        start = centre + (here + back * radius / np.tan(half) - centre)
        for t in np.linspace(0.0, np.pi - 2 * half, steps + 1):
            c, s = np.cos(t), np.sin(t)
            points.append(centre + np.array([[c, -s], [s, c]]) @ (start - centre))
    return np.array(points)


def from_front_to_rear(front: float, rear: float, width: float, radius: float) -> Outline:
    """Return a rectangle with rounded corners between two values of the second coordinate."""
    return rounded_trapezoid(width, width, rear - front, radius) + np.array([0.0, (front + rear) / 2])


def inset(outline: Outline, distance: float) -> Outline:
    """Return the convex outline with every edge moved inward by `distance` (outward where it is negative)."""
    edge = np.roll(outline, -1, axis=0) - outline
    normal = np.column_stack([-edge[:, 1], edge[:, 0]]) / np.linalg.norm(edge, axis=1, keepdims=True)
    before = np.roll(normal, 1, axis=0)
    return outline + distance * (before + normal) / (1.0 + np.einsum("ij,ij->i", before, normal))[:, None]


def symmetric(half: Sequence[tuple[float, float]]) -> Outline:
    """Return an outline, mirror-symmetric about the second axis, from its right half `(x, y)` in rising y."""
    return np.array([*half, *[(-x, y) for x, y in reversed(half) if x > 0]])


def smooth(points: Sequence[tuple[float, float]], count: int) -> list[tuple[float, float]]:
    """Return `count` points on a smooth curve x(y) through `(x, y)` points in rising y, the ends among them."""
    x, y = np.array(points).T
    levels = np.linspace(float(y[0]), float(y[-1]), count)
    low = np.clip(np.searchsorted(y, levels, side="right") - 1, 0, len(y) - 2)
    t = (levels - y[low]) / (y[low + 1] - y[low])
    ease = t * t * (3 - 2 * t)
    return [(float(a), float(b)) for a, b in zip(x[low] + ease * (x[low + 1] - x[low]), levels, strict=True)]
