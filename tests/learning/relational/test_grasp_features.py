"""Features of grasps at a mate, against the exact geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from relational_cases import grasp_view, scattered

import shapes
from roboassembly.datasets import catalogue
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, rotations_from_euler
from roboassembly.learning.relational.grasps.dataset import GraspSamples
from roboassembly.learning.relational.grasps.features import (
    PAIR_FEATURES,
    SINGLE_FEATURES,
    GraspedGroups,
    grasp_features,
)
from roboassembly.learning.relational.policy_view import PolicyView
from roboassembly.robots.reach import reach
from roboassembly.task.full.grips import can_grip, grip_of
from roboassembly.task.rules.connections import GRASPS
from roboassembly.task.rules.groups import Group, TaskState

APPROACH = [0, 1]
"""Columns of `GraspFeatures.single`: clearance of the approaching gripper to its part and the rest of its group."""
AT_OTHER = 5
"""Column of `GraspFeatures.single`: clearance of the closed gripper to the mated other group."""


@pytest.fixture(scope="module")
def post_on_board() -> Furniture:
    """A bar upright in the middle of a board.

    A gripper that comes to the bar's lower end from above touches nothing but the board, 60 mm below its grasp. One
    that grips the board's edge is far from the bar.
    """
    return shapes.furniture(
        "post",
        {
            "board": shapes.box((-0.3, -0.3, 0.0), (0.3, 0.3, 0.02)),
            "bar": shapes.box((-0.02, -0.02, 0.02 + shapes.GAP), (0.02, 0.02, 0.32)),
        },
    )


def test_clearances_are_those_of_the_geometry(post_on_board: Furniture) -> None:
    view = grasp_view(post_on_board, scattered(post_on_board, np.random.default_rng(0)))
    features = grasp_features(view, 1, 0, 0, 0)
    assert features.single.shape == (2, GRASPS, SINGLE_FEATURES)
    assert features.pair.shape == (GRASPS, GRASPS, PAIR_FEATURES)
    assert features.exists.all() == all(len(p.grasps) == 2 for p in post_on_board.parts)
    bar, board = post_on_board.parts[1], post_on_board.assembled[0]
    assert board.translation[2] == pytest.approx(0.01)
    for g, (region, direction) in enumerate((r, d) for r in bar.grasps for d in r.approaches):
        # Mated, the gripper's lowest point is above the board by the grasp's height less what the gripper reaches down.
        position = post_on_board.assembled[1].act(region.position)
        down = post_on_board.assembled[1].rotation @ direction
        if abs(down[2]) < 0.1:
            # It comes from the side; its widest body is the palm, 63 mm to the sides, 20 mm across the fingers.
            assert (features.single[0, g, AT_OTHER] < 1.0) == (position[2] - 0.02 < 0.07), (g, position, down)


def test_arms_have_solutions_for_what_is_in_reach(post_on_board: Furniture) -> None:
    view = grasp_view(post_on_board, scattered(post_on_board, np.random.default_rng(0)))

    def solutions(view: PolicyView) -> list[int]:
        """Numbers of configurations of an arm on a platform, of 64 draws, for the bar's and the board's grasps."""
        found: list[int] = []
        for part in (1, 0):
            at = SE3(rotations_from_euler(view.poses[part, 3:]), view.poses[part, :3])
            for pose in view.grasps[part]:
                tips = at * SE3(rotations_from_euler(pose[3:]), pose[:3])
                found.append(len(reach(tips, 64, np.random.default_rng(0))))
        return found

    def at_height(z: float) -> PolicyView:
        poses = view.poses.copy()
        poses[:, 2] = z
        return replace(view, poses=poses)

    standing, above = at_height(0.8), at_height(2.2)
    in_reach = grasp_features(standing, 1, 0, 0, 0).in_reach.ravel()
    assert in_reach.sum() > GRASPS
    assert min(np.array(solutions(standing))[in_reach]) > 20
    assert not grasp_features(above, 1, 0, 0, 0).in_reach.any()
    assert max(solutions(above)) == 0
    # Where an expected merge is put down is not known: only the bar is still where no arm gets to.
    expected = grasp_features(replace(above, moved=frozenset({0})), 1, 0, 0, 0).in_reach
    assert expected.all(axis=1).tolist() == [False, True]


def test_grasps_blocked_by_their_own_group_have_no_clearance() -> None:
    furniture = catalogue.make("ladder", 3)
    *parts, last = range(len(furniture.parts))
    # All but one part assembled, that one far away.
    whole = Group(tuple(parts), tuple(parts), furniture.assembled[:last], SE3.Identity())
    alone = Group((last,), (last,), (furniture.assembled[last],), shapes.pose(x=3.0))
    view = grasp_view(furniture, TaskState((whole, alone)))
    clearances, free = [], []
    for part in parts:
        features = grasp_features(view, part, 0, last, 0)
        for g in range(GRASPS):
            grip = grip_of(furniture, whole, part, g)
            assert (grip is not None) == features.exists[g].any()
            if grip is not None:
                clearances.append(features.single[0, g, APPROACH].min())
                free.append(can_grip(furniture, whole, grip))
    clearances, free = np.array(clearances), np.array(free)
    assert 0.1 < free.mean() < 0.9
    # Clouds have holes, so a few differ.
    assert ((clearances > 0.0) == free).mean() > 0.95


@pytest.mark.slow
def test_grasps_blocked_by_their_own_part_have_little_clearance() -> None:
    clearances, free = [], []
    for family in ("rocker", "windsor", "cantilever"):
        furniture = catalogue.make(family, 3)
        state = scattered(furniture, np.random.default_rng(0))
        view = grasp_view(furniture, state)
        for u, group in enumerate(state.groups):
            features = grasp_features(view, u, 0, (u + 1) % len(furniture.parts), 0)
            for g in np.flatnonzero(features.exists.any(axis=1)).tolist():
                grip = grip_of(furniture, group, u, g)
                assert grip is not None
                clearances.append(features.single[0, g, APPROACH].min())
                free.append(can_grip(furniture, group, grip))
    clearances, free = np.array(clearances), np.array(free)
    # A gripper has to come with a millimetre to spare on each side; columns are in shares of 50 mm.
    assert (~free).sum() > 2
    assert (clearances[~free] < 1.5 / 50.0).all()
    assert (clearances[free] > 1.5 / 50.0).mean() > 0.9


def test_features_depend_on_what_is_up_but_not_on_where_parts_lie(post_on_board: Furniture) -> None:
    state = scattered(post_on_board, np.random.default_rng(0))
    turn = SE3(shapes.turn((0.0, 0.0, 1.0), 1.0), np.array([0.4, -0.3, 0.0]))
    moved = TaskState(tuple(g.moved_to(turn * g.world_from_furniture) for g in state.groups))
    a, b = (grasp_features(grasp_view(post_on_board, s), 1, 0, 0, 0) for s in (state, moved))
    np.testing.assert_allclose(a.single, b.single, atol=1e-4)
    np.testing.assert_allclose(a.pair, b.pair, atol=1e-4)
    tilt = SE3(shapes.turn((1.0, 0.0, 0.0), 1.0), np.zeros(3))
    tilted = TaskState(tuple(g.moved_to(tilt * g.world_from_furniture) for g in state.groups))
    c = grasp_features(grasp_view(post_on_board, tilted), 1, 0, 0, 0)
    assert not np.allclose(a.single, c.single, atol=1e-2)


def test_groups_that_are_shared_change_no_feature(stand_grasps: GraspSamples) -> None:
    """Each group of an episode's states is made once, and what it keeps is that of fresh ones."""
    groups = GraspedGroups()
    seen: set[tuple[object, ...]] = set()
    for sample in stand_grasps.samples:
        view = stand_grasps.view(sample)
        shared, fresh = (grasp_features(view, *sample.pair, known) for known in (groups, None))
        for name in ("single", "pair", "exists", "in_reach"):
            np.testing.assert_array_equal(getattr(shared, name), getattr(fresh, name))
        for part in (sample.pair[0], sample.pair[2]):
            seen.add((part, view.connections[part].tobytes(), view.poses[part].tobytes()))
    assert len(groups) == len(seen)
