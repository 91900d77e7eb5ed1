"""PartNet v0 importer: leaves of the hierarchy, their names and meshes, and messages on broken files."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from roboassembly.errors import FurnitureError
from roboassembly.importers import partnet
from roboassembly.importers.findings import findings
from roboassembly.importers.pipeline import finish


def write_box(path: Path, extents: tuple[float, float, float], centre: tuple[float, float, float]) -> None:
    box = trimesh.creation.box(extents)
    box.apply_translation(centre)
    path.write_text(
        "\n".join(
            [
                *(f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in box.vertices),
                *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in box.faces),
            ]
        )
    )


def leaf(name: str, *objs: str) -> dict[str, object]:
    return {"name": name, "text": name, "id": 1, "ori_id": 1, "objs": list(objs)}


SEAT = {
    "name": "chair_seat",
    "objs": ["original-1", "new-1"],
    "children": [leaf("seat_surface", "original-1", "new-1")],
}
BASE = {"name": "chair_base", "objs": ["new-2", "new-3"], "children": [leaf("leg", "new-2"), leaf("leg", "new-3")]}


def write(folder: Path, hierarchy: object) -> Path:
    """A stool, y up: a seat of two boxes side by side, and two legs; 1 unit high, 2 wide, 1 deep."""
    (folder / "objs").mkdir(parents=True)
    write_box(folder / "objs" / "original-1.obj", (1.0, 0.2, 1.0), (-0.5, 0.4, 0.0))
    write_box(folder / "objs" / "new-1.obj", (1.0, 0.2, 1.0), (0.5, 0.4, 0.0))
    write_box(folder / "objs" / "new-2.obj", (0.1, 0.8, 0.1), (-0.9, -0.1, 0.4))
    write_box(folder / "objs" / "new-3.obj", (0.1, 0.8, 0.1), (0.9, -0.1, 0.4))
    (folder / "result_after_merging.json").write_text(json.dumps(hierarchy))
    (folder / "meta.json").write_text(json.dumps({"model_cat": "Chair", "model_id": "abc", "anno_id": "7"}))
    return folder


@pytest.fixture
def chair(tmp_path):
    return write(tmp_path / "data" / "7", [{"name": "chair", "children": [SEAT, BASE]}])


def test_leaf_nodes_become_parts(chair):
    raw = partnet.read(chair)
    assert [p.name for p in raw.parts] == ["chair_seat/seat_surface", "chair_base/leg", "chair_base/leg_2"]
    assert [p.label for p in raw.parts] == ["chair_seat/seat_surface", *["chair_base/leg"] * 2]
    assert [len(p.mesh.faces) for p in raw.parts] == [24, 12, 12]
    assert raw.provenance.source == "partnet"
    assert raw.provenance.identifier == "7"
    assert "abc" in raw.provenance.notes[0]


def test_y_up_becomes_z_up_at_typical_size(chair):
    # 2 wide, 1 high: 1.2 m wide comes before 0.85 m high, so a unit is 0.6 m.
    raw = partnet.read(chair)
    assert raw.provenance.scale == pytest.approx(0.6)
    seat, left, right = (p.mesh.bounds for p in raw.parts)
    assert np.allclose(seat, [[-0.6, -0.3, 0.48], [0.6, 0.3, 0.6]], atol=1e-6)
    # In the files the legs stand at z = +0.4, toward the viewer: after turning, at y = -0.24.
    assert np.allclose(left, [[-0.57, -0.27, 0.0], [-0.51, -0.21, 0.48]], atol=1e-6)
    assert np.allclose(right, [[0.51, -0.27, 0.0], [0.57, -0.21, 0.48]], atol=1e-6)
    assert np.allclose(partnet.read(chair, scale=1.0).parts[0].mesh.bounds[1], [1.0, 0.5, 1.0], atol=1e-6)


def test_a_mesh_listed_twice_counts_once(tmp_path):
    root = {"name": "chair", "children": [leaf("seat", "new-1", "new-1"), leaf("leg", "new-3")]}
    assert len(partnet.read(write(tmp_path / "x", [root])).parts[0].mesh.faces) == 12


def test_a_leaf_that_repeats_another_is_left_out_with_a_note(tmp_path):
    leaves = [leaf("seat", "original-1", "new-1"), leaf("leg", "new-2"), leaf("top", "new-1", "original-1")]
    raw = partnet.read(write(tmp_path / "x", [{"name": "chair", "children": leaves}]))
    assert [p.name for p in raw.parts] == ["seat", "leg"]
    assert raw.provenance.notes[1:] == ("leaf 'top' left out: it lists the same meshes as 'seat'",)
    twice = [{"name": "chair", "children": [leaf("leg", "new-2")] * 2}]
    with pytest.raises(FurnitureError, match="1 part; furniture has 2 or more"):
        partnet.read(write(tmp_path / "y", twice))


def test_numbered_names_never_collide(tmp_path):
    root = {"name": "chair", "children": [leaf("leg", "new-1"), leaf("leg", "new-2"), leaf("leg_2", "new-3")]}
    names = [p.name for p in partnet.read(write(tmp_path / "x", [root])).parts]
    assert names == ["leg", "leg_3", "leg_2"]


def test_without_meta(chair):
    (chair / "meta.json").unlink()
    assert partnet.read(chair).provenance.scale == pytest.approx(0.6)


def test_find_at_every_level(chair, tmp_path):
    for start in (chair, chair.parent, tmp_path):
        assert partnet.find(start) == [chair]
    with pytest.raises(FurnitureError, match="holds nothing to import"):
        partnet.find(chair / "objs")
    with pytest.raises(FurnitureError, match="is not a folder"):
        partnet.find(tmp_path / "nowhere")


def nested(depth: int) -> dict[str, object]:
    node = leaf("leg", "new-1")
    for _ in range(depth):
        node = {"name": "n", "children": [node]}
    return node


@pytest.mark.parametrize(
    ("hierarchy", "message"),
    [
        ([], "0 roots"),
        ([SEAT, BASE], "2 roots"),
        ({"name": "chair"}, "not valid"),
        ([{"name": 3}], "not valid"),
        ([{"name": "chair", "children": [{"name": "seat", "objs": [1]}]}], "not valid"),
        ([{"name": "chair", "children": [leaf("seat"), leaf("leg", "new-2")]}], "part 'seat' lists 0 meshes"),
        ([leaf("chair", "new-1")], "1 part; furniture has 2 or more"),
        ([{"name": "chair", "children": [leaf("leg", "new-2")] * 1001}], "1001 parts; furniture has 2 to 1000"),
        ([{"name": "chair", "children": [leaf("leg", "new-2")] * 3000}], "more than 2000 nodes"),
        ([{"name": "chair", "children": [leaf("a", "gone"), leaf("leg", "new-2")]}], "part 'a'.*cannot be read"),
        ([{"name": "chair", "children": [leaf("a", "../../out"), leaf("leg", "new-2")]}], "not inside"),
        ([{"name": "chair", "children": [leaf("a", "/etc/passwd"), leaf("leg", "new-2")]}], "not inside"),
        ([nested(40)], "deeper than 32 levels"),
    ],
)
def test_broken_hierarchies(tmp_path, hierarchy, message):
    with pytest.raises(FurnitureError, match=message) as caught:
        partnet.read(write(tmp_path / "x", hierarchy))
    assert "\n" not in str(caught.value)


def test_hostile_json(chair):
    file = chair / "result_after_merging.json"
    for text in ("", "[", '[{"name": "a", "children": ' * 5000, "\xff", "null"):
        file.write_text(text)
        with pytest.raises(FurnitureError, match="result_after_merging"):
            partnet.read(chair)


def test_absurd_scale(chair):
    for scale in (1e-9, 1e9):
        with pytest.raises(FurnitureError, match="name the unit of the files"):
            partnet.read(chair, scale=scale)
    with pytest.raises(FurnitureError, match="not a positive number"):
        partnet.read(chair, scale=-1.0)


def stacked(folder: Path, overlap: float) -> Path:
    """Two blocks with the same footprint, one on top of the other and in it, in metres."""
    (folder / "objs").mkdir(parents=True)
    write_box(folder / "objs" / "low.obj", (0.3, 0.4, 0.3), (0.0, 0.2, 0.0))
    write_box(folder / "objs" / "high.obj", (0.3, 0.5, 0.3), (0.0, 0.65 - overlap, 0.0))
    hierarchy = [{"name": "chair", "children": [leaf("low", "low"), leaf("high", "high")]}]
    (folder / "result_after_merging.json").write_text(json.dumps(hierarchy))
    return folder


def test_drawn_parts_may_lose_more_than_parts_with_joints(tmp_path):
    raw = partnet.read(stacked(tmp_path / "1", 0.02), scale=1.0)
    imported = finish("stack", raw)
    low, high = imported.furniture.parts
    # 20 mm of overlap and the gap of 0.2 mm go from one of them; the set-back of 0.15 mm a face from both.
    left = [np.ptp(part.mesh.bounds, axis=0).max() for part in (low, high)]
    assert sum(left) == pytest.approx(0.4 + 0.5 - 0.0202, abs=1e-3)
    assert "smaller" in str(findings(raw, imported.furniture, imported.repairs))
    with pytest.raises(FurnitureError, match=r"19\.9 mm less deep .* at most 5\.0 mm"):
        finish("stack", replace(raw, drawn=False))


def test_drawn_parts_may_not_lose_everything(tmp_path):
    raw = partnet.read(stacked(tmp_path / "1", 0.07), scale=1.0)
    with pytest.raises(FurnitureError, match=r"at most 50\.0 mm is allowed .*--allow-shortening"):
        finish("stack", raw)
    assert len(finish("stack", raw, allow_shortening=True).furniture.parts) == 2


SAMPLES = Path(os.environ.get("ROBOASSEMBLY_SAMPLES", "/nonexistent")) / "partnet"


@pytest.mark.skipif(not SAMPLES.is_dir(), reason="PartNet is behind a licence form; put v0 folders into partnet/")
def test_samples():
    for folder in partnet.find(SAMPLES)[:3]:
        raw = partnet.read(folder)
        assert all(p.label for p in raw.parts)
