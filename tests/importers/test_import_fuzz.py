"""Fuzz test of every importer: a broken source gives a result or a `FurnitureError`, quickly, and writes nothing."""

from __future__ import annotations

import json
import re
import struct
import tempfile
import time
import warnings
import zipfile
from io import BytesIO
from pathlib import Path

import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from roboassembly.errors import FurnitureError
from roboassembly.furniture.model import MIN_PARTS
from roboassembly.importers import IMPORTERS

SECONDS = 20.0
"""Time limit that only a hang exceeds, even on a loaded machine [s]."""
BOX = trimesh.creation.box((0.4, 0.3, 0.2))


def as_bytes(mesh: trimesh.Trimesh, suffix: str, **options) -> bytes:
    data = mesh.export(file_type=suffix, **options)
    return data if isinstance(data, bytes) else str(data).encode()


OBJ, STL, GLB = (as_bytes(BOX, suffix) for suffix in ("obj", "stl", "glb"))
PLY, ASCII_PLY = as_bytes(BOX, "ply"), as_bytes(BOX, "ply", encoding="ascii")
ASCII_STL = as_bytes(BOX, "stl_ascii")
SCENE = trimesh.Scene()
for _k in range(3):
    SCENE.add_geometry(
        BOX, node_name=f"part{_k}", transform=trimesh.transformations.translation_matrix((0.4 * _k, 0, 0))
    )
SCENE_GLB = SCENE.export(file_type="glb")
_LENGTH = struct.unpack_from("<I", SCENE_GLB, 12)[0]
_DOCUMENT = json.loads(SCENE_GLB[20 : 20 + _LENGTH])
_DOCUMENT["buffers"][0]["uri"] = "new-0"
SCENE_GLTF, SCENE_BUFFER = json.dumps(_DOCUMENT).encode(), SCENE_GLB[28 + _LENGTH :]
MODEL_3MF = (
    '<model xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" unit="inch"><resources>'
    '<object id="1" name="a"><mesh><vertices>'
    + "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in BOX.vertices * 40)
    + "</vertices><triangles>"
    + "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in BOX.faces)
    + '</triangles></mesh></object><object id="2" name="b"><components><component objectid="1"/>'
    '<component objectid="1" transform="1 0 0 0 1 0 0 0 1 16 0 0"/></components></object></resources>'
    '<build><item objectid="2"/></build></model>'
).encode()


def as_3mf(model: bytes) -> bytes:
    """Return an archive with the model, packed without compression, so that damage reaches it."""
    out = BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("3D/3dmodel.model", model)
    return out.getvalue()


