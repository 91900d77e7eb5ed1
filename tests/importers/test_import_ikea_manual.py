"""IKEA-Manuals-at-Work importer: reading of pieces, and messages on broken files."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from roboassembly.errors import FurnitureError
from roboassembly.importers import ikea_manual

BOX = trimesh.creation.box((1.0, 2.0, 0.5))


def write_box(path: Path, shift=(0.0, 0.0, 0.0)) -> None:
    lines = ["# a box"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in BOX.vertices + shift]
    lines += [f"f {a + 1}//1 {b + 1}//1 {c + 1}//1" for a, b, c in BOX.faces]
    path.write_text("\n".join(lines))


@pytest.fixture
def chair(tmp_path):
    folder = tmp_path / "parts" / "Chair" / "plain"
    folder.mkdir(parents=True)
    write_box(folder / "00.obj")
    write_box(folder / "01.obj", shift=(1.0, 0.0, 0.0))
    return folder


def test_y_up_becomes_z_up_at_typical_height(chair):
    parts = ikea_manual.read(chair).parts
    assert [p.name for p in parts] == ["00", "01"]
    points = np.concatenate([p.mesh.vertices for p in parts])
    # Two boxes side by side: 2 wide, 2 high, 0.5 deep; 0.85 m high makes the factor 0.425.
    assert np.allclose(np.ptp(points, axis=0), [0.85, 0.2125, 0.85], atol=1e-6)
    assert np.allclose(points.min(axis=0), [-0.425, -0.10625, 0.0], atol=1e-6)
    assert all(p.mesh.is_solid for p in parts)


def test_right_handed(chair):
    part = ikea_manual.read(chair, scale=1.0).parts[1]
    assert part.mesh.volume == pytest.approx(1.0, rel=1e-5)
    assert part.mesh.bounds[0, 0] == pytest.approx(0.0, abs=1e-6)


def test_long_pieces_are_scaled_by_their_longest_side():
    assert ikea_manual.scale_for("Chair", np.array([1.0, 1.0, 1.0])) == pytest.approx(0.85)
    assert ikea_manual.scale_for("Chair", np.array([2.4, 0.6, 0.5])) == pytest.approx(0.5)
    assert ikea_manual.scale_for("Unheard-of", np.array([1.0, 1.7, 1.0])) == pytest.approx(0.5)


def test_polygons_and_negative_indices(tmp_path):
    (tmp_path / "00.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf -4 -3 -2 -1\n")
    write_box(tmp_path / "01.obj")
    assert len(ikea_manual.read(tmp_path).parts[0].mesh.faces) == 2


def test_find_at_every_level(chair):
    root = chair.parents[2]
    for start in (chair, chair.parent, root / "parts", root):
        assert ikea_manual.find(start) == [chair]


def test_missing_folder(tmp_path):
    with pytest.raises(FurnitureError, match="is not a folder"):
        ikea_manual.read(tmp_path / "nowhere")
    with pytest.raises(FurnitureError, match="is not a folder"):
        ikea_manual.find(tmp_path / "nowhere")


def test_no_files(tmp_path):
    with pytest.raises(FurnitureError, match=r"holds no \.obj files"):
        ikea_manual.read(tmp_path)
    with pytest.raises(FurnitureError, match=r"holds no \.obj files"):
        ikea_manual.find(tmp_path)


def test_one_part_is_no_furniture(tmp_path):
    write_box(tmp_path / "00.obj")
    with pytest.raises(FurnitureError, match="1 part; furniture has 2 or more"):
        ikea_manual.read(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v 0 0 zero\nf 1 1 1\n", "line 1 cannot be read as OBJ"),
        ("v 0 0\n", "line 1 cannot be read as OBJ"),
        ("v 0 0 0\nf 1 x 1\n", "line 2 cannot be read as OBJ"),
        ("", "has no faces"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "has no faces"),
        ("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "vertex 0 is not finite"),
        ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "zero area"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "there are 3 vertices"),
    ],
)
def test_broken_files(chair, text, message):
    (chair / "01.obj").write_text(text)
    with pytest.raises(FurnitureError, match=message) as caught:
        ikea_manual.read(chair)
    assert "01.obj" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_non_text_bytes_are_refused(chair):
    (chair / "01.obj").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(FurnitureError, match="cannot be read as OBJ"):
        ikea_manual.read(chair)


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan")])
def test_bad_scale(chair, scale):
    with pytest.raises(FurnitureError, match="not a positive number"):
        ikea_manual.read(chair, scale=scale)


SAMPLES = Path(os.environ.get("ROBOASSEMBLY_SAMPLES", "/nonexistent")) / "ikea_manuals_at_work"


@pytest.mark.skipif(not SAMPLES.is_dir(), reason="set ROBOASSEMBLY_SAMPLES to the folder of sample furniture")
def test_every_sample_reads():
    pieces = ikea_manual.find(SAMPLES)
    assert sum(piece.parent.name == "Chair" for piece in pieces) == 24
    for piece in [p for p in pieces if p.parent.name == "Chair"][:6]:
        points = np.concatenate([p.mesh.vertices for p in ikea_manual.read(piece).parts])
        assert points[:, 2].min() == pytest.approx(0.0, abs=1e-6)
        assert 0.3 < np.ptp(points[:, 2]) <= 0.8501
