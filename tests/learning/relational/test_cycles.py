"""3-cycles and 4-cycles of groups on cases worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from roboassembly.envs.object_centric import ObjectCentricEnv
from roboassembly.geometry.mating import mating_rotations
from roboassembly.learning.relational.cycles import closed_3_cycles, closed_4_cycles
from roboassembly.learning.relational.features import frames_parallel, plausible_pairs
from roboassembly.learning.relational.policy_view import PolicyView
from roboassembly.learning.relational.tokens import GroupedPoints, TokenCache


def test_3_cycles_close_where_a_third_group_fits_both() -> None:
    # A post stands on the left end of a beam; a brace reaches from the beam's right end to the post's top.
    position = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 0], [0, 0, 1], [0, 0, 0], [-1, 0, 1]], float)
    normal = np.array([[0, 0, 1], [0, 0, 1], [0, 0, -1], [1, 0, 0], [0, 0, -1], [-1, 0, 0]], float)
    tangent = np.tile([0.0, 1.0, 0.0], (6, 1))
    frame = np.stack([tangent, np.cross(normal, tangent), normal], axis=2)
    groups = [np.array([0, 1]), np.array([2, 3]), np.array([4, 5])]
    plausible = np.kron(~np.eye(3, dtype=bool), np.ones((2, 2), bool))
    expected = np.zeros((6, 6), int)
    for a, b in ((0, 2), (1, 4), (3, 5)):
        expected[a, b] = expected[b, a] = 1
    assert np.array_equal(closed_3_cycles(groups, position, frame, plausible), expected)
    # Where the brace cannot go, nothing closes; nor does it with one that is 6 mm too long.
    without = plausible.copy()
    without[3, 5] = without[5, 3] = False
    assert not closed_3_cycles(groups, position, frame, without).any()
    longer = position.copy()
    longer[5, 2] += 0.006
    assert not closed_3_cycles(groups, longer, frame, plausible).any()
    # Two groups close no cycle.
    assert not closed_3_cycles(groups[:2], position, frame, plausible).any()


def test_4_cycles_close_where_two_groups_reach_equally_far() -> None:
    # Two posts; a rod of 0.5 m at their feet, one at their tops, and a third that is 4 cm longer.
    holes = [[0, 0, 0], [0, 0, 1]]
    position = np.array(
        [*holes, *holes, [0, 0, 0], [0.5, 0, 0], [0, 0, 0], [0.5, 0, 0], [0, 0, 0], [0.54, 0, 0]], float
    )
    normal = np.array([[1, 0, 0]] * 2 + [[-1, 0, 0]] * 2 + [[-1, 0, 0], [1, 0, 0]] * 3, float)
    tangent = np.tile([0.0, 0.0, 1.0], (len(position), 1))
    frame = np.stack([tangent, np.cross(normal, tangent), normal], axis=2)
    groups = [np.array([2 * i, 2 * i + 1]) for i in range(5)]
    plausible = normal @ normal.T < -0.5
    plausible &= ~np.kron(np.eye(5, dtype=bool), np.ones((2, 2), bool))
    found = closed_4_cycles(groups, position, frame, plausible)
    assert np.array_equal(found, found.T)
    # Each end of the two equal rods may take either hole of a post: the other rod and the other post close the cycle.
    assert found[0, 4] == found[1, 4] == found[2, 5] == found[3, 5] == found[1, 6] == 2
    assert not found[:, 8:].any()
    assert not found[~plausible].any()


@pytest.mark.parametrize("piece", ["stool:1", "ladder:2", "bench:3"])
def test_equal_groups_have_the_same_cycles(piece: str) -> None:
    env = ObjectCentricEnv(piece, cloud_points=64)
    observation, info = env.reset(seed=0)
    points = GroupedPoints.of_view(PolicyView.from_observation(observation, info["action_mask"]), TokenCache())
    frame, group = points.frame, points.group
    plausible = plausible_pairs(
        frames_parallel(mating_rotations(frame, frame)), points.frames.upright[points.part], group[:, None] != group
    )
    kinds = points.group_types
    assert len(set(kinds)) < len(kinds)
    for closed in (closed_3_cycles, closed_4_cycles):
        each = closed(points.rows, points.position, frame, plausible)
        once = closed(points.rows, points.position, frame, plausible, kinds)
        assert np.array_equal(each, once)
    assert each.any()
