"""What the terminal and the report say about an import: what is worth a look, and the page with the pictures."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
import trimesh

from command_line import Run
from model_files import box, export
from roboassembly.errors import FurnitureError
from roboassembly.furniture import storage
from roboassembly.geometry.meshes import Mesh
from roboassembly.importers import folder
from roboassembly.importers.findings import findings, why_not_held
from roboassembly.importers.kept import REPORT
from roboassembly.importers.pipeline import Imported, finish
from roboassembly.rendering.gl import RenderingUnavailableError, context_module
from roboassembly.viewer import import_pictures
from roboassembly.viewer.import_report import import_report, refusal_report, separate_labels

_REFUSAL = FurnitureError("part 'top' is missing", ("top",))


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table whose legs, 50 mm thick, reach 3 mm into the top; the block below is too thick for a hand.

    All in millimetres: the top from z 500 to 530, the legs up to 503; the block touches the top.
    """
    root = tmp_path_factory.mktemp("table")
    export(box((600, 600, 30), (0, 0, 515)), root / "top.stl")
    for k, (x, y) in enumerate(((-250, -250), (250, -250), (-250, 250), (250, 250)), start=1):
        export(box((50, 50, 503), (x, y, 251.5)), root / f"leg <{k}>.stl")
    export(box((200, 200, 200), (0, 0, 400)), root / "block.stl")
    return root


@pytest.fixture(scope="module")
def imported(source: Path) -> tuple[folder.RawFurniture, Imported]:
    raw = folder.read(source, scale=0.001)
    return raw, finish("table", raw)


def test_findings_name_parts_and_amounts(imported: tuple[folder.RawFurniture, Imported]) -> None:
    raw, made = imported
    found = findings(raw, made.furniture, made.repairs)
    texts = [finding.text for finding in found]
    assert any(
        "a robot's hand cannot hold 'block'" in t and "200 mm thick, and the hand opens 80 mm" in t for t in texts
    )
    assert [f.weight for f in found] == sorted((f.weight for f in found), reverse=True)
    assert not any("the size" in t for t in texts), "the unit was given"
    (block,) = [part for part in made.furniture.parts if part.name == "block"]
    (top,) = [part for part in made.furniture.parts if part.name == "top"]
    assert (bool(why_not_held(block)), why_not_held(top)) == (True, "")


def test_a_piece_that_hands_find_no_order_for_is_a_finding(imported: tuple[folder.RawFurniture, Imported]) -> None:
    raw, made = imported
    grasps = next(p.grasps for p in made.furniture.parts if p.grasps)
    holdable = replace(made.furniture, parts=tuple(replace(p, grasps=grasps) for p in made.furniture.parts))
    text = "two robot hands find no order"
    assert not any(text in f.text for f in findings(raw, holdable, ()))
    assert any(text in f.text for f in findings(raw, holdable, (), hands_find_order=False))
    # That no hand holds a part says enough.
    assert not any(text in f.text for f in findings(raw, made.furniture, (), hands_find_order=False))


def test_doubtful_sizes_are_findings(tmp_path: Path) -> None:
    """A box of boxes 0.9 mm apart, too large for its guessed unit to be sure, and one that no unit fits."""
    for k, x in enumerate((0.0, 100.9)):
        export(box((100, 300, 400), (x, 0, 200)), tmp_path / f"{k}.stl")
    raw = folder.read(tmp_path)
    made = finish("x", raw)
    assert not any(f.text.startswith("touches nothing") for f in findings(raw, made.furniture, made.repairs))
    (tmp_path / "1.stl").unlink()
    export(box((100, 300, 400), (103.0, 0, 200)), tmp_path / "1.stl")
    raw = folder.read(tmp_path)
    made = finish("x", raw)
    texts = [f.text for f in findings(raw, made.furniture, made.repairs)]
    assert any(re.match(r"touches nothing: '\d' from '\d' by 3.0 mm", t) for t in texts), texts
    for path in tmp_path.iterdir():
        mesh = trimesh.load_mesh(path)
        mesh.apply_scale(1e5)
        mesh.export(path)
    raw = folder.read(tmp_path)
    made = finish("x", raw)
    first = findings(raw, made.furniture, made.repairs)[0]
    assert "no unit fits" in first.text
    assert "--unit" in first.text


