"""Clouds of observations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import shapes
from roboassembly.envs.observation import ObservationConfig, Observer, part_clouds, surface_points
from roboassembly.geometry.meshes import distances_to
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.part_frames import FramesName


def test_parts_of_one_class_share_a_cloud_even_if_their_meshes_differ() -> None:
    # Two legs that may swap places, one of them with a mark: as imported furniture has them.
    furniture = shapes.table()
    legs = next(c.members for c in furniture.classes if len(c.members) > 1)
    low, high = furniture.parts[legs[1]].mesh.bounds
    marked = shapes.box(low, [*high[:2], high[2] - 1e-4])
    parts = [replace(p, mesh=marked) if i == legs[1] else p for i, p in enumerate(furniture.parts)]
    clouds = part_clouds(replace(furniture, parts=tuple(parts)), 64)
    assert np.array_equal(clouds[legs[0]], clouds[legs[1]])
    assert np.array_equal(clouds[legs[0]], surface_points(furniture.parts[legs[0]].mesh, 64))


@pytest.mark.parametrize("frames", ["aligned", "own"])
def test_clouds_lie_on_the_meshes(frames: FramesName) -> None:
    furniture = shapes.table()
    task, rng = ObjectCentricTask(furniture), np.random.default_rng(3)
    observer = Observer(furniture, *furniture.padding, 64, ObservationConfig(frames), rng)
    clouds = observer.observe(task.initial_state(rng))["shapes"]
    for mesh, cloud in zip(observer.meshes, clouds, strict=False):
        assert distances_to(mesh.bvh, cloud).max() < 1e-6
