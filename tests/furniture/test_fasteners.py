"""Fasteners as data: names, axes, holes, equal ones, and their place in the furniture folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roboassembly.errors import FurnitureError, InputError
from roboassembly.furniture import storage
from roboassembly.furniture.fasteners import (
    FastenerPattern,
    has_head,
    own_frame,
    parse_pattern,
    profile_of,
    revolved,
    separate_fasteners,
)
from roboassembly.furniture.model import Furniture, Provenance, RawFastener, RawFurniture, RawPart
from roboassembly.geometry.meshes import nearest_points
from roboassembly.importers.pipeline import finish
from roboassembly.repair.drilling import GAP, drill
from shapes import box, brick, round_bar


def raw_of(*names: str, label: str = "") -> RawFurniture:
    return RawFurniture(tuple(RawPart(name, brick(0.1, 0.1, 0.1), label) for name in names), Provenance("test"))


def test_patterns_name_fasteners_and_their_kinds() -> None:
    raw = raw_of("seat", "leg", "Screw_1", "M6_bolt", "thing")
    kinds = {
        f.name: f.kind for f in separate_fasteners(raw, [FastenerPattern("screw*"), FastenerPattern("m6*")]).fasteners
    }
    assert kinds == {"Screw_1": "screw", "M6_bolt": "screw"}
    (only,) = separate_fasteners(raw, [parse_pattern("cam=th?ng")]).fasteners
    assert (only.name, only.kind) == ("thing", "cam")


def test_names_alone_make_no_fastener_but_a_remark_says_how() -> None:
    kept = separate_fasteners(raw_of("seat", "leg", "dowel_1", "dowel_2", "driver"))
    assert (len(kept.parts), kept.fasteners) == (5, ())
    assert kept.remarks == (
        "2 parts are named like fasteners (dowel_1, dowel_2) and imported as ordinary parts; if they are fasteners, "
        "add --fastener '*dowel*'",
    )
    assert separate_fasteners(raw_of("seat", "scam", "beam")).remarks == ()


def test_labels_of_partnet_make_fasteners() -> None:
    raw = raw_of("seat", "leg")
    raw = replace(raw, parts=(*raw.parts, RawPart("x", brick(0.1, 0.1, 0.1), "chair_base/leg/bolt")))
    found = separate_fasteners(raw)
    assert [(f.name, f.kind) for f in found.fasteners] == [("x", "screw")]
    assert found.remarks == ("fasteners: 1 screw",)


def test_bad_patterns_get_one_line() -> None:
    with pytest.raises(InputError, match="one of dowel, screw, cam"):
        parse_pattern("nail=*")
    with pytest.raises(InputError, match="is not PATTERN"):
        parse_pattern("screw=")
    with pytest.raises(FurnitureError, match=r"'bolz\*' matches no part; the parts are seat, leg"):
        separate_fasteners(raw_of("seat", "leg"), [FastenerPattern("bolz*")])
    with pytest.raises(FurnitureError, match="furniture has 2 or more other parts"):
        separate_fasteners(raw_of("seat", "a_pin", "b_pin"), [FastenerPattern("*pin")])


def test_the_axis_runs_from_the_head_to_the_tip() -> None:
    direction = np.array([1.0, 2.0, -2.0]) / 3.0
    screw = round_bar((0.1, 0.0, 0.3), np.array([0.1, 0.0, 0.3]) + 0.05 * direction, 0.002, 0.005)
    frame = own_frame(screw)
    assert frame.rotation[:, 2] == pytest.approx(direction, abs=1e-4)
    profile = profile_of(screw.transformed(frame.inverse()))
    assert has_head(profile)
    assert np.diff(profile.heights) == pytest.approx([0.004, 0.046], abs=1e-4)
    assert profile.radii == pytest.approx([0.005, 0.002], abs=1e-5)
    cam = round_bar((0, 0, 0), (0, 0, 0.012), 0.0075)  # shorter than wide
    assert abs(own_frame(cam).rotation[2, 2]) == pytest.approx(1.0, abs=1e-6)


def test_the_body_of_revolution_has_the_volume_of_its_cylinders() -> None:
    screw = round_bar((0, 0, 0), (0, 0, 0.05), 0.002, 0.005)
    body = revolved(profile_of(screw))
    assert body.is_solid
    # Regular 24-gons around circles, stacked.
    area = 24 * np.tan(np.pi / 24)
    assert body.volume == pytest.approx(area * (0.005**2 * 0.004 + 0.002**2 * 0.046), rel=1e-4)


def test_equal_fasteners_share_a_mesh_and_are_counted(fastened: Furniture) -> None:
    assert [[fastened.fasteners[k].name for k in members] for members in fastened.fastener_classes] == [
        ["dowel_left", "dowel_right"],
        ["screw_left", "screw_right"],
    ]
    assert [f.joins for f in fastened.fasteners] == [(0, 1), (0, 1), (0, 2), (0, 2)]
    assert fastened.fasteners[1].axis == pytest.approx([1, 0, 0], abs=1e-6)
    assert fastened.fasteners[3].axis == pytest.approx([-1, 0, 0], abs=1e-6)


def test_holes_leave_the_gap_around_every_fastener(fastened: Furniture) -> None:
    for fastener in fastened.fasteners:
        placed = fastener.mesh.transformed(fastener.place)
        for slot in fastener.joins:
            part = fastened.parts[slot].mesh.transformed(fastened.assembled[slot])
            assert 0.5 * GAP < nearest_points(part, placed).distance < 1.5 * GAP
    # The sides stay interchangeable: their holes are alike.
    assert fastened.class_of[1] == fastened.class_of[2]


def test_what_cannot_be_drilled_is_named() -> None:
    parts = [RawPart("a", box((0, 0, 0), (0.1, 0.02, 0.02))), RawPart("b", box((0.1005, 0, 0), (0.2, 0.02, 0.02)))]
    far = RawFastener("lost", "dowel", round_bar((0, 1, 0), (0, 1, 0.1), 0.004))
    with pytest.raises(FurnitureError, match="'lost' touches no part"):
        drill(parts, [far])
    wide = RawFastener("thick", "dowel", round_bar((0.05, 0.01, -0.01), (0.05, 0.01, 0.03), 0.012))
    with pytest.raises(FurnitureError, match="'thick' cuts part 'a' into 2 pieces"):
        drill(parts, [wide])


def test_fasteners_survive_the_folder_and_others_do_not_mention_them(
    fastened: Furniture, table: Furniture, tmp_path: Path
) -> None:
    back = storage.load(storage.save(fastened, tmp_path / "with"))
    assert back.fastener_classes == fastened.fastener_classes
    for mine, its in zip(back.fasteners, fastened.fasteners, strict=True):
        assert (mine.name, mine.kind, mine.joins) == (its.name, its.kind, its.joins)
        assert np.array_equal(mine.mesh.vertices, its.mesh.vertices)
        assert np.allclose(mine.place.homogeneous, its.place.homogeneous, atol=1e-12)
    without = storage.save(table, tmp_path / "without")
    assert "fasteners" not in (without / storage.FILE_NAME).read_text()


def test_a_fastener_must_join_parts_that_are_there(fastened: Furniture) -> None:
    wrong = replace(fastened.fasteners[0], joins=(0, 7))
    with pytest.raises(FurnitureError, match=r"fastener 'dowel_left' joins \[0, 7\]; expected parts of 0..2"):
        replace(fastened, fasteners=(wrong,))


def test_an_import_takes_fasteners_out_and_drills_their_holes(fastened: Furniture) -> None:
    parts = (
        RawPart("board", box((-0.2, -0.1, 0.1), (0.2, 0.1, 0.12))),
        RawPart("left", box((-0.22, -0.1, 0.0), (-0.2, 0.1, 0.3))),
        RawPart("screw_1", round_bar((-0.224, 0.0, 0.11), (-0.17, 0.0, 0.11), 0.002, 0.005)),
    )
    raw = separate_fasteners(RawFurniture(parts, Provenance("test")), [FastenerPattern("screw*")])
    furniture = finish("box", raw).furniture
    assert [p.name for p in furniture.parts] == ["board", "left"]
    (screw,) = furniture.fasteners
    assert (screw.name, screw.kind, screw.joins) == ("screw_1", "screw", (0, 1))
