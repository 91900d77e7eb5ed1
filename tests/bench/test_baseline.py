"""Tests of the baseline's benchmark: what a clearance does to parts, and how outcomes are counted."""

from __future__ import annotations

import numpy as np
import pytest

from roboassembly.bench.baseline import BaselineBenchReport, BaselineEpisode, shrunk, with_clearance
from roboassembly.bench.machine import Machine
from roboassembly.datasets import catalogue
from roboassembly.geometry.meshes import nearest_points
from shapes import brick


def test_a_clearance_moves_each_face_by_half_of_it() -> None:
    small = shrunk(brick(0.1, 0.2, 0.3), 0.01)
    assert np.ptp(small.bounds, axis=0) == pytest.approx([0.09, 0.19, 0.29])
    assert small.volume == pytest.approx(0.09 * 0.19 * 0.29)


def test_thin_parts_keep_something() -> None:
    """A board of 4 mm cannot lose 20 mm, nor 10, nor 5; it loses 2.5."""
    small = shrunk(brick(0.1, 0.2, 0.004), 0.02)
    assert np.ptp(small.bounds, axis=0) == pytest.approx([0.0975, 0.1975, 0.0015])


def test_joined_parts_are_the_clearance_apart() -> None:
    """Measured part by part; each pair touched, or nearly so, before."""
    furniture = catalogue.make("three_legged", 3, with_grasps=False)
    loose = with_clearance(furniture, 0.002)
    pairs = {(c.part_a, c.part_b) for c in furniture.connections}
    assert pairs
    for a, b in pairs:
        before, after = (
            nearest_points(*(f.parts[i].mesh.transformed(f.assembled[i]) for i in (a, b))).distance
            for f in (furniture, loose)
        )
        assert before < 0.001
        assert 0.002 <= after < 0.006
    assert with_clearance(furniture, 0.0) is furniture


def test_the_table_counts_by_parts_and_clearance() -> None:
    episodes = tuple(
        BaselineEpisode(f"chair-{i}", parts, clearance, solved, 10, 0.1)
        for i, (parts, clearance, solved) in enumerate(
            [(4, 0.0, False), (4, 20.0, True), (5, 20.0, False), (7, 0.0, False), (7, 20.0, True)]
        )
    )
    report = BaselineBenchReport("tiny:test", "0", 0, 1_000, episodes, Machine.here())
    rows = {(r["clearance_mm"], r["parts"]): (r["n"], r["success_rate"]) for r in report.to_json()["rows"]}
    assert rows == {
        (0.0, "2-5"): (1, 0.0),
        (0.0, "6-8"): (1, 0.0),
        (0.0, "2-20"): (2, 0.0),
        (20.0, "2-5"): (2, 0.5),
        (20.0, "6-8"): (1, 1.0),
        (20.0, "2-20"): (3, pytest.approx(2 / 3)),
    }
    assert "| 2–5 | 0 of 1: 0.0 % (0.0–79.3) | 1 of 2: 50.0 %" in report.to_text()
