"""Importer for a folder of named parts or a GLB scene: units, axes, scene graphs, file formats, broken files."""

from __future__ import annotations

import json
import struct
from base64 import b64encode

import numpy as np
import pytest
import trimesh

from model_files import GLB_VIEWS, PART_PAIR, box, export, glb_accessors, write_glb, write_table
from roboassembly.errors import FurnitureError
from roboassembly.importers import folder
from roboassembly.importers.mesh_files import read_mesh

HALF = 0.5**0.5


@pytest.mark.parametrize("suffixes", [("obj", "stl", "ply"), ("glb", "obj", "stl")])
def test_each_file_is_a_part(tmp_path, suffixes):
    raw = folder.read(write_table(tmp_path / "table", suffixes=suffixes))
    assert [p.name for p in raw.parts] == ["left panel", "right panel", "top"]
    assert np.allclose(raw.parts[2].mesh.bounds, [[-0.5, -0.3, 0.4], [0.5, 0.3, 0.5]], atol=1e-6)
    assert np.allclose(raw.parts[0].mesh.bounds, [[-0.45, -0.3, 0.0], [-0.35, 0.3, 0.4]], atol=1e-6)
    assert all(p.mesh.is_solid for p in raw.parts)
    assert raw.provenance.identifier == "table"


@pytest.mark.parametrize(
    ("unit", "factor", "words"),
    [
        (1.0, 1.0, "guessed metres"),
        (0.3048, 0.3048, "guessed feet"),
        (0.0254, 0.0254, "guessed inches"),
        (0.01, 0.01, "guessed centimetres"),
        (0.001, 0.001, "guessed millimetres"),
        (1e-6, 1e-6, "scaled to 1 m"),
        (100.0, 100.0, "scaled to 1 m"),
    ],
)
def test_units(tmp_path, unit, factor, words):
    """A low table, 1 m long."""
    raw = folder.read(write_table(tmp_path / "table", unit))
    assert raw.provenance.scale == pytest.approx(factor, rel=1e-5)
    assert words in raw.provenance.notes[0]
    assert folder.read(tmp_path / "table", scale=unit).provenance.scale == unit


@pytest.mark.parametrize(
    ("up", "size"),
    [("z", (1.0, 0.6, 0.5)), ("y", (1.0, 0.5, 0.6)), ("x", (0.5, 0.6, 1.0)), ("-x", (0.5, 0.6, 1.0))],
)
def test_up_axis(tmp_path, up, size):
    raw = folder.read(write_table(tmp_path / "table"), up=up)
    corners = np.concatenate([p.mesh.bounds for p in raw.parts])
    assert np.allclose(np.ptp(corners, axis=0), size, atol=1e-6)
    assert corners[:, 2].min() == pytest.approx(0.0, abs=1e-6)
    assert all(p.mesh.is_solid for p in raw.parts), "turning must not mirror"


def test_upside_down(tmp_path):
    raw = folder.read(write_table(tmp_path / "table"), up="-z")
    assert np.allclose(raw.parts[2].mesh.bounds[:, 2], [0.0, 0.1], atol=1e-6)
    with pytest.raises(FurnitureError, match="up axis 'w' is not known"):
        folder.read(tmp_path / "table", up="w")  # pyright: ignore[reportArgumentType]


def test_scene_graph_transforms(tmp_path):
    """Root: 2 along x. Seat: cube stretched to 4 x 1 x 1. Back, below seat: a quarter turn about z, then 1 up (y)."""
    nodes = [
        {"name": "chair", "translation": [2, 0, 0], "children": [1]},
        {"name": "seat", "scale": [4, 1, 1], "mesh": 0, "children": [2]},
        {"name": "back", "translation": [0, 1, 0], "rotation": [0, 0, HALF, HALF], "mesh": 0},
    ]
    raw = folder.read(write_glb(tmp_path / "chair.glb", nodes), scale=1.0)
    assert [p.name for p in raw.parts] == ["seat", "back"]
    # glTF frame: seat x 2..6, y 0..1, z 0..1; back: cube turned to x -1..0, stretched to -4..0, so x -2..2, y 1..2.
    # z up: (x, -z, y), centred on x 2 and y -0.5.
    assert np.allclose(raw.parts[0].mesh.bounds, [[0, -0.5, 0], [4, 0.5, 1]], atol=1e-6)
    assert np.allclose(raw.parts[1].mesh.bounds, [[-4, -0.5, 1], [0, 0.5, 2]], atol=1e-6)
    assert raw.provenance.identifier == "chair"


