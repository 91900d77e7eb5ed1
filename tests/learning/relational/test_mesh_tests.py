"""Tests on meshes: boxes that overlap, block or pass each other, and what a layout makes of it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from jaxtyping import Float

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, rotations_from_euler
from roboassembly.learning.relational.layout_search import LayoutProblem, find_layouts
from roboassembly.learning.relational.mesh_tests import SHRUNK, GroupMeshes, PartMeshes, Pose

ALONG_X, ALONG_Y, UP = np.eye(3)


def box(*sides: float) -> Mesh:
    """Return a box around the origin [m]."""
    return Mesh.from_trimesh(trimesh.creation.box(sides))


def at(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Pose:
    return np.eye(3), np.array([x, y, z])


@pytest.fixture
def block_and_frame() -> PartMeshes:
    """Return a block of 40 mm, and a frame 60 mm thick with a hole of 41 mm through it along z."""
    frame = trimesh.boolean.difference(
        [trimesh.creation.box((0.1, 0.1, 0.06)), trimesh.creation.box((0.041, 0.041, 0.1))]
    )
    return PartMeshes([box(0.04, 0.04, 0.04), Mesh.from_trimesh(frame)])


@pytest.mark.parametrize(("depth", "overlaps"), [(-0.001, False), (1.5 * SHRUNK, False), (3.0 * SHRUNK, True)])
def test_boxes_overlap_beyond_what_is_lost_by_shrinking(depth: float, overlaps: bool) -> None:
    meshes = PartMeshes([box(0.1, 0.1, 0.1), box(0.1, 0.1, 0.1)])
    assert meshes.overlap(0, 1, at(0.1 - depth)) == overlaps
    assert meshes.overlap(1, 0, at(depth - 0.1)) == overlaps


def test_a_block_leaves_a_hole_along_it_only(block_and_frame: PartMeshes) -> None:
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    assert np.allclose(axes[~block_and_frame.blocked(0, 1, at(), axes)], [UP, -UP])
    assert not block_and_frame.overlap(0, 1, at())
    # Not quite where it belongs, it still leaves.
    assert not block_and_frame.blocked(0, 1, at(0.0006), UP[None]).any()


def test_what_stands_far_away_is_in_the_way_of_what_meets_it() -> None:
    meshes = PartMeshes([box(0.04, 0.04, 0.04), box(0.008, 0.1, 0.1)])
    ways = np.array([ALONG_X, -ALONG_X, ALONG_Y])
    assert meshes.blocked(0, 1, at(-0.8), ways).tolist() == [True, False, False]
    assert not meshes.blocked(0, 1, at(-0.8, 0.1), ways).any()


def test_a_result_does_not_depend_on_earlier_ones() -> None:
    poses = [at(0.098 + step * 2e-5) for step in range(-10, 11)]
    there = PartMeshes([box(0.1, 0.1, 0.1)] * 2)
    back = PartMeshes([box(0.1, 0.1, 0.1)] * 2)
    first = [there.overlap(0, 1, pose) for pose in poses]
    assert first == [back.overlap(0, 1, pose) for pose in reversed(poses)][::-1]
    assert set(first) == {True, False}


def test_an_open_surface_is_in_nobodys_way() -> None:
    whole = box(0.1, 0.1, 0.1)
    meshes = PartMeshes([whole, Mesh(whole.vertices, whole.faces[1:])])
    assert not meshes.overlap(0, 1, at())
    assert not meshes.blocked(0, 1, at(), np.eye(3)).any()


def test_groups_are_tested_wherever_a_layout_lies(block_and_frame: PartMeshes) -> None:
    turn = rotations_from_euler(np.array([[0.3, -0.4, 2.0]]))[0]
    place = turn, np.array([0.2, -0.1, 0.5])
    groups = GroupMeshes(block_and_frame, [(0,), (1,)], np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3)))
    assert not groups.overlap(0, place, 1, place)
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    blocked = groups.blocked(0, place, 1, place, axes @ turn.T)
    assert np.allclose(axes[~blocked], [UP, -UP])


def test_a_layout_in_which_meshes_overlap_is_not_taken() -> None:
    problem = two_sockets_problem()
    assert place_of_block(problem) == 0
    # Beside the first socket stands a wall of the base; the block is too wide for it.
    base = trimesh.boolean.union(
        [
            trimesh.creation.box(
                (0.4, 0.1, 0.02), np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -0.01], [0, 0, 0, 1.0]])
            ),
            trimesh.creation.box(
                (0.02, 0.1, 0.1), np.array([[1, 0, 0, -0.13], [0, 1, 0, 0], [0, 0, 1, 0.04], [0, 0, 0, 1.0]])
            ),
        ]
    )
    block = box(0.08, 0.08, 0.06).transformed(SE3(np.eye(3), np.array([0.0, 0.0, 0.03])))
    meshes = GroupMeshes(
        PartMeshes([Mesh.from_trimesh(base), block]), [(0,), (1,)], np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3))
    )
    assert place_of_block(two_sockets_problem(meshes)) == 1


def two_sockets_problem(meshes: GroupMeshes | None = None) -> LayoutProblem:
    """Return a base with two sockets for one block; the first one looks better."""
    up, down = np.eye(3), np.diag([1.0, -1.0, -1.0])
    position: Float[np.ndarray, "3 3"] = np.array([[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
    cost = np.full((3, 3), np.inf)
    cost[0, 2] = cost[2, 0] = 0.01
    cost[1, 2] = cost[2, 1] = 0.3
    return LayoutProblem(np.array([0, 0, 1]), position, np.array([up, up, down]), cost, (0, 1), meshes)


def place_of_block(problem: LayoutProblem) -> int:
    """Return the socket that the best layout takes."""
    ((socket, _),) = find_layouts(problem)[0].mates
    return socket