IDENTITY = [[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]]
MJCF = (
    '<mujoco><asset><mesh file="m/a.stl" name="a" scale="1 1 1"/><mesh file="m/b.stl" name="b"/></asset><worldbody>'
    '<body name="1" pos="0 0 0" quat="1 0 0 0"><geom mesh="a" type="mesh"/>'
    '<site name="a-b,0,90,conn_site1" pos="0 0 0.1" quat="1 0 0 0"/><site name="a-b,0,90,conn_site2" pos="0.1 0 0.1"/>'
    '</body><body name="2"><geom mesh="b" type="mesh"/><site name="b-a,0,90,conn_site1" pos="0 0 -0.1"/>'
    '<site name="b-a,0,90,conn_site2" pos="0.1 0 -0.1"/></body></worldbody></mujoco>'
)
HIERARCHY = [
    {
        "name": "chair",
        "children": [
            {"name": "seat", "objs": ["new-0"]},
            {"name": "legs", "children": [{"name": "leg", "objs": ["new-1"]}]},
        ],
    }
]
BENCH = {
    "furniture": {
        "t": {
            "parts": ["a", "b"],
            "mesh": ["mesh/t/a.obj", "mesh/t/b.obj"],
            "assembled_rel_poses": [{"parent": 0, "child": 1, "alternatives": [IDENTITY]}],
        }
    }
}
SOURCES: dict[str, list[dict[str, bytes]]] = {
    "partnet": [
        {
            "result_after_merging.json": json.dumps(HIERARCHY).encode(),
            "meta.json": b'{"model_cat": "Chair"}',
            "objs/new-0.obj": OBJ,
            "objs/new-1.obj": OBJ,
        }
    ],
    "ikea-manual": [{"Chair/x/00.obj": OBJ, "Chair/x/01.obj": OBJ}],
    "ikea-env": [{"x.xml": MJCF.encode(), "m/a.stl": STL, "m/b.stl": ASCII_STL}],
    "furniture-bench": [{"assembled_poses.json": json.dumps(BENCH).encode(), "mesh/t/a.obj": OBJ, "mesh/t/b.obj": OBJ}],
    "folder": [
        {"a.obj": OBJ, "b.stl": STL, "c.ply": PLY, "d.glb": GLB, "e.ply": ASCII_PLY},
        {"scene.glb": SCENE_GLB},
        {"scene.gltf": SCENE_GLTF, "new-0": SCENE_BUFFER},
        {"scene.3mf": as_3mf(MODEL_3MF)},
    ],
}
TOKENS = [
    b"-1", b"0", b"1e308", b"-1e308", b"nan", b"inf", b"99999999999999999999", b"4294967295", b"", b"null", b"{}",
    b'"x"', b"\x00", b"\xff\xff\xff\xff", b"[]", b"true", b"1e-320", b"!!python/object/apply:os.system", b"&amp;",
    b"a" * 5000,
]  # fmt: skip
KINDS = ["number", "json", "path", "flip", "cut", "number", "json", "path", "insert", "swap", "repeat", "gone", "noise"]
"""Kinds of damage; those that leave most of the source intact are more frequent."""
PATHS = [
    b"../secret.obj",
    b"../../../../etc/passwd",
    b"/dev/zero",
    b"/etc/passwd",
    b"m/../../secret.stl",
    b"..",
    b"a\\..\\b",
]


@st.composite
def damaged(draw: st.DrawFn, kind: str) -> dict[str, bytes]:
    """Draw a source with one to three kinds of damage."""
    files = dict(draw(st.sampled_from(SOURCES[kind])))
    for _ in range(draw(st.integers(1, 3))):
        name = draw(st.sampled_from(sorted(files)))
        data = files[name]
        match draw(st.sampled_from(KINDS)):
            case "number" | "path" | "insert" if name.endswith(".3mf"):
                model = MODEL_3MF
                for spot in draw(st.lists(st.sampled_from(list(re.finditer(rb"[\w./:]+", model))), max_size=1)):
                    model = model[: spot.start()] + draw(st.sampled_from(TOKENS)) + model[spot.end() :]
                files[name] = as_3mf(model)
            case "cut":
                files[name] = data[: draw(st.integers(0, len(data)))]
            case "flip" if data:
                at = draw(st.integers(0, len(data) - 1))
                files[name] = data[:at] + bytes([draw(st.integers(0, 255))]) + data[at + 1 :]
            case "number" if spots := list(re.finditer(rb"-?\d+(\.\d+)?", data)):
                spot = draw(st.sampled_from(spots))
                files[name] = data[: spot.start()] + draw(st.sampled_from(TOKENS)) + data[spot.end() :]
            case "path" if spots := list(re.finditer(rb"new-0|m/a\.stl|mesh/t/a\.obj", data)):
                spot = draw(st.sampled_from(spots))
                files[name] = data[: spot.start()] + draw(st.sampled_from(PATHS)) + data[spot.end() :]
            case "insert":
                at = draw(st.integers(0, len(data)))
                files[name] = data[:at] + draw(st.sampled_from(TOKENS)) + data[at:]
            case "swap":
                files[name] = files[draw(st.sampled_from(sorted(files)))]
            case "repeat" if data:
                a, b = sorted((draw(st.integers(0, len(data))), draw(st.integers(0, len(data)))))
                files[name] = data[:b] + data[a:b] * draw(st.integers(1, 200)) + data[b:]
                files[name] = files[name][:50_000]
            case "gone" if len(files) > 1:
                del files[name]
            case "json" if name.endswith((".json", ".glb", ".gltf")):
                files[name] = draw(json_damage(data, name.endswith(".glb")))
            case _:
                files[name] = draw(st.binary(max_size=200))
    return files


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-3, 10**12) | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


