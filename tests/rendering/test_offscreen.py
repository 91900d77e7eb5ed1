"""Shadows and ground of pictures."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3
from roboassembly.rendering.camera import Camera, project
from roboassembly.rendering.colors import BACKGROUND, to_bytes
from roboassembly.rendering.offscreen import LIGHT_DIRECTION
from roboassembly.rendering.rectangles import Rectangle, changed_rectangle
from roboassembly.rendering.renderer import FAST, STILL, OffscreenRenderer, placements
from roboassembly.rendering.shadow_map import SOFTEST

BOX = Mesh.from_trimesh(trimesh.creation.box((0.4, 0.3, 0.2)))
WIDTH, HEIGHT = 320, 240


def draw(pose: SE3 | None, view: Camera, quality=FAST, radius: float = 1.0) -> np.ndarray:
    with OffscreenRenderer([BOX], WIDTH, HEIGHT, center=np.zeros(3), radius=radius, quality=quality) as renderer:
        return renderer.picture([pose], [(1.0, 0.0, 0.0)], view).astype(int)


@pytest.mark.parametrize("quality", [FAST, STILL])
def test_a_shadow_lies_where_the_light_throws_it_and_is_soft(drawing: None, quality) -> None:
    turn = trimesh.transformations.euler_matrix(0.4, -0.3, 0.8)[:3, :3]
    pose = SE3(turn, np.array([0.1, -0.2, 0.6]))
    view = Camera(np.array([0.2, -0.1, 0.2]), 3.0, azimuth=0.6, elevation=-0.9)
    corners = BOX.vertices @ turn.T + pose.translation
    on_ground = corners - corners[:, 2:] / LIGHT_DIRECTION[2] * LIGHT_DIRECTION
    darker = (draw(None, view, quality) - draw(pose, view, quality)).sum(axis=2)
    gray = np.ptp(draw(pose, view, quality), axis=2) < 20
    half = darker[gray].max() / 2
    shadow = gray & (darker > half)
    rows, columns = np.flatnonzero(shadow.any(axis=1)), np.flatnonzero(shadow.any(axis=0))
    pixels = project(on_ground, view, WIDTH, HEIGHT)
    # The box hides a part of its shadow's upper edge.
    assert columns[-1] + 1 == pytest.approx(pixels.max(axis=0)[0], abs=4.0)
    assert rows[-1] + 1 == pytest.approx(pixels.max(axis=0)[1], abs=4.0)
    # On its lower edge the shadow fades over several pixels.
    middle = int(columns.mean())
    fading = (darker[:, middle] > 0.1 * half) & (darker[:, middle] < 1.9 * half) & gray[:, middle]
    assert fading[rows[-1] - 8 : rows[-1] + 8].sum() >= 3


def test_a_part_of_a_picture_is_that_of_the_whole(drawing: None) -> None:
    first, second = (SE3(np.eye(3), np.array([x, -0.2, 0.5])) for x in (0.1, 0.3))
    view = Camera(np.array([0.2, -0.1, 0.2]), 3.0, azimuth=0.6, elevation=-0.9)
    colors = np.array([(1.0, 0.5, 0.0)])
    before, after = placements([[first], [second]])
    with OffscreenRenderer([BOX], WIDTH, HEIGHT, center=np.zeros(3), radius=1.0, quality=FAST) as renderer:
        whole, moved = (renderer.draw(rows, colors, view) for rows in (before, after))
        area = changed_rectangle(
            renderer.boxes, before, after, np.array([True]), view, (WIDTH, HEIGHT), SOFTEST
        )  # fmt: skip
        part = renderer.draw(after, colors, view, area)
    assert area.width * area.height < 0.5 * WIDTH * HEIGHT
    assert (part != whole[area.top : area.bottom, area.left : area.right]).any()
    whole[area.top : area.bottom, area.left : area.right] = part
    # Single pixels are rounded another way.
    apart = np.abs(whole.astype(int) - moved)
    assert apart.max() <= 2
    assert (apart > 0).mean() < 1e-3


def test_a_changed_rectangle_by_hand() -> None:
    boxes = np.array([np.stack(np.meshgrid(*[[-0.1, 0.1]] * 3), axis=-1).reshape(8, 3)])
    high = placements([[SE3(np.eye(3), np.array([0.0, 0.0, 1.0]))]])[0]
    # From above, 10 m away, 100 pixels show 2 * 10 * tan(18 degrees) = 6.50 m, so 15.4 pixels a metre at the ground.
    view = Camera(np.zeros(3), 10.0, azimuth=0.0, elevation=-0.5 * np.pi)
    area = changed_rectangle(boxes, high, high, np.array([True]), view, (100, 100), 0.0)
    light = LIGHT_DIRECTION / -LIGHT_DIRECTION[2]
    # Right is -y and up is +x. The box's top is at 1.1 m, the shadow of its top as far along the light.
    right = 50 + 0.1 * 15.4 * 10 / 8.9
    left = 50 - (0.1 + 1.1 * light[1]) * 15.4
    assert [area.left, area.right] == pytest.approx([left - 2, right + 2], abs=1.0)
    top = 50 - (0.1 + 1.1 * light[0]) * 15.4
    assert area.top == pytest.approx(top - 2, abs=1.0)
    nothing = changed_rectangle(boxes, high, high, np.array([False]), view, (100, 100), 0.0)
    assert nothing == Rectangle(0, 0, 0, 0)


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
    # Lines of the ground fade; speckles would be darker by 90.
    far = picture[: HEIGHT // 4]
    assert np.abs(np.diff(far, axis=1)).max() <= 20
    assert np.abs(np.diff(far, axis=0)).max() <= 20


def test_placements_by_hand() -> None:
    quarter = SE3(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([1.0, 2.0, 3.0]))
    rows = placements([[quarter, None]])
    assert rows.shape == (1, 2, 7)
    assert rows[0, 0] == pytest.approx([1.0, 2.0, 3.0, 0.5**0.5, 0.0, 0.0, 0.5**0.5])
    assert rows[0, 1, 2] < -50.0