def test_matrices_are_column_major_and_mirrors_stay_solid(tmp_path):
    matrix = [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 0, 0, 1]
    nodes = [{"children": [1, 2]}, {"name": "a", "mesh": 0}, {"name": "b", "mesh": 0, "matrix": matrix}]
    raw = folder.read(write_glb(tmp_path / "x.glb", nodes), scale=1.0)
    assert np.allclose(raw.parts[1].mesh.bounds[:, 0] - raw.parts[0].mesh.bounds[0, 0], [4, 5], atol=1e-6)
    assert all(p.mesh.is_solid for p in raw.parts)


def test_hierarchies_give_names_to_repeated_parts(tmp_path):
    """Two groups of two posts each: `left` from 0, `right` mirrored about x = 5; the top is in no group."""
    mirror = [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 10, 0, 0, 1]
    nodes = [
        {"name": "table", "children": [1, 4, 7]},
        {"name": "left", "children": [2, 3]},
        {"name": "post", "mesh": 0},
        {"name": "post", "mesh": 0, "translation": [0, 0, 4]},
        {"name": "right", "children": [5, 6], "matrix": mirror},
        {"name": "post", "mesh": 0},
        {"name": "far post", "mesh": 0, "translation": [0, 0, 4]},
        {"name": "top", "mesh": 0, "translation": [0, 1, 0], "scale": [10, 1, 5]},
    ]
    raw = folder.read(write_glb(tmp_path / "x.glb", nodes), scale=0.1)
    assert [p.name for p in raw.parts] == ["left/post", "left/post_2", "right/post", "far post", "top"]
    low = raw.parts[4].mesh.bounds[0]
    # glTF's x, y, z become x, -z, y: the right post lies at x 9..10 of the top's 0..10, at z 0..1, so -1..0 after it.
    assert np.allclose(raw.parts[2].mesh.bounds[:, 0] - low[0], [0.9, 1.0], atol=1e-6)
    assert np.allclose(raw.parts[2].mesh.bounds[:, 1] - low[1], [0.4, 0.5], atol=1e-6)
    assert all(p.mesh.is_solid and p.mesh.volume > 0 for p in raw.parts)


@pytest.mark.parametrize("kind", ["a file", "base64"])
def test_text_gltf(tmp_path, kind):
    """The same scene as GLB and as text, with its buffer in a file beside it or in the text."""
    glb = write_glb(tmp_path / "x.glb", PART_PAIR)
    data = glb.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document, buffer = json.loads(data[20 : 20 + length]), data[28 + length :]
    uri = (
        "my%20buffer.bin" if kind == "a file" else "data:application/octet-stream;base64," + b64encode(buffer).decode()
    )
    document["buffers"] = [{"byteLength": len(buffer), "uri": uri}]
    where = tmp_path / "text"
    where.mkdir()
    (where / "x.gltf").write_text(json.dumps(document))
    if kind == "a file":
        with pytest.raises(FurnitureError, match=r"my buffer.bin' cannot be read: No such file"):
            folder.read(where / "x.gltf")
        (where / "my buffer.bin").write_bytes(buffer)
    same, other = folder.read(where / "x.gltf"), folder.read(glb)
    assert [p.name for p in same.parts] == [p.name for p in other.parts] == ["a", "b"]
    for p, q in zip(same.parts, other.parts, strict=True):
        assert np.array_equal(p.mesh.vertices, q.mesh.vertices)
    assert folder.find(where) == [where / "x.gltf"]
    assert folder.reads(where / "x.gltf") == where.resolve(), "a change of the buffer changes the piece"


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("../secret.bin", "is not inside"),
        ("/etc/passwd", "is not inside"),
        ("data:text/plain,hello", "expected base64"),
        ("data:;base64,%%%", "not base64"),
        ("data:;base64,AAAA", "reads beyond its buffer"),
    ],
)
def test_buffers_elsewhere_are_refused(tmp_path, uri, message):
    (tmp_path / "secret.bin").write_bytes(b"x" * 200)
    data = write_glb(tmp_path / "x.glb", PART_PAIR).read_bytes()
    document = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])
    document["buffers"] = [{"byteLength": 168, "uri": uri}]
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "x.gltf").write_text(json.dumps(document))
    with pytest.raises(FurnitureError, match=message) as caught:
        folder.read(tmp_path / "in" / "x.gltf")
    assert "x.gltf" in str(caught.value)


