"""Connection points: equal parts number theirs alike, in the order of the neighbours of the first of them."""

from __future__ import annotations

import numpy as np
import pytest

from roboassembly.datasets import catalogue


@pytest.mark.parametrize("family", ["stool", "bench", "windsor", "three_legged"])
def test_equal_parts_number_their_points_alike(family: str) -> None:
    """Point k of a part lies where point k of its class's first part lies."""
    made = catalogue.make(family, 2, with_grasps=False)
    compared = 0
    for shape_class in made.classes:
        first, *others = (made.parts[member].points for member in shape_class.members)
        for points in others:
            for mine, reference in zip(points, first, strict=True):
                assert np.linalg.norm(mine.position - reference.position) < 0.01
                assert mine.normal @ reference.normal > 0.9
                compared += 1
    assert compared >= 4


def test_points_are_in_the_order_of_neighbours() -> None:
    """The points of the only seat, by the numbers of the parts that they meet."""
    made = catalogue.make("stool", 0, with_grasps=False)
    seat = next(i for i, p in enumerate(made.parts) if p.name == "seat")
    mates = {c.point_a: c.part_b for c in made.connections if c.part_a == seat}
    mates |= {c.point_b: c.part_a for c in made.connections if c.part_b == seat}
    numbers = [mates[k] for k in range(len(mates))]
    assert numbers == sorted(numbers)
    assert len(numbers) == 4
