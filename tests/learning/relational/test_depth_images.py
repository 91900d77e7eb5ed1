"""Depth images: what blocks the exits of a mate, by boxes with a hand-computed result."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from jaxtyping import Float

from roboassembly.geometry.mating import FACE_TO_FACE
from roboassembly.learning.relational.depth_images import EXIT_COUNTS, MIRRORED_EXITS, PointImages, exit_counts
from roboassembly.learning.relational.features import exit_states

_OUT = 4


def images(*boxes: tuple[list[float], list[float]], mirrored: bool = False) -> PointImages:
    """Return the images of some boxes, by lower and upper corner in the frame of one connection point [m]."""
    clouds: list[Float[np.ndarray, "c 3"]] = []
    for low, high in boxes:
        box = trimesh.creation.box(bounds=[low, high])
        clouds.append(np.asarray(trimesh.sample.sample_surface(box, 6000, seed=1)[0]))
    cloud = np.concatenate(clouds) * ([1.0, -1.0, 1.0] if mirrored else [1.0, 1.0, 1.0])
    return PointImages.of_cloud(cloud, np.zeros((1, 3)), np.eye(3)[None])


def mated(*boxes: tuple[list[float], list[float]], mirrored: bool = False) -> PointImages:
    """Return the images of a moving group, by boxes in the frame of the waiting point."""
    turned = [np.sort(np.array(box) @ FACE_TO_FACE, axis=0).tolist() for box in boxes]
    return images(*turned, mirrored=mirrored)


BOARD = ([-0.045, -0.045, -0.04], [0.045, 0.045, 0.0])
"""A board whose upper side is the plane of the joint."""
BLOCK = ([-0.02, -0.02, 0.0], [0.02, 0.02, 0.04])
"""A block that stands on it."""
POCKET = (
    ([-0.045, -0.045, -0.04], [0.045, -0.02, 0.0]), ([-0.045, 0.02, -0.04], [0.045, 0.045, 0.0]),
    ([-0.045, -0.02, -0.04], [-0.02, 0.02, 0.0]), ([0.02, -0.02, -0.04], [0.045, 0.02, 0.0]),
)  # fmt: skip
"""A board with a hole, 40 mm wide."""
PEG = ([-0.0195, -0.0195, -0.0195], [0.0195, 0.0195, 0.04])
"""A block that stands in the hole."""


def test_a_block_slides_on_a_board_and_leaves_it_upwards() -> None:
    free = exit_states(exit_counts(mated(BLOCK), images(BOARD)))[0][0, 0]
    # x, -x, y, -y, z, -z
    assert free.tolist() == [True, True, True, True, True, False]


def test_a_peg_leaves_its_hole_upwards_only() -> None:
    assert exit_states(exit_counts(mated(PEG), images(*POCKET)))[0][0, 0, :5].tolist() == [False] * 4 + [True]


def test_the_board_leaves_the_peg_too() -> None:
    turned = [np.sort(np.array(box) @ FACE_TO_FACE, axis=0).tolist() for box in POCKET]
    peg = np.sort(np.array(PEG) @ FACE_TO_FACE, axis=0).tolist()
    assert exit_states(exit_counts(mated(*turned), images(peg)))[0][0, 0, :5].tolist() == [False] * 4 + [True]


@pytest.mark.parametrize(("axis", "sign", "way"), [(0, 1, 0), (0, -1, 1), (1, 1, 2), (1, -1, 3)])
def test_a_wall_blocks_the_way_to_its_side(axis: int, sign: int, way: int) -> None:
    wall = np.array([[-0.045, -0.045, 0.0], [0.045, 0.045, 0.04]])
    wall[:, axis] = sorted((sign * 0.025, sign * 0.04))
    free = exit_states(exit_counts(mated(BLOCK), images(BOARD, wall.tolist())))[0][0, 0]
    assert free.tolist() == [i != way and i != 5 for i in range(6)]


def test_a_board_far_above_a_wide_one_blocks_the_way_up() -> None:
    lid, wide = ([-0.2, -0.2, 0.3], [0.2, 0.2, 0.32]), ([-0.2, -0.2, 0.0], [0.2, 0.2, 0.02])
    assert exit_states(exit_counts(mated(wide), images(BOARD)))[0][0, 0, _OUT]
    assert not exit_states(exit_counts(mated(wide), images(BOARD, lid)))[0][0, 0, _OUT]


def test_a_mirror_exchanges_the_ways_along_y() -> None:
    wall = ([-0.045, 0.0235, 0.0], [0.045, 0.04, 0.04])
    plain, mirror = (
        exit_counts(mated(BLOCK, mirrored=m), images(BOARD, wall, mirrored=m))[0, 0].astype(int) for m in (False, True)
    )
    assert len(plain) == EXIT_COUNTS
    assert sorted(MIRRORED_EXITS) == list(range(EXIT_COUNTS))
    # Points on the border between two pixels fall into another one.
    assert np.abs(plain[MIRRORED_EXITS] - mirror).max() <= 9
    assert plain[2] > 20
    assert plain[3] == 0


@pytest.mark.parametrize("deep", [0.0, 0.01])
def test_groups_overlap_where_one_is_pushed_into_the_other(deep: float) -> None:
    block = ([-0.03, -0.03, -0.03], [0.03, 0.03, 0.0])
    pushed = ([-0.03, -0.03, -deep], [0.03, 0.03, 0.03])
    exits = exit_counts(mated(pushed), images(block))[0, 0]
    assert (exits[11] > 50) == (deep > 0)
    assert (exits[12] > 50) == (deep == 0)
