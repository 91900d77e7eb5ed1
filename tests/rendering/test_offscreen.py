"""Shadows and ground of pictures."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3
from roboassembly.rendering.camera import Camera, project
from roboassembly.rendering.colors import BACKGROUND, to_bytes
from roboassembly.rendering.offscreen import FAST, LIGHT_DIRECTION, STILL, OffscreenRenderer, placements

BOX = Mesh.from_trimesh(trimesh.creation.box((0.4, 0.3, 0.2)))
WIDTH, HEIGHT = 320, 240


def draw(pose: SE3 | None, view: Camera, quality=FAST, radius: float = 1.0) -> np.ndarray:
    with OffscreenRenderer([BOX], WIDTH, HEIGHT, center=np.zeros(3), radius=radius, quality=quality) as renderer:
        return renderer.picture([pose], [(1.0, 0.0, 0.0)], view).astype(int)


def test_a_flat_shadow_lies_where_the_light_throws_it(drawing: None) -> None:
    turn = trimesh.transformations.euler_matrix(0.4, -0.3, 0.8)[:3, :3]
    pose = SE3(turn, np.array([0.1, -0.2, 0.8]))
    view = Camera(np.array([0.2, -0.3, 0.3]), 3.0, azimuth=0.6, elevation=-0.7)
    corners = BOX.vertices @ turn.T + pose.translation
    on_ground = corners - corners[:, 2:] / LIGHT_DIRECTION[2] * LIGHT_DIRECTION
    picture = draw(pose, view)
    plain = draw(None, view)
    gray = np.abs(picture[..., 0] - picture[..., 2]) < 20
    shadow = gray & (picture.sum(axis=2) < plain.sum(axis=2) - 120)
    rows, columns = np.flatnonzero(shadow.any(axis=1)), np.flatnonzero(shadow.any(axis=0))
    pixels = project(on_ground, view, WIDTH, HEIGHT)
    assert [columns[0], rows[0]] == pytest.approx(pixels.min(axis=0), abs=2.0)
    assert [columns[-1] + 1, rows[-1] + 1] == pytest.approx(pixels.max(axis=0), abs=2.0)
    # A map throws it on the same place.
    mapped = draw(pose, view, STILL)
    gray = np.abs(mapped[..., 0] - mapped[..., 2]) < 20
    assert (shadow & gray & (mapped.sum(axis=2) < plain.sum(axis=2) - 80)).sum() > 0.9 * shadow.sum()


@pytest.mark.parametrize("quality", [FAST, STILL])
@pytest.mark.parametrize("elevation", [-1.5, -0.4, -0.1, 0.0, 0.2])
def test_pictures_are_bright_to_the_horizon_and_above(drawing: None, quality, elevation: float) -> None:
    picture = draw(
        SE3(np.eye(3), np.array([0.0, 0.0, 0.5])), Camera(np.array([0.0, 0.0, 0.5]), 4.0, 0.3, elevation), quality
    )
    assert picture.max(axis=2).min() > 100
    assert picture[2, WIDTH // 2] == pytest.approx(to_bytes(BACKGROUND), abs=40)


@pytest.mark.parametrize("quality", [FAST, STILL])
def test_the_ground_is_smooth_far_from_the_scene(drawing: None, quality) -> None:
    view = Camera(np.zeros(3), 8.0, azimuth=0.3, elevation=-0.5)
    picture = draw(None, view, quality)
    # Lines of the ground are in the lower part.
    far = picture[: HEIGHT // 4]
    assert np.abs(np.diff(far, axis=1)).max() <= 3
    assert np.abs(np.diff(far, axis=0)).max() <= 3


def test_placements_by_hand() -> None:
    quarter = SE3(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([1.0, 2.0, 3.0]))
    rows = placements([[quarter, None]])
    assert rows.shape == (1, 2, 7)
    assert rows[0, 0] == pytest.approx([1.0, 2.0, 3.0, 0.5**0.5, 0.0, 0.0, 0.5**0.5])
    assert rows[0, 1, 2] < -50.0
