"""STEP: names, hierarchy, places and units; broken files; files written by hand and, where installed, by build123d."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from command_line import Run
from roboassembly.errors import FurnitureError
from roboassembly.furniture import storage
from roboassembly.importers import folder, step
from step_files import Assembly, Box, step_table, write_step

SIDES = ("left side", "right side")
NAMES = {
    *(f"{side}/{name}" for side in SIDES for name in ("front leg", "back leg", "side rail")),
    *("front rail", "back rail", "front stretcher", "back stretcher", "front top", "back top"),
}


@pytest.mark.slow
def test_table_with_sub_assemblies_is_imported_with_names_and_assembled(run: Run, tmp_path: Path) -> None:
    """The right side is the left one turned by half a turn, so that its front leg stands behind."""
    path = write_step(tmp_path / "table.step", step_table())
    status, out, err = run("import", path, "--out", tmp_path / "table", "--no-report", "--json")
    assert status == 0, err
    (item,) = json.loads(out)["items"]
    assert (item["parts"], item["unit"], item["unit_guessed"]) == (12, "mm", False)
    assert item["unit_text"] == "millimetres, as the file states"
    assert item["size_m"] == [1.26, 0.76, 0.74]
    assert item["findings"] == []
    made = storage.load(tmp_path / "table")
    assert {part.name for part in made.parts} == NAMES
    center = {part.name: slot.translation for part, slot in zip(made.parts, made.assembled, strict=True)}
    assert np.allclose(center["left side/front leg"], (-0.57, -0.32, 0.355), atol=1e-3)
    assert np.allclose(center["right side/front leg"], (0.57, 0.32, 0.355), atol=1e-3)
    assert np.allclose(center["front top"], (0, -0.19, 0.725), atol=1e-3)
    # Each leg meets two rails, a stretcher and a half of the top; the halves meet each other and, like each rail, a leg
    # at either end; the side rails meet both halves.
    assert len(made.connections) == 4 * 4 + 1 + 2 + 4
    status, out, _ = run("assemble", tmp_path / "table", "--no-film", "--out", tmp_path / "plan", "--json")
    report = json.loads(out)
    assert (status, report["success"], report["merges"]) == (0, True, 11)


def test_sub_assemblies_are_read_with_names_at_their_places(tmp_path: Path) -> None:
    raw = folder.read(write_step(tmp_path / "table.step", step_table()))
    center = {part.name: part.mesh.bounds.mean(axis=0) for part in raw.parts}
    assert center.keys() == NAMES
    middle = center["front top"] * (1, 0, 0)
    assert np.allclose(center["left side/front leg"] - center["right side/front leg"], (-1.14, -0.64, 0), atol=1e-3)
    assert np.allclose(center["front top"] - center["left side/front leg"], (0.57, 0.13, 0.37), atol=1e-3)
    assert np.allclose(middle, 0, atol=1e-3)


def test_names_of_programs_give_way_to_those_of_products(tmp_path: Path) -> None:
    raw = folder.read(write_step(tmp_path / "table.stp", step_table(("NAUO7", "NAUO8"))))
    names = {part.name for part in raw.parts}
    assert {f"{side}/{name}" for side in SIDES for name in ("leg", "leg_2", "side rail")} < names


FACTORS = {"mm": 1.0, "in": 1 / 25.4, "m": 0.001}


@pytest.mark.parametrize(
    ("unit", "words"),
    [
        ("in", "inches"),
        *(pytest.param(*unit, marks=pytest.mark.slow) for unit in (("mm", "millimetres"), ("m", "metres"))),
    ],
)
def test_units(tmp_path: Path, unit: str, words: str) -> None:
    f = FACTORS[unit]
    parts = [
        ("seat", Box("seat", (400 * f, 300 * f, 20 * f)), (0.0, 0.0, 450 * f)),
        ("post", Box("post", (50 * f, 60 * f, 450 * f)), (100 * f, 100 * f, 0.0)),
    ]
    path = write_step(tmp_path / "stool.step", Assembly("stool", parts), unit)
    raw = folder.read(path)
    assert raw.unit is not None
    assert (raw.unit.text, raw.unit.name, raw.unit.guessed) == (f"{words}, as the file states", unit, False)
    assert np.allclose(raw.size, (0.4, 0.3, 0.47), atol=1e-6)
    assert np.allclose(raw.parts[1].mesh.bounds, [[-0.1, -0.05, 0.0], [-0.05, 0.01, 0.45]], atol=1e-6)
    # A user who knows better counts in the numbers of the file.
    if unit == "in":
        assert np.allclose(folder.read(path, scale=0.002 / f).size, (0.8, 0.6, 0.94), atol=1e-6)


@pytest.mark.slow
def test_file_in_metres_that_claims_millimetres(tmp_path: Path) -> None:
    """0.47 mm of furniture is refused with a hint; 47 mm are read, and the likely units named."""
    tiny = Assembly(
        "x", [("a", Box("a", (0.4, 0.4, 0.02)), (0, 0, 0.45)), ("b", Box("b", (0.1, 0.1, 0.45)), (0, 0, 0))]
    )
    path = write_step(tmp_path / "x.step", tiny)
    with pytest.raises(FurnitureError, match=r"would be 0.00047 m long .* \(--unit or --scale\)"):
        folder.read(path)
    assert folder.read(path, scale=1.0).size[2] == pytest.approx(0.47)
    small = Assembly("x", [("a", Box("a", (40, 40, 2)), (0, 0, 45)), ("b", Box("b", (5, 5, 45)), (0, 0, 0))])
    unit = folder.read(write_step(tmp_path / "y.step", small)).unit
    assert unit is not None
    assert unit.others[0] == "cm"


@pytest.mark.slow
def test_up_axis(tmp_path: Path) -> None:
    size = folder.read(write_step(tmp_path / "table.step", step_table()), up="y").size
    assert np.allclose(size, (1.26, 0.74, 0.76), atol=1e-6)


def test_folder_of_parts(tmp_path: Path) -> None:
    """Each file is a part, named after its file; files in millimetres and inches fit together."""
    write_step(tmp_path / "top.step", Box("x", (508, 254, 25.4)))
    write_step(tmp_path / "post.step", Assembly("y", [("z", Box("z", (1, 1, 10)), (0, 0, -10))]), "in")
    raw = folder.read(tmp_path)
    assert [part.name for part in raw.parts] == ["post", "top"]
    assert np.allclose(raw.size, (0.508, 0.254, 0.2794), atol=1e-6)
    (tmp_path / "more.stl").write_text("x")
    with pytest.raises(FurnitureError, match=r"post.step, which states its unit, and more.stl, which does not"):
        folder.read(tmp_path)


def test_piece_beside_its_parts_is_refused(tmp_path: Path) -> None:
    write_step(tmp_path / "table.step", step_table())
    (tmp_path / "leg.stl").write_text("x")
    with pytest.raises(FurnitureError, match=r"holds table.step, a scene of 12 parts, beside 1 mesh files; import"):
        folder.read(tmp_path)


def _cut(text: str) -> str:
    return text[: len(text) // 2]


def _without_solids(text: str) -> str:
    return text.replace("FACETED_BREP(", "FACETED_BRAP(")


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda _: "hello", "does not begin with 'ISO-10303-21'"),
        (lambda _: "", "does not begin with 'ISO-10303-21'"),
        (_cut, "ends in the middle, after"),
        (lambda text: text.replace("#10=", "#9910=", 1), "Unresolved Reference"),
        pytest.param(lambda text: text.replace("#10=", "#11=", 1), "cannot be read as STEP", marks=pytest.mark.slow),
        (_without_solids, "cannot be read as STEP"),
        (lambda text: "ISO-10303-21;" + "(" * 10_000 + "END-ISO-10303-21;", "cannot be read as STEP"),
    ],
)
def test_broken_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: Callable[[str], str], message: str
) -> None:
    monkeypatch.setattr(step, "SECONDS", 2.0)
    path = write_step(tmp_path / "table.step", step_table())
    path.write_text(damage(path.read_text()))
    with pytest.raises(FurnitureError, match=message) as caught:
        folder.read(path)
    assert "table.step" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


def test_a_single_solid_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FurnitureError, match="1 part; furniture has 2 or more"):
        folder.read(write_step(tmp_path / "one.step", Box("one", (400, 400, 20))))


@pytest.mark.slow
def test_file_by_build123d(tmp_path: Path) -> None:
    """A stool of round legs in round sockets, the legs as two instances in a sub-assembly of their own, turned."""
    cad = pytest.importorskip("build123d", reason="the dependency group `cad` installs it")
    place = cad.Location
    seat = cad.Cylinder(200, 30).moved(place((0, 0, 415)))
    for x in (-100, 100):
        seat -= cad.Cylinder(12.5, 30).moved(place((x, 0, 410)))
    seat.label = "seat"
    legs = []
    for x, name in ((-100, "left leg"), (100, "right leg")):
        leg = cad.Cylinder(12.4, 420).moved(place((x, 0, 210)))
        leg.label = name
        legs.append(leg)
    base = cad.Compound(label="base", children=legs)
    turned = cad.Compound(label="stool", children=[seat, base]).moved(place((500, 0, 0), (0, 0, 90)))
    cad.export_step(turned, str(tmp_path / "stool.step"))
    raw = folder.read(tmp_path / "stool.step")
    assert [part.name for part in raw.parts] == ["seat", "left leg", "right leg"]
    assert np.allclose(raw.size, (0.4, 0.4, 0.43), atol=1e-4)
    middles = [part.mesh.bounds.mean(axis=0) for part in raw.parts]
    assert np.allclose(middles[2] - middles[1], (0, 0.2, 0), atol=1e-6)
    volume = np.pi * 12.4**2 * 420 * 1e-9
    assert raw.parts[1].mesh.volume == pytest.approx(volume, rel=0.02)
    assert all(part.mesh.is_solid for part in raw.parts)