def test_instances_of_an_extension_are_refused(tmp_path):
    """Without the extension the file would have one post instead of many."""
    path = write_glb(tmp_path / "x.glb", PART_PAIR, extensionsUsed=["EXT_mesh_gpu_instancing"])
    with pytest.raises(FurnitureError, match="requires EXT_mesh_gpu_instancing"):
        folder.read(path)


def test_names(tmp_path):
    """Nameless nodes belong to the named one above; at the top they take their mesh's name; repeats are numbered."""
    nodes = [
        {"children": [1, 3, 4, 5]},
        {"name": "leg", "children": [2]},
        {"mesh": 0},
        {"name": "leg", "mesh": 0, "translation": [2, 0, 0]},
        {"mesh": 0, "translation": [4, 0, 0]},
        {"mesh": 0, "translation": [6, 0, 0]},
    ]
    raw = folder.read(write_glb(tmp_path / "x.glb", nodes))
    assert [p.name for p in raw.parts] == ["leg", "leg_2", "cube", "cube_2"]


def test_nameless_pieces_of_one_part_are_joined(tmp_path):
    nodes = [
        {"children": [1, 4]},
        {"name": "leg", "children": [2, 3]},
        {"mesh": 0},
        {"mesh": 0, "translation": [0, 1, 0]},
        {"name": "top", "mesh": 0, "translation": [0, 2, 0]},
    ]
    raw = folder.read(write_glb(tmp_path / "x.glb", nodes))
    assert [(p.name, len(p.mesh.faces)) for p in raw.parts] == [("leg", 24), ("top", 12)]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("nodes", "changes", "message"),
    [
        ([{"children": [1]}, {"children": [0]}], {}, "reached twice"),
        ([{"children": [0]}], {}, "reached twice"),
        ([{"children": [1, 1]}, {"mesh": 0}], {}, "reached twice"),
        ([{"children": [7]}], {}, "node 7 is not there"),
        ([{"mesh": 3}], {}, "mesh 3 is not there"),
        ([{"mesh": -1}], {}, "mesh -1 is not there"),
        ([{"mesh": 0}], {}, "1 part; furniture has"),
        ([{"mesh": 0, "rotation": [0, 0, 0, 0]}], {}, "no direction"),
        ([{"mesh": 0, "matrix": [1]}], {}, "matrix of 1 numbers"),
        ([{"mesh": 0, "scale": [1e308, 1e308, 1]}], {}, "has a coordinate beyond"),
        ([{"scale": [1e200, 1, 1], "children": [1]}, {"mesh": 0, "scale": [1e200, 1, 1]}], {}, "not finite"),
        ([{"mesh": "x"}], {}, "not valid"),
        ([{"children": [k + 1]} for k in range(300)] + [{"mesh": 0}], {}, "nested deeper"),
        (PART_PAIR, {"scene": 5}, "scene 5"),
        (PART_PAIR, {"accessors": []}, "accessor 0"),
        (PART_PAIR, {"accessors": glb_accessors(count=2**60)}, "beyond its buffer"),
        (PART_PAIR, {"accessors": glb_accessors(count=9)}, "beyond its buffer"),
        (PART_PAIR, {"accessors": glb_accessors(byteOffset=-4)}, "beyond its buffer"),
        (PART_PAIR, {"accessors": glb_accessors(bufferView=None)}, "sparse or compressed"),
        (PART_PAIR, {"accessors": glb_accessors(sparse={"count": 1})}, "sparse or compressed"),
        (PART_PAIR, {"accessors": glb_accessors(type="VEC4")}, "not a list of points"),
        (PART_PAIR, {"bufferViews": [{**GLB_VIEWS[0], "byteStride": 0}, GLB_VIEWS[1]]}, "beyond its buffer"),
        (PART_PAIR, {"bufferViews": [{**GLB_VIEWS[0], "buffer": 1}, GLB_VIEWS[1]]}, "outside the file"),
        (PART_PAIR, {"extensionsRequired": ["KHR_draco_mesh_compression"]}, "requires KHR_draco"),
        (PART_PAIR, {"meshes": [{"primitives": []}]}, "has no faces"),
        (PART_PAIR, {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 9}]}]}, "mode 9"),
    ],
)
def test_broken_scenes(tmp_path, nodes, changes, message):
    with pytest.raises(FurnitureError, match=message) as caught:
        folder.read(write_glb(tmp_path / "x.glb", nodes, **changes))
    assert "\n" not in str(caught.value)
    assert "x.glb" in str(caught.value)


