"""Cameras of the workcell: what they show is where it is, in colour, depth and segmentation."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from roboassembly.control.cameras import (
    CAMERAS,
    FAR,
    FIRST_PART,
    FLOOR,
    NOTHING,
    POSTS,
    ROBOT_A,
    ROBOT_B,
    CellCameras,
    camera_matrix,
    field_of,
    looking_at,
)  # fmt: skip
from roboassembly.control.env import ControlEnv
from roboassembly.control.looks import draw_looks
from roboassembly.control.pictures import view_of
from roboassembly.control.randomization import NONE
from roboassembly.datasets import catalogue
from roboassembly.geometry.poses import transform_points

pytestmark = pytest.mark.usefixtures("drawing")
WIDTH, HEIGHT = 160, 120


@cache
def drawn():
    env = ControlEnv(catalogue.make("three_legged", 3))
    env.reset(seed=1)
    cell = env.cell
    looks = draw_looks(NONE, len(cell.furniture.parts), len(CAMERAS), 0)
    cameras = CellCameras(cell.furniture, cell.cell.radius, looks, WIDTH, HEIGHT)
    view = view_of(cell)
    pictures = cameras.draw(view, dict.fromkeys(CAMERAS, (WIDTH, HEIGHT)), depth=True, segmentation=True)
    poses = cameras.poses(view)
    cameras.close()
    return cell, view, pictures, poses


def test_looking_at_has_the_target_in_the_middle_and_up_is_up() -> None:
    pose = looking_at(np.array([2.0, 0.0, 1.0]), np.zeros(3), np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(pose.inverse().act(np.zeros(3)), [0.0, 0.0, np.sqrt(5.0)], atol=1e-12)
    assert pose.inverse().act(np.array([0.0, 0.0, 0.1]))[1] < 0.0, "y points down"
    # From +x towards the middle, +y of the world is on the right.
    assert pose.inverse().act(np.array([0.0, 0.1, 0.0]))[0] == pytest.approx(0.1)
    assert np.linalg.det(pose.rotation) == pytest.approx(1.0)


def test_the_middle_of_the_picture_and_its_edge() -> None:
    matrix = camera_matrix(np.radians(90.0), 100, 80)
    # 45° up from the axis is the upper edge.
    pixel = matrix @ [0.0, -1.0, 1.0]
    np.testing.assert_allclose(pixel / pixel[2], [50.0, 0.0, 1.0], atol=1e-12)


@pytest.mark.parametrize("camera", CAMERAS)
def test_depth_of_the_floor_lies_at_height_zero(camera: str) -> None:
    """Every pixel of the floor, moved along its ray by its depth, has height 0."""
    _, _, pictures, poses = drawn()
    picture = pictures[camera]
    rows, columns = np.nonzero(picture.segmentation == FLOOR)
    assert len(rows) > 1000
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))])
    rays = np.linalg.inv(camera_matrix(field_of(camera), WIDTH, HEIGHT)) @ pixels
    depth = picture.depth[rows, columns]
    near = depth < 6.0
    points = transform_points(poses[camera], (rays * depth).T[near])
    assert np.abs(points[:, 2]).max() < 0.02
    assert picture.depth.max() <= FAR


@pytest.mark.parametrize("camera", ["overview", "overview_back"])
def test_segmentation_shows_parts_and_robots_where_they_are(camera: str) -> None:
    cell, view, pictures, poses = drawn()
    picture, matrix = pictures[camera], camera_matrix(field_of(camera), WIDTH, HEIGHT)
    found = 0
    for part, pose in enumerate(cell.part_poses()):
        corners = transform_points(pose, cell.furniture.parts[part].mesh.hull_vertices)
        pixels = (transform_points(poses[camera].inverse(), corners) @ matrix.T).T
        pixels = pixels[:2] / pixels[2]
        rows, columns = np.nonzero(picture.segmentation == FIRST_PART + part)
        found += len(rows) > 0
        if len(rows):
            assert (columns >= pixels[0].min() - 1.5).all()
            assert (columns <= pixels[0].max() + 0.5).all()
            assert (rows >= pixels[1].min() - 1.5).all()
            assert (rows <= pixels[1].max() + 0.5).all()
            # The surface is at the distance of the part.
            distance = picture.depth[rows, columns]
            ahead = transform_points(poses[camera].inverse(), corners)[:, 2]
            assert distance.min() > ahead.min() - 0.03
            assert distance.max() < ahead.max() + 0.03
    assert found >= 4, "the ring is in the picture"
    for robot, kind in enumerate((ROBOT_A, ROBOT_B)):
        shown = np.argwhere(picture.segmentation == kind)
        assert len(shown) > 50
        place = np.array([*cell.physics.configuration(robot)[:2], 0.3])
        pixel = matrix @ poses[camera].inverse().act(place)
        assert np.linalg.norm(shown.mean(axis=0)[::-1] - pixel[:2] / pixel[2]) < 15.0
    assert (picture.segmentation == POSTS).sum() > 20
    assert set(np.unique(picture.segmentation)) <= {NOTHING, FLOOR, POSTS, ROBOT_A, ROBOT_B, *range(5, 10)}
    assert len(view.posts) == len(cell.furniture.parts)


@pytest.mark.parametrize(("camera", "own"), [("wrist_a", ROBOT_A), ("wrist_b", ROBOT_B)])
def test_a_wrist_camera_sees_its_own_finger_tips(camera: str, own: int) -> None:
    """The tips are in the lower half of the picture, and what is seen there is the own hand."""
    _, view, pictures, poses = drawn()
    tips = view.tips[0 if own == ROBOT_A else 1].translation
    ahead = poses[camera].inverse().act(tips)
    pixel = camera_matrix(field_of(camera), WIDTH, HEIGHT) @ ahead
    column, row = (pixel[:2] / pixel[2]).astype(int)
    assert 0.05 < ahead[2] < 0.3
    assert abs(column - WIDTH // 2) < 3
    assert HEIGHT // 2 < row < HEIGHT
    assert own in pictures[camera].segmentation[row - 3 : row + 12, column - 4 : column + 5]


def test_observed_pictures_are_those_of_the_cameras_that_are_named() -> None:
    env = ControlEnv(
        catalogue.make("three_legged", 3), obs="rgbd", cameras=["overview", "wrist_b"], camera_width=40,
        camera_height=30, segmentation=True,
    )  # fmt: skip
    observation, _ = env.reset(seed=0)
    assert set(observation) == {
        "robots", "rgb_overview", "depth_overview", "segmentation_overview", "rgb_wrist_b", "depth_wrist_b",
        "segmentation_wrist_b",
    }  # fmt: skip
    assert observation["rgb_overview"].shape == (30, 40, 3)
    assert observation["depth_wrist_b"].shape == (30, 40)
    assert env.observation_space.contains(observation)
    env.close()
