"""The unit of files that do not say theirs: guessed from typical sizes, printed, or given."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import shapes
from command_line import Run
from roboassembly.errors import FurnitureError, InputError
from roboassembly.generate import FAMILIES
from roboassembly.geometry import units
from roboassembly.importers import folder


def write(place: Path, family: str, seed: int, unit: float) -> Path:
    """A generated piece as STL files in a unit of so many metres."""
    place.mkdir(parents=True)
    for part in shapes.generated(family, seed):
        mesh = part.mesh.trimesh.copy()
        mesh.apply_scale(1.0 / unit)
        mesh.export(place / f"{part.name.replace('/', '-')}.stl")
    return place


def guesses(seeds: range) -> Iterator[tuple[str, units.Unit]]:
    """The true unit and the guess, of every family in every unit."""
    for family in FAMILIES:
        for seed in seeds:
            corners = np.concatenate([part.mesh.bounds for part in shapes.generated(family, seed)])
            for name, metres in units.METRES.items():
                yield name, units.guess((np.ptp(corners, axis=0) / metres).tolist())


def measured(seeds: range) -> None:
    """Print the confusion table, and hold it against what docs/furniture.md says."""
    found = list(guesses(seeds))
    table = Counter((true, unit.name) for true, unit in found)
    for true in units.METRES:
        print(f"{true:3}", *(f"{table[true, name]:5}" for name in units.METRES))
    total = len(found)
    right = sum(unit.name == true for true, unit in found)
    covered = sum(true in (unit.name, *unit.others) for true, unit in found)
    told = sum(bool(unit.others) for _, unit in found)
    print(f"{right} of {total} right, {covered} right or told as possible, {told} with another possibility")
    assert right >= 0.98 * total
    assert covered >= 0.995 * total
    assert told <= 0.05 * total
    # Only centimetres and inches, and feet and metres, are near enough to be taken for each other.
    confused = {(true, unit.name) for true, unit in found if unit.name != true}
    assert confused <= {("cm", "in"), ("in", "cm"), ("ft", "m"), ("m", "ft"), ("mm", "cm")}


def test_built_in_families_in_every_unit() -> None:
    measured(range(1))


@pytest.mark.slow
def test_built_in_families_in_every_unit_many() -> None:
    measured(range(1, 42))


@pytest.mark.parametrize("unit", units.METRES)
@pytest.mark.parametrize("family", ["ladder", "stool", "bench", "table_apron", "shelf_bookcase", "rocker"])
def test_stl_files_come_back_at_their_size(family: str, unit: str, tmp_path: Path) -> None:
    raw = folder.read(write(tmp_path / "piece", family, 1, units.METRES[unit]))
    corners = np.concatenate([part.mesh.bounds for part in shapes.generated(family, 1)])
    assert raw.unit is not None
    assert (raw.unit.name, raw.unit.guessed) == (unit, True)
    assert raw.size == pytest.approx(np.ptp(corners, axis=0), rel=1e-4)
    assert raw.provenance.scale == units.METRES[unit]


TRADE = {
    "dining chair": (18, 20, 36),
    "bar stool": (16, 16, 30),
    "stool": (15, 15, 18),
    "dining table": (60, 36, 29),
    "coffee table": (48, 24, 18),
    "desk": (60, 30, 29),
    "bookcase": (32, 12, 72),
    "garden bench": (48, 24, 34),
    "nightstand": (20, 16, 25),
}
"""Inches along x, y and z."""


@pytest.mark.parametrize("piece", TRADE)
def test_common_pieces_in_inches_and_centimetres(piece: str) -> None:
    inches = np.array(TRADE[piece], dtype=float)
    assert units.guess(inches.tolist()).name == "in"
    centimetres = units.guess((2.54 * inches).tolist())
    assert "cm" in (centimetres.name, *centimetres.others)


def test_ambiguous_unit_gives_a_note() -> None:
    """40 by 24 by 40 is a small cabinet in centimetres, a large one in inches."""
    low = units.guess((40.0, 24.0, 40.0))
    assert {low.name, *low.others} == {"cm", "in"}
    assert units.guess((45.0, 45.0, 90.0)).others == ()


@pytest.mark.parametrize("longest", [1e-300, 1e-9, 0.05, 0.1, 4.0, 4.1, 9.9, 10.0, 157.0, 251.0, 4001.0, 1e300])
def test_guessed_sizes_are_never_absurd(longest: float) -> None:
    unit = units.guess((longest, 0.5 * longest, 0.1 * longest))
    assert units.SMALLEST <= unit.scale * longest <= units.LARGEST * (1 + 1e-12)
    assert unit.guessed


@given(st.tuples(*[st.floats(0.0, 1e6)] * 3))
def test_any_size_has_a_guess(extents: tuple[float, float, float]) -> None:
    if max(extents) < 1e-300:
        with pytest.raises(FurnitureError, match="one and the same"):
            units.guess(extents)
        return
    unit = units.guess(extents)
    assert 0.0 < unit.scale < np.inf
    assert unit.name not in unit.others
    x, y, z = extents
    assert units.guess((y, x, z)) == unit, "which way it faces does not matter"


def test_names_and_sizes() -> None:
    assert units.scale_of(None, None) is None
    assert units.scale_of("in", None) == 0.0254
    assert units.scale_of(None, 0.5) == 0.5
    with pytest.raises(InputError, match=r"--unit in and --scale 0\.5 both"):
        units.scale_of("in", 0.5)
    with pytest.raises(InputError, match="unit 'yd' is not known; expected one of mm, cm, m, in, ft"):
        units.scale_of("yd", None)
    assert units.given(0.01).text == "centimetres, as given"
    assert units.given(0.3).text == "0.3 m, as given"


@pytest.mark.slow
def test_import_names_the_guessed_unit(run: Run, tmp_path: Path) -> None:
    source = write(tmp_path / "chair", "plank", 1, units.METRES["in"])
    status, _, err = run("import", "folder", "--no-report", source, "--out", tmp_path / "a")
    assert status == 0
    assert "  unit: guessed inches; 0.45 x 0.43 x 0.85 m" in err.splitlines()
    status, out, _ = run("import", "folder", "--no-report", source, "--out", tmp_path / "b", "--json")
    (item,) = json.loads(out)["items"]
    assert (item["unit"], item["unit_guessed"], item["unit_others"], item["scale"]) == ("in", True, [], 0.0254)
    assert item["size_m"] == pytest.approx([0.45, 0.43, 0.85], abs=0.01)
    assert item["cached"]

    status, _, err = run("import", "folder", "--no-report", source, "--out", tmp_path / "c", "--unit", "cm")
    assert (status, "  unit: centimetres, as given; 0.18 x 0.17 x 0.33 m" in err.splitlines()) == (0, True)
    status, _, err = run("import", "folder", "--no-report", source, "--out", tmp_path / "d", "--scale", "0.02")
    assert (status, "  unit: 0.02 m, as given; 0.35 x 0.34 x 0.67 m" in err.splitlines()) == (0, True)
    status, out, err = run(
        "import", "folder", "--no-report", source, "--out", tmp_path / "e", "--scale", "0.02", "--unit", "cm"
    )
    assert (status, out) == (2, "")
    assert err.strip() == "error: --unit cm and --scale 0.02 both say how large the files are; give one of them"
    assert not (tmp_path / "e").exists()


def test_import_names_other_possible_units(run: Run, tmp_path: Path) -> None:
    source = write(tmp_path / "screen", "lattice", 2, units.METRES["cm"])
    status, _, err = run("import", "folder", "--no-report", source, "--out", tmp_path / "a")
    assert status == 0
    lines = err.splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith("  unit: guessed inches"))
    assert lines[at + 1].startswith("  the unit may also be centimetres: 0.41 x 0.20 x 0.46 m")
    assert lines[at + 1].endswith("import it with --unit cm")
    status, out, _ = run("import", "folder", "--no-report", source, "--out", tmp_path / "b", "--unit", "cm", "--json")
    assert json.loads(out)["items"][0]["size_m"] == pytest.approx([0.41, 0.20, 0.46], abs=0.01)


def test_refusal_names_the_size(run: Run, tmp_path: Path) -> None:
    """A wrong unit is often why repair refuses."""
    source = write(tmp_path / "chair", "plank", 1, 1.0)
    far = trimesh.creation.box((0.1, 0.1, 0.1))
    far.apply_translation((0.2, 0.0, 3.0))
    far.export(source / "far.stl")
    status, _, err = run("import", "folder", "--no-report", source, "--out", tmp_path / "a", "--unit", "ft")
    assert status == 2
    refusal, size = [line for line in err.splitlines() if not line.endswith(" ...")][:2]
    assert "far" in refusal
    assert size.startswith("  unit: feet, as given; 0.14 x 0.13 x 0.93 m")
