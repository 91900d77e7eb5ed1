"""FurnitureBench importer: poses chained from assembled_poses.json, and messages on broken files."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from roboassembly.errors import FurnitureError
from roboassembly.importers import furniture_bench


def at(x: float, y: float, z: float, rotation=((1, 0, 0), (0, 1, 0), (0, 0, 1))) -> list[list[float]]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, (x, y, z)
    return matrix.tolist()


QUARTER = ((0, 0, 1), (0, 1, 0), (-1, 0, 0))
"""Quarter turn about y: z becomes x, x becomes -z."""


def table() -> dict:
    """A top and two legs below it (y points down), one alternative for both; a foot under the first leg."""
    legs = [at(-0.1, 0.11, 0), at(0.1, 0.11, 0, QUARTER)]
    return {
        "parts": ["top", "leg", "leg", "foot"],
        "mesh": ["mesh/table/top.obj", "mesh/table/leg.obj", "mesh/table/leg.obj", "mesh/table/foot.obj"],
        "assembled_rel_poses": [
            {"parent": 2, "child": 3, "alternatives": [at(0.05, 0.1, 0)]},
            {"parent": 0, "child": 1, "alternatives": legs},
            {"parent": 0, "child": 2, "alternatives": legs},
        ],
    }


def write(root: Path, furniture: dict) -> Path:
    folder = root / "mesh" / "table"
    folder.mkdir(parents=True, exist_ok=True)
    for name, extents in (("top", (0.3, 0.02, 0.2)), ("leg", (0.02, 0.2, 0.04)), ("foot", (0.1, 0.02, 0.02))):
        (folder / f"{name}.obj").write_text(trimesh.creation.box(extents).export(file_type="obj"))
    (root / "assembled_poses.json").write_text(json.dumps({"source": "here", "furniture": furniture}))
    return folder


def test_poses_are_chained_and_each_alternative_is_used_once(tmp_path):
    raw = furniture_bench.read(write(tmp_path, {"table": table()}))
    assert [p.name for p in raw.parts] == ["top", "leg", "leg_2", "foot"]
    top, left, right, foot = (p.mesh.bounds for p in raw.parts)
    # -y up: (x, y, z) becomes (x, z, -y), above the lowest point at y = 0.22.
    assert np.allclose(top, [[-0.15, -0.1, 0.21], [0.15, 0.1, 0.23]], atol=1e-6)
    assert np.allclose(left, [[-0.11, -0.02, 0.01], [-0.09, 0.02, 0.21]], atol=1e-6)
    assert np.allclose(right, [[0.08, -0.01, 0.01], [0.12, 0.01, 0.21]], atol=1e-6)
    # In the turned leg's frame the foot is 0.05 along x: along -z of the top, which is -y here.
    assert np.allclose(foot, [[0.09, -0.1, 0.0], [0.11, 0.0, 0.02]], atol=1e-6)


def test_find(tmp_path):
    folder = write(tmp_path / "a" / "b", {"table": table()})
    for start in (tmp_path, folder.parents[1], folder.parent, folder):
        assert furniture_bench.find(start) == [folder]
    with pytest.raises(FurnitureError, match="has no piece 'chair'; it has table"):
        furniture_bench.read(folder.parent / "chair")
    with pytest.raises(FurnitureError, match="is not a folder"):
        furniture_bench.find(tmp_path / "gone")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"parts": ["top"]}, "1 part; furniture has"),
        ({"mesh": ["mesh/table/top.obj"]}, "4 parts and 1 meshes"),
        ({"mesh": ["../x.obj", "a", "a", "a"]}, "not inside"),
        ({"mesh": ["mesh/table/gone.obj", "a", "a", "a"]}, "cannot be read"),
        ({"assembled_rel_poses": []}, "no chain of poses leads to part 'leg'"),
        ({"assembled_rel_poses": [{"parent": 1, "child": 2, "alternatives": [at(0, 0, 0)]}] * 2}, "no chain of poses"),
        ({"assembled_rel_poses": [{"parent": 0, "child": 0, "alternatives": [at(0, 0, 0)]}]}, "placed twice"),
        ({"assembled_rel_poses": [{"parent": 0, "child": 9, "alternatives": [at(0, 0, 0)]}]}, "does not exist"),
        ({"assembled_rel_poses": [{"parent": 0, "child": 1, "alternatives": []}]}, "no pose that is free"),
        ({"assembled_rel_poses": [{"parent": 0, "child": 1, "alternatives": [[[1]]]}]}, "4 rows of 4"),
        ({"assembled_rel_poses": [{"parent": 0, "child": 1, "alternatives": [[[0.0] * 4] * 4]}]}, "a rotation and a"),
        ({"assembled_rel_poses": [{"parent": 0, "child": 1, "alternatives": [at(1e30, 0, 0)]}]}, "a rotation and a"),
        ({"assembled_rel_poses": [{"parent": 0, "child": 1, "alternatives": [at(0, 0, 0)]}] * 99}, "99 poses for"),
        ({"assembled_rel_poses": 3}, "not valid"),
    ],
)
def test_broken_poses(tmp_path, change, message):
    folder = write(tmp_path, {"table": {**table(), **change}})
    with pytest.raises(FurnitureError, match=message) as caught:
        furniture_bench.read(folder)
    assert "\n" not in str(caught.value)


def test_mesh_names_outside_the_folder_are_refused(tmp_path):
    write(tmp_path, {"../../etc": table()})
    with pytest.raises(FurnitureError, match="not inside"):
        furniture_bench.find(tmp_path)


SAMPLES = Path(os.environ.get("ROBOASSEMBLY_SAMPLES", "/nonexistent")) / "furniture_bench"


@pytest.mark.slow
@pytest.mark.skipif(not SAMPLES.is_dir(), reason="set ROBOASSEMBLY_SAMPLES to the folder of sample furniture")
def test_samples_stand_on_their_feet():
    pieces = {path.name: furniture_bench.read(path) for path in furniture_bench.find(SAMPLES)}
    assert len(pieces) == 8
    for name in ("desk", "square_table", "round_table"):
        top, *legs = (p.mesh.bounds for p in pieces[name].parts)
        assert top[1, 2] > max(leg[1, 2] for leg in legs)
    assert all(0.05 < max(np.ptp(p.mesh.bounds[:, 2]) for p in raw.parts) < 0.3 for raw in pieces.values())
