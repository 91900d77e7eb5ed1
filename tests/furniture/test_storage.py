"""Furniture on disk: what is saved comes back, and what is broken is refused with one line that says where."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import shapes
from model_files import edit_furniture
from roboassembly.errors import FurnitureError, InputError
from roboassembly.furniture.model import Furniture, GraspRegion, Part, Provenance
from roboassembly.furniture.storage import load, save


def with_extras(furniture: Furniture) -> Furniture:
    """The furniture with a grasp, labels and a full provenance."""
    grasp = GraspRegion(
        np.array([0.1, 0.2, 1 / 3]),
        np.array([1.0, 0, 0]),
        np.array([[0, 1.0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]),
        0.05,
    )
    first = furniture.parts[0]
    parts = (Part(first.name, first.mesh, first.points, "seat", (grasp, grasp)), *furniture.parts[1:])
    origin = Provenance("folder", "id-7", "CC-BY-4.0", 0.6, ("moved 'a' by 1 mm", "zweite Zeile: ü"))
    return Furniture(furniture.name, parts, furniture.assembled, furniture.connections, furniture.classes, origin)


def assert_same(a: Furniture, b: Furniture, tolerance: float = 1e-14) -> None:
    assert a.name == b.name
    assert a.provenance == b.provenance
    assert a.connections == b.connections
    for p, q in zip(a.parts, b.parts, strict=True):
        assert (p.name, p.label) == (q.name, q.label)
        assert np.array_equal(p.mesh.vertices, q.mesh.vertices)
        assert np.array_equal(p.mesh.faces, q.mesh.faces)
        assert p.mesh.content_hash == q.mesh.content_hash
        for x, y in zip(p.points, q.points, strict=True):
            assert np.array_equal(x.position, y.position)
            assert np.array_equal(x.normal, y.normal)
            assert np.array_equal(x.tangent, y.tangent)
            assert x.gap == y.gap
        for x, y in zip(p.grasps, q.grasps, strict=True):
            assert np.array_equal(x.position, y.position)
            assert np.array_equal(x.closing, y.closing)
            assert np.array_equal(x.approaches, y.approaches)
            assert x.width == y.width
    for s, t in zip(a.assembled, b.assembled, strict=True):
        assert np.array_equal(s.translation, t.translation)
        assert np.abs(s.rotation - t.rotation).max() < tolerance
    for c, d in zip(a.classes, b.classes, strict=True):
        assert c.members == d.members
        assert c.symmetries.shape == d.symmetries.shape
        assert np.abs(c.symmetries - d.symmetries).max() < tolerance
    # Like parts share a mesh before and after.
    assert [a.parts.index(next(q for q in a.parts if q.mesh is p.mesh)) for p in a.parts] == [
        b.parts.index(next(q for q in b.parts if q.mesh is p.mesh)) for p in b.parts
    ]


@pytest.mark.parametrize("which", ["table", "captive_slat", "armchair", "ladder", "stool"])
def test_saved_furniture_loads_equal(which: str, request: pytest.FixtureRequest, chair, tmp_path: Path) -> None:
    furniture = chair(which, 1) if which in ("ladder", "stool") else request.getfixturevalue(which)
    furniture = with_extras(furniture)
    folder = save(furniture, tmp_path / "deep" / "er" / "thing")
    assert folder == tmp_path / "deep" / "er" / "thing"
    once = load(folder)
    assert_same(furniture, once)
    # From then on nothing moves any more.
    save(once, tmp_path / "second")
    twice = load(tmp_path / "second")
    assert_same(once, twice)
    assert sorted(p.name for p in (folder / "meshes").iterdir()) == sorted(
        p.name for p in (tmp_path / "second" / "meshes").iterdir()
    )


def test_equal_parts_share_one_file(table: Furniture, tmp_path: Path) -> None:
    folder = save(table, tmp_path / "table")
    assert len(list((folder / "meshes").iterdir())) == 2
    document = json.loads((folder / "furniture.json").read_text())
    assert [p["mesh"] for p in document["parts"]] == ["meshes/00.ply", *["meshes/01.ply"] * 4]
    assert document["format"] == "roboassembly.furniture"
    assert document["version"] == 1


def test_saving_replaces_furniture_and_only_furniture(table: Furniture, stand: Furniture, tmp_path: Path) -> None:
    folder = save(table, tmp_path / "thing")
    save(stand, folder)
    assert load(folder).name == "stand"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["thing"]
    empty = tmp_path / "empty"
    empty.mkdir()
    save(stand, str(empty))
    assert load(str(empty)).name == "stand"


def listing(folder: Path) -> dict[str, bytes | None]:
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None for p in sorted(folder.rglob("*"))}


def test_other_things_are_never_overwritten(table: Furniture, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.png").write_text("meow")
    before = listing(tmp_path)
    for target in (tmp_path / "file", tmp_path / "photos", tmp_path):
        with pytest.raises(InputError, match="exists and is not a furniture folder"):
            save(table, target)
    with pytest.raises(InputError, match="cannot write to"):
        save(table, tmp_path / "file" / "inside")
    assert listing(tmp_path) == before


def test_save_keeps_other_files(table: Furniture, tmp_path: Path) -> None:
    folder = save(table, tmp_path / "table")
    (folder / "plan.json").write_text("{}")
    save(table, folder)
    assert (folder / "plan.json").exists()


def test_saving_through_a_link_works_or_is_refused(table: Furniture, tmp_path: Path) -> None:
    save(table, tmp_path / "real")
    (tmp_path / "link").symlink_to(tmp_path / "real", target_is_directory=True)
    with contextlib.suppress(InputError):
        save(table, tmp_path / "link")
    assert_same(load(tmp_path / "real"), table)


def test_failed_save_leaves_no_files(table: Furniture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = save(table, tmp_path / "table")
    before = listing(tmp_path)

    class Interruption(BaseException):
        pass

    def fail(*_: object) -> None:
        raise Interruption

    monkeypatch.setattr("roboassembly.furniture.storage.msgspec.json.encode", fail)
    for target in (folder, tmp_path / "new"):
        with pytest.raises(Interruption):
            save(table, target)
    assert listing(tmp_path) == before


# Corruption


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save(with_extras(shapes.table()), tmp_path_factory.mktemp("saved") / "table")


@pytest.fixture
def broken(saved: Path, tmp_path: Path) -> Path:
    """A copy to break."""
    return Path(shutil.copytree(saved, tmp_path / "table"))


def refusal(folder: Path) -> str:
    with pytest.raises(FurnitureError) as info:
        load(folder)
    message = str(info.value)
    assert "\n" not in message
    assert len(message) < 600
    return message


def test_missing_folder(tmp_path: Path) -> None:
    assert "no furniture folder at" in refusal(tmp_path / "nowhere")


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("{}")
    assert "no furniture folder at" in refusal(tmp_path / "file")


def test_folder_without_json(tmp_path: Path) -> None:
    assert "has no furniture.json" in refusal(tmp_path)


@pytest.mark.parametrize(
    "text", [b"", b"{", b"[]", b"null", b"3", b"\xff\xfe\x00", b"{}", b'{"format": 3}', b"[" * 100_000]
)
def test_not_json_of_ours(broken: Path, text: bytes) -> None:
    (broken / "furniture.json").write_bytes(text)
    assert "furniture.json" in refusal(broken)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9, 0.999])
def test_truncated_json(broken: Path, share: float) -> None:
    path = broken / "furniture.json"
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    assert "furniture.json is not valid" in refusal(broken)


def part(document: dict[str, Any], index: int) -> dict[str, Any]:
    return document["parts"][index]


def point(document: dict[str, Any], index: int = 1) -> dict[str, Any]:
    return part(document, index)["points"][0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(format="blender"), ["format is 'blender'", "roboassembly.furniture"]),
        (lambda d: d.update(version=2), ["version 2 is not known", "version 1"]),
        (lambda d: d.update(colour="red"), ["unknown field", "colour"]),
        (lambda d: part(d, 1).update(weight=1.0), ["unknown field", "weight"]),
        (lambda d: part(d, 1).pop("points"), ["missing required field", "points", "$.parts[1]"]),
        (lambda d: part(d, 1).update(name=3), ["$.parts[1].name"]),
        (lambda d: part(d, 1).update(assembled_pose=[0, 0, 0, 1, 0, 0]), ["$.parts[1].assembled_pose"]),
        (lambda d: part(d, 1).update(assembled_pose=[float("nan"), 0, 0, 1, 0, 0, 0]), ["furniture.json is not valid"]),
        (lambda d: part(d, 2).update(assembled_pose=[0, 0, 0, 0, 0, 0, 0]), ["part 2 'leg1'", "assembled_pose"]),
        (lambda d: point(d).update(normal=[0, 0, 2]), ["'leg0'", "point 0 normal", "not a unit vector", "length 2"]),
        (lambda d: point(d).update(tangent=[0, 0, 0]), ["part 1 'leg0'", "point 0 tangent", "not a unit vector"]),
        (lambda d: point(d).update(tangent=point(d)["normal"]), ["part 1 'leg0'", "point 0", "not orthogonal"]),
        (lambda d: point(d).update(gap=-0.001), ["part 1 'leg0'", "point 0", "gap -0.001"]),
        (lambda d: point(d).update(gap=0.5), ["part 1 'leg0'", "point 0", "gap 0.5"]),
        (lambda d: part(d, 0)["grasps"][1].update(closing=[0, 1, 1]), ["part 0 'top'", "grasp 1 closing"]),
        (lambda d: part(d, 0)["grasps"][0]["approaches"].pop(), ["$.parts[0].grasps[0].approaches"]),
        (lambda d: part(d, 3).update(mesh="meshes/77.ply"), ["part 3 'leg2'", "77.ply is missing"]),
        (lambda d: part(d, 3).update(mesh="../../secret.ply"), ["part 3 'leg2'", "outside the furniture folder"]),
        (lambda d: part(d, 3).update(mesh="/etc/passwd"), ["part 3 'leg2'", "outside the furniture folder"]),
        (lambda d: part(d, 3).update(mesh=""), ["part 3 'leg2'", "missing"]),
        (lambda d: part(d, 3).update(mesh="meshes"), ["part 3 'leg2'", "missing"]),
        (lambda d: part(d, 3).update(name="leg0"), ["part names repeat", "leg0"]),
        (lambda d: d.update(parts=d["parts"][:1]), ["1 part;", "2 or more"]),
        (lambda d: d.update(parts=d["parts"] * 201), ["1005 parts;", "2 to 1000"]),
        (lambda d: d.update(parts=[]), ["0 parts;", "2 or more"]),
        (lambda d: d.update(connections=d["connections"][1:]), ["do not touch the rest", "leg0"]),
        (lambda d: d["connections"].append([9, 0, 0, 0]), ["point 0 of part 9"]),
        (lambda d: d["connections"].append([0, 7, 1, 0]), ["point 7 of part 0"]),
        (lambda d: d["connections"].append([0, -1, 1, 0]), ["point -1 of part 0"]),
        (lambda d: d["connections"].append(d["connections"][0]), ["connected twice"]),
        (lambda d: d.update(classes=d["classes"][1:]), ["shape classes", "each of 0..4"]),
        (lambda d: d["classes"][0]["symmetries"].append([0, 0, 0, 0]), ["classes", "no direction"]),
        pytest.param(lambda d: part(d, 1)["assembled_pose"].__setitem__(2, 0.205), ["leg0", "mated"]),
    ],
)  # fmt: skip
def test_broken_documents_say_where(broken: Path, change: Callable[[dict[str, Any]], object], words: list[str]) -> None:
    (broken.parent.parent / "secret.ply").write_bytes((broken / "meshes" / "01.ply").read_bytes())
    edit_furniture(broken, change)
    message = refusal(broken)
    assert "table" in message
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda d: part(d, 3).update(mesh="meshes/\0.ply"), id="zero byte in a file name"),
        pytest.param(lambda d: d["classes"][0].update(symmetries=[]), id="no symmetry, not even the identity"),
        pytest.param(lambda d: d["classes"][1]["symmetries"].reverse(), id="identity not first"),
        pytest.param(lambda d: d.update(classes=[{"members": [0, 1], "symmetries": [[1, 0, 0, 0]]},
                                                 {"members": [2, 3, 4], "symmetries": [[1, 0, 0, 0]]}]),
                     id="unlike parts in one class"),
        pytest.param(lambda d: part(d, 0)["grasps"][0].update(width=-1.0), id="negative width"),
        pytest.param(lambda d: d["provenance"].update(scale=-1.0), id="negative scale"),
        pytest.param(lambda d: point(d).update(position=[5.0, 0, 0]), id="point far off its part"),
        pytest.param(lambda d: point(d).update(normal=[-x for x in point(d)["normal"]]), id="normal inward"),
    ],
)  # fmt: skip
def test_nonsense_that_parses_is_refused_too(broken: Path, change: Callable[[dict[str, Any]], object]) -> None:
    edit_furniture(broken, change)
    refusal(broken)


def ply(vertices: list[list[float]], faces: list[list[int]]) -> bytes:
    lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}", *(f"property float {a}" for a in "xyz")]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(map(str, v)) for v in vertices] + [" ".join(map(str, [len(f), *f])) for f in faces]
    return "\n".join(lines).encode() + b"\n"


TETRAHEDRON = [[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]
FACES = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", ["01.ply"]),
        (b"solid thing\n", ["01.ply"]),
        (b"ply\nformat ascii 1.0\n", ["01.ply"]),
        (ply(TETRAHEDRON, []), ["no faces"]),
        (ply([], []), ["no faces"]),
        (ply([[float("nan"), 0, 0], *TETRAHEDRON[1:]], FACES), ["not finite"]),
        (ply([[float("inf"), 0, 0], *TETRAHEDRON[1:]], FACES), ["not finite"]),
        (ply(TETRAHEDRON, [[0, 1, 9], *FACES[1:]]), ["vertex 9"]),
        (ply(TETRAHEDRON[:3], FACES[:1]), ["flat"]),
        pytest.param(ply(TETRAHEDRON, FACES[:1]), ["flat"]),
        (ply([[0, 0, 0]] * 4, FACES), ["zero area"]),
    ],
)  # fmt: skip
def test_broken_meshes_say_where(broken: Path, data: bytes, words: list[str]) -> None:
    (broken / "meshes" / "01.ply").write_bytes(data)
    message = refusal(broken)
    assert "part 1 'leg0'" in message
    for word in words:
        assert word in message


def test_link_out_of_the_folder_is_refused(broken: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside.ply"
    (broken / "meshes" / "01.ply").rename(outside)
    (broken / "meshes" / "01.ply").symlink_to(outside)
    assert "outside the furniture folder" in refusal(broken)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_damaged_bytes_are_refused_or_read_but_never_crash(broken: Path, saved: Path, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(["furniture.json", "meshes/00.ply", "meshes/01.ply"]))
    good = (saved / name).read_bytes()
    if data.draw(st.booleans()):
        bad = good[: data.draw(st.integers(0, len(good)))]
    else:
        at = data.draw(st.integers(0, len(good) - 1))
        bad = good[:at] + data.draw(st.binary(min_size=1, max_size=4)) + good[at + 1 :]
    (broken / name).write_bytes(bad)
    message = ""
    try:
        load(broken)
    except FurnitureError as error:
        message = str(error)
    finally:
        (broken / name).write_bytes(good)
    assert "\n" not in message
    assert not message or str(broken) in message or "touch" in message
