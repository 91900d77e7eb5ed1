"""Tests of own frames: principal axes, the 24 rotations, and what `w` then names."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from roboassembly.datasets import catalogue
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import BOX_ROTATIONS, SE3, rotations_from_euler
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.part_frames import PartFrames, principal_axes
from roboassembly.task.rules.connections import UP_AXES


@pytest.fixture(scope="module")
def stool() -> Furniture:
    return catalogue.make("stool", 1)


def turned_box(sides: tuple[float, float, float], angles: tuple[float, float, float]) -> tuple[Mesh, np.ndarray]:
    turn = rotations_from_euler(np.array(angles))
    box = trimesh.creation.box(sides)
    box.apply_transform(SE3(turn, np.zeros(3)).homogeneous)
    return Mesh.from_trimesh(box), turn


def test_there_are_24_different_rotations() -> None:
    assert BOX_ROTATIONS.shape == (24, 3, 3)
    assert len({r.tobytes() for r in BOX_ROTATIONS.round().astype(int)}) == 24
    assert np.allclose(BOX_ROTATIONS @ BOX_ROTATIONS.transpose(0, 2, 1), np.eye(3))
    assert np.allclose(np.linalg.det(BOX_ROTATIONS), 1.0)


@pytest.mark.parametrize(
    "sides", [(0.5, 0.3, 0.1), (0.6, 0.04, 0.04), (0.4, 0.4, 0.02), (0.2, 0.2, 0.2)],
    ids=["three sides", "square leg", "square board", "cube"],
)  # fmt: skip
def test_principal_axes_of_a_turned_box_are_its_edges(sides: tuple[float, float, float]) -> None:
    """Also where two or three moments of inertia are equal, and the inertia leaves the axes open."""
    mesh, _ = turned_box(sides, (0.4, -0.7, 1.1))
    axes = principal_axes(mesh)
    assert np.allclose(axes.T @ axes, np.eye(3))
    assert np.linalg.det(axes) == pytest.approx(1.0)
    extent = np.ptp(mesh.vertices @ axes, axis=0)
    assert sorted(extent) == pytest.approx(sorted(sides), rel=1e-3)


def test_equal_parts_share_their_frame_and_seeds_repeat_it(stool: Furniture) -> None:
    a, b, c = (PartFrames.own(stool, np.random.default_rng(seed)).part_from_own for seed in (0, 0, 1))
    assert (a == b).all()
    assert not np.allclose(a, c)
    for shape_class in stool.classes:
        assert all((a[m] == a[shape_class.members[0]]).all() for m in shape_class.members)


def test_w_names_an_axis_of_vs_own_part(stool: Furniture) -> None:
    """v's group waits with the named axis of part v up, whatever the furniture's frame is."""
    frames = PartFrames.own(stool, np.random.default_rng(3))
    task = ObjectCentricTask(stool).with_frames(frames)
    state = task.initial_state(np.random.default_rng(0))
    joint = stool.connections[0]
    for u, v, k, l in (  # noqa: E741
        (joint.part_a, joint.part_b, joint.point_a, joint.point_b),
        (joint.part_b, joint.part_a, joint.point_b, joint.point_a),
    ):
        for w in range(len(UP_AXES)):
            mating = task.prepare(state, (u, v, k, l, w))
            assert mating is not None
            part = mating.v_group.part_poses()[mating.v_group.parts.index(v)]
            up = part.rotation @ frames.part_from_own[v] @ UP_AXES[w]
            assert up == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)


def test_aligned_w_names_an_axis_of_the_furniture(stool: Furniture) -> None:
    task = ObjectCentricTask(stool)
    state = task.initial_state(np.random.default_rng(0))
    joint = stool.connections[0]
    for w in range(len(UP_AXES)):
        mating = task.prepare(state, (joint.part_a, joint.part_b, joint.point_a, joint.point_b, w))
        assert mating is not None
        assert mating.merged.world_from_furniture.rotation @ UP_AXES[w] == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)
