"""Clouds of observations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import shapes
from roboassembly.envs.observation import part_clouds, surface_points


def test_parts_of_one_class_share_a_cloud_even_if_their_meshes_differ() -> None:
    # Two legs that may swap places, one of them with a mark: as imported furniture has them.
    furniture = shapes.table()
    legs = next(c.members for c in furniture.classes if len(c.members) > 1)
    low, high = furniture.parts[legs[1]].mesh.bounds
    marked = shapes.box(low, [*high[:2], high[2] - 1e-4])
    parts = [replace(p, mesh=marked) if i == legs[1] else p for i, p in enumerate(furniture.parts)]
    clouds = part_clouds(replace(furniture, parts=tuple(parts)), 64)
    assert np.array_equal(clouds[legs[0]], clouds[legs[1]])
    assert np.array_equal(clouds[legs[0]], surface_points(furniture.parts[legs[0]].mesh, 64))
