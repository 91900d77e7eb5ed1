"""Furniture in other sizes: what scales, what stays, and whether it can still be assembled."""

from __future__ import annotations

import numpy as np
import pytest

from roboassembly.datasets import catalogue
from roboassembly.errors import FurnitureError
from roboassembly.furniture.model import Furniture
from roboassembly.furniture.resize import resized
from roboassembly.geometry.poses import transform_points
from roboassembly.solvers.search import solve

WIDER = np.array([1.2, 0.9, 1.1])


def _bounds(furniture: Furniture) -> np.ndarray:
    placed = [
        transform_points(slot, part.mesh.vertices)
        for slot, part in zip(furniture.assembled, furniture.parts, strict=True)
    ]
    return np.array([np.concatenate(placed).min(axis=0), np.concatenate(placed).max(axis=0)])


def _points(furniture: Furniture) -> dict[tuple[int, int], np.ndarray]:
    """Place of the connection point of the first part of each connection, in the furniture's frame."""
    return {
        (c.part_a, c.part_b): transform_points(
            furniture.assembled[c.part_a], furniture.parts[c.part_a].points[c.point_a].position[None]
        )[0]
        for c in furniture.connections
    }


@pytest.fixture(scope="module")
def stool() -> Furniture:
    """Generated stool: a seat, four legs, and four stretchers of one shape, two along x and two along y."""
    return catalogue.make("stool", 1, with_grasps=False)


@pytest.fixture(scope="module")
def wider(stool: Furniture) -> Furniture:
    return resized(stool, "wider", WIDER, with_grasps=False)


def test_lengths_and_joints_follow_the_factors(stool: Furniture, wider: Furniture) -> None:
    assert wider.name == "wider"
    assert wider.provenance.notes[-1] == "resized by 1.200 × 0.900 × 1.100"
    assert [part.name for part in wider.parts] == [part.name for part in stool.parts]
    np.testing.assert_allclose(np.ptp(_bounds(wider), axis=0), WIDER * np.ptp(_bounds(stool), axis=0), atol=1e-4)
    before, after = _points(stool), _points(wider)
    assert before.keys() == after.keys()
    shift = _bounds(wider)[0] - WIDER * _bounds(stool)[0]
    for pair, place in before.items():
        np.testing.assert_allclose(after[pair], WIDER * place + shift, atol=2e-3)
    for part, other in zip(stool.parts, wider.parts, strict=True):
        assert other.mesh.volume == pytest.approx(WIDER.prod() * part.mesh.volume, rel=1e-3)


def test_equal_parts_in_different_directions_become_different(stool: Furniture, wider: Furniture) -> None:
    def stretchers(furniture: Furniture) -> set[frozenset[str]]:
        names = (frozenset(furniture.parts[i].name for i in c.members) for c in furniture.classes)
        return {some for some in names if any("stretcher" in name for name in some)}

    sides = [frozenset((f"stretcher_{a}", f"stretcher_{b}")) for a, b in (("left", "right"), ("front", "back"))]
    assert stretchers(stool) == {sides[0] | sides[1]}
    assert stretchers(wider) == set(sides)


def test_a_resized_piece_is_assembled(wider: Furniture) -> None:
    assert solve(wider, seed=0).plan.success


def test_parts_that_come_apart_are_refused(stool: Furniture) -> None:
    """At 500 times the size, the play of a joint is wider than the gap at which parts count as connected."""
    with pytest.raises(FurnitureError):
        resized(stool, "huge", np.full(3, 500.0), with_grasps=False)
