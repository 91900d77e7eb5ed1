"""Depth images: what blocks the ways out of a mate, by boxes with a hand-computed result."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from jaxtyping import Float

from roboassembly.geometry.mating import FACE_TO_FACE
from roboassembly.learning.relational.features import way_is_free
from roboassembly.learning.relational.ways import MIRRORED_WAYS, WAYS, PointImages, ways_out

_X, _Y, _OUT = slice(0, 2), slice(2, 4), 4


def images(*boxes: tuple[list[float], list[float]], mirrored: bool = False) -> PointImages:
    """Return the images of some boxes, by lower and upper corner in the frame of one connection point [m]."""
    clouds: list[Float[np.ndarray, "c 3"]] = []
    for low, high in boxes:
        box = trimesh.creation.box(bounds=[low, high])
        clouds.append(np.asarray(trimesh.sample.sample_surface(box, 6000, seed=1)[0]))
    cloud = np.concatenate(clouds) * ([1.0, -1.0, 1.0] if mirrored else [1.0, 1.0, 1.0])
    return PointImages.take(cloud, np.zeros((1, 3)), np.eye(3)[None])


def mated(*boxes: tuple[list[float], list[float]], mirrored: bool = False) -> PointImages:
    """Return the images of a moving group, by boxes in the frame of the waiting point."""
    turned = [np.sort(np.array(box) @ FACE_TO_FACE, axis=0).tolist() for box in boxes]
    return images(*turned, mirrored=mirrored)


GROOVE = (
    ([-0.04, -0.04, -0.03], [0.04, -0.03, 0.0]), ([-0.04, 0.03, -0.03], [0.04, 0.04, 0.0]),
    ([-0.04, -0.04, -0.04], [0.04, 0.04, -0.02]),
)  # fmt: skip
"""A board with a groove along x, 60 mm wide and 20 mm deep."""
RIB = (([-0.03, -0.0295, -0.0198], [0.03, 0.0295, 0.04]),)
"""A board that stands in the groove."""


def test_a_rib_leaves_its_groove_upwards_and_along_it() -> None:
    free = way_is_free(ways_out(mated(*RIB), images(*GROOVE)))[0, 0]
    # x, -x, y, -y, z, -z
    assert free.tolist() == [True, True, False, False, True, False]


def test_a_wall_at_the_end_of_the_groove_blocks_one_way() -> None:
    wall = ([0.032, -0.04, -0.03], [0.04, 0.04, 0.0])
    free = way_is_free(ways_out(mated(*RIB), images(*GROOVE, wall)))[0, 0]
    assert free.tolist() == [False, True, False, False, True, False]


def test_a_board_far_above_blocks_the_way_up() -> None:
    lid = ([-0.3, -0.3, 0.3], [0.3, 0.3, 0.32])
    assert not way_is_free(ways_out(mated(*RIB), images(*GROOVE, lid)))[0, 0, _OUT]


def test_a_mirror_exchanges_the_ways_along_y() -> None:
    wall = ([-0.04, 0.012, -0.03], [0.04, 0.04, 0.03])
    plain, mirror = (
        ways_out(mated(*RIB, mirrored=m), images(*GROOVE, wall, mirrored=m))[0, 0].astype(int) for m in (False, True)
    )
    assert len(plain) == WAYS
    assert sorted(MIRRORED_WAYS) == list(range(WAYS))
    # Points on the border between two pixels fall into another one.
    assert np.abs(plain[MIRRORED_WAYS] - mirror).max() <= 3
    assert plain[2] > plain[3] + 3


@pytest.mark.parametrize("deep", [0.0, 0.01])
def test_groups_overlap_where_one_is_pushed_into_the_other(deep: float) -> None:
    block = ([-0.03, -0.03, -0.03], [0.03, 0.03, 0.0])
    pushed = ([-0.03, -0.03, -deep], [0.03, 0.03, 0.03])
    ways = ways_out(mated(pushed), images(block))[0, 0]
    assert (ways[11] > 50) == (deep > 0)
    assert (ways[12] > 50) == (deep == 0)
