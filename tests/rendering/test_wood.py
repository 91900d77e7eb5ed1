"""Wood: made from a seed, repeats without a seam, and its grain runs along parts."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3
from roboassembly.rendering.camera import Camera
from roboassembly.rendering.colors import Finish, Role, part_colors
from roboassembly.rendering.renderer import FAST, OffscreenRenderer
from roboassembly.rendering.wood import grain_coordinates, wood_texture


def test_the_texture_follows_from_its_seed_and_has_no_seam() -> None:
    texture = wood_texture(3)
    assert (texture == wood_texture.__wrapped__(3)).all()
    assert (texture != wood_texture(4)).mean() > 0.5
    values = texture.astype(float)
    along, across = (np.abs(np.diff(values, axis=axis)).mean() for axis in (1, 0))
    assert along < 0.5 * across, "fibres run along columns"
    for axis, usual in ((0, across), (1, along)):
        seam = np.abs(values.take(0, axis) - values.take(-1, axis)).mean()
        assert seam < 3.0 * usual
    assert 0.5 < values.mean() / 255.0 < 0.9


def test_grain_runs_along_the_longest_side() -> None:
    box = trimesh.creation.box((0.03, 0.6, 0.09))
    assert np.ptp(grain_coordinates(np.array(box.vertices)), axis=0) == pytest.approx([0.6, 0.09, 0.03])


def test_roles_are_told_apart_in_wood(drawing: None) -> None:
    box = Mesh.from_trimesh(trimesh.creation.box((0.5, 0.4, 0.3)))
    view = Camera(np.array([0.0, 0.0, 0.15]), 2.0)
    pose = SE3(np.eye(3), np.array([0.0, 0.0, 0.15]))
    seen = {}
    with OffscreenRenderer(
        [box], 160, 120, center=np.zeros(3), radius=0.5, quality=FAST, finishes=[Finish.WOOD]
    ) as renderer:
        for role in (Role.IDLE, Role.MOVING, Role.WAITING):
            pixels = renderer.picture([pose], part_colors([role]), view)[40:80, 60:100].reshape(-1, 3).astype(float)
            assert pixels.std(axis=0).max() > 3.0, "the grain shows"
            seen[role] = pixels.mean(axis=0)
    idle, moving, waiting = seen.values()
    assert np.abs(idle - moving).max() > 50
    assert np.abs(idle - waiting).max() > 50
    assert moving[0] > moving[1] + 40
    assert waiting[1] > waiting[0] + 40
