"""Rays, by hand."""

from __future__ import annotations

import numpy as np
import trimesh

from roboassembly.furniture.rays import Rays
from roboassembly.geometry.meshes import Mesh


def box(*extents: float) -> Mesh:
    solid = trimesh.creation.box(extents)
    return Mesh(np.array(solid.vertices), np.array(solid.faces))


def test_a_box_is_hit_where_it_is() -> None:
    origins = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [0.3, 0.0, 1.0], [0.5, 0.01, 0.02]])
    directions = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-0.6, 0.0, 0.8]])
    reach, normals = Rays(box(0.4, 0.2, 0.1)).first_hits(origins, directions)
    assert np.allclose(reach[:2], [0.95, 0.1], atol=1e-7)
    assert np.allclose(normals[:2], [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    assert np.isinf(reach[2:]).all()
    assert not normals[2:].any()


def test_thin_boards_are_hit_to_a_micrometre() -> None:
    reach, _ = Rays(box(2.0, 1.0, 0.003)).first_hits(np.array([[0.7, -0.3, 0.5]]), np.array([[0.0, 0.0, -1.0]]))
    assert abs(reach[0] - 0.4985) < 1e-9


def test_thousands_of_meshes_may_be_kept() -> None:
    """A device each, as trimesh makes them, crashed the interpreter at some 1,300."""
    mesh = box(0.1, 0.1, 0.1)
    kept = [Rays(mesh) for _ in range(3000)]
    for rays in kept[::500]:
        reach, _ = rays.first_hits(np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, -1.0]]))
        assert abs(reach[0] - 0.95) < 1e-7


def test_no_rays_no_hits() -> None:
    reach, normals = Rays(box(0.1, 0.1, 0.1)).first_hits(np.zeros((0, 3)), np.zeros((0, 3)))
    assert reach.shape == (0,)
    assert normals.shape == (0, 3)