@st.composite
def json_damage(draw: st.DrawFn, data: bytes, is_glb: bool) -> bytes:
    """Replace one value in the JSON by another, or by a copy from elsewhere in it (loops)."""
    length = struct.unpack_from("<I", data, 12)[0] if is_glb and len(data) >= 20 else 0
    try:
        root = json.loads(data[20 : 20 + length] if is_glb else data)
    except (ValueError, RecursionError):
        return data[:-1]
    places = []
    stack: list[object] = [root]
    while stack:
        here = stack.pop()
        items = list(here.items() if isinstance(here, dict) else enumerate(here) if isinstance(here, list) else [])
        places += [(here, key) for key, _ in items]
        stack += [value for _, value in items]
    if places:
        here, key = draw(st.sampled_from(places))
        if draw(st.booleans()):
            other, there = draw(st.sampled_from(places))
            here[key] = json.loads(json.dumps(other[there]))
        else:
            here[key] = draw(JSON)
    text = json.dumps(root).encode()
    if not is_glb:
        return text
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    return data[:4] + struct.pack("<III", 2, 20 + len(text) + len(rest), len(text)) + data[16:20] + text + rest


def check(kind: str, files: dict[str, bytes], scale: float | None) -> None:
    importer = IMPORTERS[kind]
    with tempfile.TemporaryDirectory() as scratch, warnings.catch_warnings():
        warnings.simplefilter("error")
        outer = Path(scratch)
        for name in ("secret.obj", "secret.stl"):
            (outer / name).write_bytes(OBJ if name.endswith("obj") else STL)
        root = outer / "in"
        for name, data in files.items():
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_bytes(data)
        before = {path: path.stat().st_mtime_ns for path in outer.rglob("*")}
        started = time.perf_counter()
        try:
            pieces = importer.find(root)
        except FurnitureError as problem:
            assert_clear(problem)
            pieces = []
        for piece in pieces:
            assert piece.resolve().is_relative_to(root.resolve())
            try:
                raw = importer.read(piece, scale=scale)
            except FurnitureError as problem:
                assert_clear(problem)
                continue
            names = [part.name for part in raw.parts]
            assert MIN_PARTS <= len(set(names)) == len(names)
            assert all(name and name.isprintable() for name in names)
            assert all(abs(part.mesh.bounds).max() < 20.0 for part in raw.parts)
        assert time.perf_counter() - started < SECONDS
        assert {path: path.stat().st_mtime_ns for path in outer.rglob("*")} == before


def assert_clear(problem: FurnitureError) -> None:
    text = str(problem)
    assert text.isprintable()
    assert 10 < len(text) < 1000


scales = st.none() | st.sampled_from([1.0, 0.5]) | st.floats()


@pytest.mark.parametrize("kind", sorted(IMPORTERS))
def test_undamaged_sources_are_read(kind, tmp_path):
    for files in SOURCES[kind]:
        for name, data in files.items():
            path = tmp_path / kind / next(iter(files)) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        (piece,) = IMPORTERS[kind].find(tmp_path / kind / next(iter(files)))
        assert len(IMPORTERS[kind].read(piece).parts) >= 2


@pytest.mark.parametrize("count", [30, *(pytest.param(n, marks=pytest.mark.slow) for n in (100, 2000))])
@pytest.mark.parametrize("kind", sorted(IMPORTERS))
def test_damaged_sources(kind, count):
    @given(files=damaged(kind), scale=scales)
    @settings(max_examples=count, deadline=None, suppress_health_check=list(HealthCheck))
    def read(files, scale):
        check(kind, files, scale)

    read()