def test_amplification_is_refused(tmp_path):
    """Small files that expand to many millions of triangles are refused."""
    many = [{"children": list(range(1, 1_001))}, *({"name": "a", "mesh": 0} for _ in range(1_000))]
    primitives = [{"attributes": {"POSITION": 0}, "indices": 1}] * 2000
    with pytest.raises(FurnitureError, match="more than 2000000 faces"):
        folder.read(write_glb(tmp_path / "x.glb", many, meshes=[{"primitives": primitives}]))


def test_find(tmp_path):
    scenes = tmp_path / "set" / "scenes"
    scenes.mkdir(parents=True)
    table = write_table(tmp_path / "set" / "table")
    scene, other = write_glb(scenes / "a.glb", PART_PAIR), write_glb(scenes / "b.glb", PART_PAIR)
    assert folder.find(tmp_path) == sorted([table, scene, other])
    assert folder.find(scene) == [scene]
    write_glb(scenes / "c.glb", [{"mesh": 0}])
    assert folder.find(scenes) == [scenes], "not all are scenes: then each file is a part"
    assert folder.find(table / "top.obj") == [table / "top.obj"]
    with pytest.raises(
        FurnitureError, match=r"top\.obj': 1 part; furniture has 2 or more: give a folder of named parts"
    ):
        folder.read(table / "top.obj")
    with pytest.raises(FurnitureError, match="is not a folder"):
        folder.find(tmp_path / "gone")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FurnitureError, match="holds nothing to import"):
        folder.find(tmp_path / "empty")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.stl", b"ISO-10303-21;\n", r"a.stl' holds STEP by its contents; name it a.step"),
        ("a.step", b"PK\x03\x04 ", r"a.step' holds 3MF by its contents; name it a.3mf"),
        ("a.gltf", b"glTF\x02", r"a.gltf' holds GLB by its contents; name it a.glb"),
        ("a.obj", b"ply\nformat", r"a.obj' holds PLY by its contents; name it a.ply"),
    ],
)
def test_files_with_the_suffix_of_another_format(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FurnitureError, match=message):
        folder.read(tmp_path / name)


def test_files_without_parts(tmp_path):
    with pytest.raises(FurnitureError, match=r"x.glb' holds no triangles"):
        folder.read(write_glb(tmp_path / "x.glb", [{"name": "empty"}]))
    with pytest.raises(FurnitureError, match=r"gone.step' is not there"):
        folder.find(tmp_path / "gone.step")


def test_paths_that_are_not_files_are_refused(tmp_path):
    table = write_table(tmp_path / "table")
    (table / "more.obj").mkdir()
    assert len(folder.read(table).parts) == 3
    (table / "loop.obj").symlink_to(table / "loop.obj")
    assert len(folder.read(table).parts) == 3


FORMATS = [
    ("obj", {}),
    ("stl", {}),
    ("ply", {"encoding": "binary"}),
    ("ply", {"encoding": "ascii"}),
]


