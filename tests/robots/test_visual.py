"""Shapes that robots are drawn with: where the shapes are that plans are checked with."""

from __future__ import annotations

import numpy as np
import pytest

from roboassembly.geometry.poses import transform_points
from roboassembly.robots.body import placed
from roboassembly.robots.platform import HEIGHT, LENGTH, WIDTH
from roboassembly.robots.visual import visual_links, visual_poses

Q = np.array([0.4, -0.3, 0.7, 0.2, -0.6, 0.3, -2.0, 0.4, 1.7, 0.5])


def bounds(pairs) -> np.ndarray:
    points = np.concatenate([transform_points(pose, mesh.vertices) for mesh, pose in pairs])
    return np.array([points.min(axis=0), points.max(axis=0)])


@pytest.mark.parametrize("opening", [0.0, 0.06])
def test_every_link_is_drawn_where_it_is(opening: float) -> None:
    drawn = list(zip(visual_links(), visual_poses(Q, opening), strict=True))
    names = {"hand": "palm", "finger": ""}
    checked = 0
    for link, pose in placed(Q, opening):
        if link.name == "platform":
            continue
        own = [
            (item.mesh, where)
            for item, where in drawn
            if item.finger == {"left_finger": 0, "right_finger": 1}.get(link.name)
            and names.get(item.name.removesuffix("_dark"), item.name.removesuffix("_dark")) in (link.name, "")
        ]
        assert bounds(own) == pytest.approx(bounds([(link.mesh, pose)]), abs=0.025), link.name
        checked += 1
    assert checked >= 10


def test_the_platform_stays_within_its_box_and_stands_on_its_wheels() -> None:
    own = np.concatenate([item.mesh.vertices for item in visual_links() if item.name.startswith("platform")])
    assert own.min(axis=0) == pytest.approx([-0.5 * LENGTH, -0.5 * WIDTH, 0.0], abs=3e-3)
    assert own.max(axis=0) == pytest.approx([0.5 * LENGTH, 0.5 * WIDTH, HEIGHT], abs=3e-3)


def test_robots_have_two_colors_and_few_faces() -> None:
    assert {item.dark for item in visual_links()} == {False, True}
    assert 5_000 < sum(len(item.mesh.faces) for item in visual_links()) < 30_000