class _Page(HTMLParser):
    """Checks that tags are balanced, and collects texts and addresses."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.texts: list[str] = []
        self.images: list[tuple[str, str]] = []
        self.feed(page)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        assert not {"src", "href"} & set(values) or str(values.get("src")).startswith("data:image/webp;base64,")
        if tag == "img":
            self.images.append((str(values["alt"]), str(values["src"])))
        elif tag not in ("meta", "polyline", "circle"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def _pictures(page: _Page) -> list[np.ndarray]:
    return [iio.imread(BytesIO(base64.b64decode(src.partition(",")[2])), extension=".webp") for _, src in page.images]


def _needs_rendering() -> None:
    try:
        context_module()
    except RenderingUnavailableError as error:
        pytest.skip(str(error))


def test_page_shows_each_part_before_and_after(source: Path, imported: tuple[folder.RawFurniture, Imported]) -> None:
    _needs_rendering()
    raw, made = imported
    text = import_report("my <b>table</b>", source, raw, made, findings(raw, made.furniture, made.repairs))
    page = _Page(text)
    assert "<b>table" not in text, "names are escaped"
    assert "leg <1>" in page.texts
    parts = len(made.furniture.parts)
    alts = [alt for alt, _ in page.images]
    assert alts[:3] == ["as delivered", "after repair", "pulled apart"]
    assert alts[3:] == ["before", "after"] * parts
    pictures = _pictures(page)
    assert all(picture.std() > 5 for picture in pictures), "none is empty"
    # The sockets in the top are orange; before repair nothing is.
    names = [part.name for part in made.furniture.parts]

    def orange(picture: np.ndarray) -> int:
        red, green, blue = (picture[..., k].astype(int) for k in range(3))
        return int(((red > 150) & (red - blue > 90) & (red - green > 50)).sum())

    changed = [name for k, name in enumerate(names) if orange(pictures[4 + 2 * k]) > 20]
    assert not any(orange(pictures[3 + 2 * k]) for k in range(parts))
    assert changed == ["top"], "its sockets, 3 mm deep, for the legs"
    assert page.texts.count("before, upside down") == 1
    assert text.count("<polyline") == len(made.furniture.connections) == 5


def _no_rendering(*_: object) -> None:
    raise RenderingUnavailableError("no OpenGL here")


def test_page_lists_connections_where_they_are(
    source: Path, imported: tuple[folder.RawFurniture, Imported], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("roboassembly.viewer.import_report.take_pictures", _no_rendering)
    raw, made = imported
    text = import_report("table", source, raw, made, ())
    rows = re.findall(r"<tr><td class='number'>\d+</td>(.*?)</tr>", text)
    cells = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in rows]
    places = {frozenset(row[:2]): tuple(map(float, row[2:5])) for row in cells}
    block = places[frozenset(("block", "top"))]
    assert np.allclose(block, (0, 0, 500), atol=2)
    first = places[frozenset(("leg &lt;1&gt;", "top"))]
    assert np.allclose(first, (-250, -250, 501.5), atol=3)


def test_import_writes_the_page_and_names_three_things(run: Run, source: Path, tmp_path: Path) -> None:
    _needs_rendering()
    target = tmp_path / "table"
    status, _, err = run("import", source, "--unit", "mm", "--out", target)
    assert status == 0, err
    lines = err.splitlines()
    start = lines.index("  worth a look:")
    named = [line for line in lines[start + 1 :] if re.match(r"    \d\. ", line)]
    assert 1 <= len(named) <= 3
    assert f"  report: {target / REPORT}" in lines
    page = (target / REPORT).read_bytes()
    # The cache keeps the page, and another import without one removes it.
    status, out, _ = run("import", source, "--unit", "mm", "--out", target, "--force", "--json")
    (item,) = json.loads(out)["items"]
    assert (item["cached"], item["report"]) == (True, str(target / REPORT))
    assert [f"    {k}. {text}" for k, text in enumerate(item["findings"][:3], start=1)] == named
    assert (target / REPORT).read_bytes() == page
    status, out, _ = run("import", source, "--unit", "mm", "--out", target, "--force", "--no-report", "--json")
    assert json.loads(out)["items"][0]["report"] is None
    assert not (target / REPORT).exists()
    assert len(storage.load(target).parts) == 6


@pytest.mark.slow
def test_a_refused_piece_gets_a_page_that_shows_the_parts_in_question(run: Run, tmp_path: Path) -> None:
    _needs_rendering()
    source, target = tmp_path / "source", tmp_path / "out" / "table"
    source.mkdir()
    export(box((600, 600, 30), (0, 0, 515)), source / "top.stl")
    export(box((50, 50, 500), (0, 0, 250)), source / "leg.stl")
    export(box((100, 100, 100), (200, 200, 50)), source / "stray.stl")
    page = tmp_path / "out" / "table.refused.html"
    asked = ("import", source, "--unit", "mm", "--out", target, "--json")
    status, out, _ = run(*asked)
    (item,) = json.loads(out)["items"]
    assert (status, item["report"], item["folder"]) == (2, str(page), None)
    assert not target.exists()
    text = page.read_text()
    read = _Page(text)
    assert item["error"] in read.texts
    assert "'stray'" in item["error"]
    pictures = [picture.astype(int) for picture in _pictures(read)]
    red = [((p[..., 0] > 90) & (p[..., 0] > 2 * p[..., 1]) & (p[..., 0] > 2 * p[..., 2])).sum() for p in pictures]
    assert len(red) == 2
    assert min(red) > 500
    rows = dict(re.findall(r"<tr><td(?: class='bad')?>(\w+)</td>(.*?)</tr>", text))
    assert re.findall(r">(-?\d+)<", rows["stray"])[:3] == ["100"] * 3
    assert {name for name in rows if f"<td class='bad'>{name}</td>" in text} == {"stray", "leg"}
    # The cache keeps this page, too.
    page.unlink()
    assert json.loads(run(*asked)[1])["items"][0]["cached"]
    assert page.read_text() == text
    # A piece that was mended has no such page any more.
    (source / "stray.stl").unlink()
    status, _, err = run(*asked)
    assert status == 0, err
    assert not page.exists()


def test_without_rendering_the_page_has_texts_only(
    source: Path, imported: tuple[folder.RawFurniture, Imported], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("roboassembly.viewer.import_report.take_pictures", _no_rendering)
    monkeypatch.setattr("roboassembly.viewer.import_report.take_delivered", _no_rendering)
    raw, made = imported
    for text in (import_report("table", source, raw, made, ()), refusal_report("table", source, raw, _REFUSAL)):
        page = _Page(text)
        assert page.images == []
        assert "Without pictures: no OpenGL here" in page.texts


def test_numbers_do_not_overlap() -> None:
    points = np.concatenate([np.zeros((12, 2)), [[100.0, 0.0], [105.0, 0.0]]])
    moved = separate_labels(points, 19.0)
    gaps = np.linalg.norm(moved[:, None] - moved[None], axis=2) + 1e9 * np.eye(len(points))
    assert gaps.min() > 18.0
    assert np.allclose(moved.mean(axis=0), points.mean(axis=0), atol=1.0)


def test_pictures_show_fine_meshes_with_fewer_triangles() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=6, radius=0.1)
    fine = Mesh(sphere.vertices, sphere.faces)
    light = import_pictures._light(fine)
    assert len(fine.faces) > import_pictures.MAX_FACES >= len(light.faces)
    np.testing.assert_allclose(light.bounds, fine.bounds, atol=1e-3)