@pytest.mark.parametrize(("suffix", "options"), FORMATS)
def test_readers_agree_with_the_writer(tmp_path, suffix, options):
    mesh = trimesh.creation.icosphere(subdivisions=2)
    mesh.vertices[:] = np.round(mesh.vertices, 4)
    export(mesh, tmp_path / f"x.{suffix}", **options)
    got = read_mesh(tmp_path / f"x.{suffix}")
    again = trimesh.Trimesh(got.points, got.faces, process=False)
    assert again.is_volume
    assert len(got.faces) == len(mesh.faces)
    assert again.volume == pytest.approx(mesh.volume, rel=1e-4)


def test_ascii_stl(tmp_path):
    mesh = box((1, 2, 3))
    (tmp_path / "x.stl").write_text(mesh.export(file_type="stl_ascii"))
    got = read_mesh(tmp_path / "x.stl")
    assert np.allclose(np.ptp(got.points, axis=0), [1, 2, 3])


def test_ply_with_mixed_polygons(tmp_path):
    header = (
        b"ply\nformat binary_big_endian 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
        b"property uchar red\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
    )
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1)]
    body = b"".join(struct.pack(">fffB", *p, 7) for p in points)
    body += struct.pack(">B4i", 4, 0, 1, 2, 3) + struct.pack(">B3i", 3, 0, 1, 4)
    (tmp_path / "x.ply").write_bytes(header + body)
    got = read_mesh(tmp_path / "x.ply")
    assert len(got.faces) == 3
    assert len(got.points) == 5


PLY = "ply\nformat ascii 1.0\nelement vertex {v}\nproperty float x\nproperty float y\nproperty {z}\nelement face {f}\n"
PLY += "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n{face}\n"


def ply(v="3", z="float z", f="1", face="3 0 1 2") -> str:
    return PLY.format(v=v, z=z, f=f, face=face)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.ply", ply(v="99999999999"), "announced"),
        ("a.ply", ply(v="-3"), "header line"),
        ("a.ply", ply(v="9" * 30), "header line"),
        ("a.ply", ply(z="float w"), "not in list"),
        ("a.ply", ply(z="float x"), "declared twice"),
        ("a.ply", ply(z="complex z"), "header line"),
        ("a.ply", ply(f="7"), "announced"),
        ("a.ply", ply(face="3 0 1 9"), "there are 3 vertices"),
        ("a.ply", ply(face="30 0 1 2"), "ends in the middle"),
        ("a.ply", ply(face="-3 0 1 2"), "ends in the middle"),
        ("a.ply", ply(face="3 0 1 99999999999999999999"), "cannot be read as PLY"),
        ("a.ply", ply().replace("end_header", ""), "no header"),
        ("a.ply", ply().replace("ascii", "binary_little_endian"), "cannot be read as PLY"),
        ("a.stl", "solid x\nvertex 0 0\n", "cannot be read as STL"),
        ("a.stl", "solid x\nvertex 0 0 0\nvertex 1 0 0\nendsolid", "ends in the middle"),
        ("a.stl", "x" * 84, "bytes, where"),
        ("a.stl", "", "cannot be read as STL"),
        ("a.stl", "solid\nendsolid", "has no faces"),
        ("a.obj", f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 {'9' * 30}", "line 4 cannot be read"),
        ("a.obj", f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 {'9' * 9000}", "line 4 cannot be read"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1e300 0\nf 1 2 3", "no furniture is that large"),
        ("a.glb", "glTF", "cannot be read as GLB"),
        ("a.glb", "x" * 40, "does not begin with"),
        ("a.fbx", "x", "holds no mesh files"),
    ],
)
def test_broken_files(tmp_path, name, text, message):
    table = tmp_path / "table"
    table.mkdir()
    (table / name).write_text(text)
    if not name.endswith("fbx"):
        export(box((1, 1, 1)), table / "b.obj")
    with pytest.raises(FurnitureError, match=message) as caught:
        folder.read(table)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


def test_large_files_are_refused(tmp_path):
    table = write_table(tmp_path / "table")
    with (table / "top.obj").open("ab") as file:
        file.truncate(2**40)  # sparse: takes no room on disk
    with pytest.raises(FurnitureError, match="larger than 128 MiB"):
        folder.read(table)
