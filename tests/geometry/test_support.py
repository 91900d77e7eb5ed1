"""Support polygons: angles worked out by hand, and verdicts where they are exact."""

from __future__ import annotations

import numpy as np
import pytest

from roboassembly.geometry.support import SupportHull, tipping_angle
from shapes import box

UP = np.array([0.0, 0.0, 1.0])
RULES = {"nudge": np.deg2rad(1.0), "drop": 0.001, "largest_tilt": np.deg2rad(5.0), "largest_shift": 0.02}


def rests(points: np.ndarray, center: np.ndarray, up: np.ndarray = UP) -> bool | None:
    return SupportHull(points, center).rests(up, **RULES)


def test_a_box_tips_at_the_angle_of_its_nearer_edge() -> None:
    corners = box((-0.1, -0.05, 0.0), (0.1, 0.05, 0.3)).vertices
    center = np.array([0.0, 0.0, 0.15])
    assert tipping_angle(corners, center, 1e-3) == pytest.approx(np.arctan2(0.05, 0.15))
    # A load that leans over the side by 10 mm: negative, since it falls without being tilted.
    assert tipping_angle(corners, np.array([0.11, 0.0, 0.15]), 1e-3) == pytest.approx(-np.arctan2(0.01, 0.15))


def test_an_edge_is_no_polygon() -> None:
    roof = np.array([[-0.1, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0.1], [-0.1, 0.1, 0.1], [0, -0.1, 0.1]], dtype=float)
    assert tipping_angle(roof, roof.mean(axis=0), 1e-3) is None


def test_a_broad_box_rests_and_a_top_heavy_one_does_not() -> None:
    corners = box((-0.1, -0.1, 0.0), (0.1, 0.1, 0.2)).vertices
    assert rests(corners, np.array([0.0, 0.0, 0.1])) is True
    assert rests(corners, np.array([0.12, 0.0, 0.1])) is False
    # On an edge it rests nowhere within 5 degrees.
    assert rests(corners, np.array([0.0, 0.0, 0.1]), np.array([0.0, 1.0, 1.0]) / np.sqrt(2.0)) is False


def test_what_a_nudge_may_throw_over_is_left_to_physics() -> None:
    # A rod of 20 x 20 x 400 mm: its centre has to rise by 0.25 mm, less than the drop.
    rod = box((-0.01, -0.01, 0.0), (0.01, 0.01, 0.4)).vertices
    assert rests(rod, np.array([0.0, 0.0, 0.2])) is None


def test_a_small_lean_counts_as_resting_and_a_larger_one_does_not() -> None:
    corners = box((-0.1, -0.1, 0.0), (0.1, 0.1, 0.1)).vertices
    for degrees, expected in ((0.5, True), (7.0, False)):
        lean = np.deg2rad(degrees)
        up = np.array([np.sin(lean), 0.0, np.cos(lean)])
        assert rests(corners, np.array([0.0, 0.0, 0.05]), up) is expected
