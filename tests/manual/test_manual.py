"""Manuals as their readers see them: every part and every merge once, labels apart, drawings as vectors, few pages."""

from __future__ import annotations

import re
import time
from functools import cache
from itertools import combinations

import numpy as np
import pypdfium2
import pypdfium2.raw as raw
import pytest

from roboassembly.datasets import catalogue
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import nearest_points
from roboassembly.manual.document import pages_of
from roboassembly.manual.helpers import HEAVY, helps
from roboassembly.manual.make import make_manual
from roboassembly.manual.page import HEIGHT, WIDTH, Box, Outline, Page, Text, printable, shortened, text_width, wrapped
from roboassembly.manual.part_list import letter_of, part_kinds
from roboassembly.manual.step_page import HAND, contact_size, viewed_steps
from roboassembly.manual.steps import Manual
from roboassembly.manual.viewpoints import joint_spots
from roboassembly.manual.writers import html, pdf
from roboassembly.solvers.search import solve
from shapes import GAP, box, furniture, pose, turn

PIECES = (("ladder", 0), ("windsor", 3), ("shelf_open", 0), ("three_legged", 3))
SHOWN = [pytest.param(p, id=str(p), marks=pytest.mark.slow if p in PIECES[:2] else ()) for p in PIECES]


@cache
def manual_of(family: str, seed: int) -> Manual:
    piece = catalogue.make(family, seed)
    return make_manual(piece, [s.action for s in solve(piece, 0).plan.steps], 0)


@cache
def pages(family: str, seed: int) -> list[Page]:
    return pages_of(manual_of(family, seed))


def texts(page: Page) -> list[str]:
    return [item.text for item in page.items if isinstance(item, Text)]


@pytest.mark.parametrize("piece", SHOWN)
def test_every_merge_is_shown_once_and_every_part_comes_or_is_there(piece: tuple[str, int]) -> None:
    manual = manual_of(*piece)
    parts = range(len(manual.furniture.parts))
    shown = [node for step in manual.steps for node in step.merges]
    assert len(shown) == len(set(shown)) == len(parts) - 1
    assert set(shown) == {m.choice.halves.merged for m in manual.arrangement.merges}
    for step in manual.steps:
        assert len(step.merges) == step.count * len(step.movers)
        # Each merge of the step adds one mover to what is there.
        there = step.base
        for mover in step.movers:
            assert not mover.parts & there
            there |= mover.parts
            assert there in step.merges
    # A single part is drawn once in each kind of sub-assembly: as what comes, or as what is there first.
    drawn = [next(iter(p)) for s in manual.steps for p in (s.base, *(m.parts for m in s.movers)) if len(p) == 1]
    assert len(drawn) == len(set(drawn))
    kinds = {manual.furniture.class_of[p] for p in drawn}
    assert kinds == set(manual.furniture.class_of)
    counted = sum(s.count for s in manual.steps for p in (s.base, *(m.parts for m in s.movers)) if len(p) == 1)
    assert counted == len(parts)


@pytest.mark.parametrize("piece", SHOWN)
def test_no_two_labels_overlap_and_all_are_on_the_page(piece: tuple[str, int]) -> None:
    sheet = Box(0, 0, WIDTH, HEIGHT)
    for page in pages(*piece):
        assert page.labels
        for a, b in combinations(page.labels, 2):
            assert not a.overlaps(b), (page.title, a, b)
        assert all(sheet.contains(label) for label in page.labels)
        for item in page.items:
            if isinstance(item, Text):
                assert sheet.contains(item.box)
            else:
                corners = np.concatenate(item.lines)
                assert corners.min() >= 0.0
                assert (corners <= [WIDTH, HEIGHT]).all()


@pytest.mark.parametrize("piece", SHOWN)
def test_every_letter_of_the_list_is_a_label_of_a_step(piece: tuple[str, int]) -> None:
    manual = manual_of(*piece)
    _, *rest = pages(*piece)
    lists = [p for p in rest if p.title.startswith("Parts")]
    steps = [p for p in rest if p.title.startswith("Steps")]
    kinds = part_kinds(manual.furniture)
    assert sum(len(k.members) for k in kinds) == len(manual.furniture.parts)
    listed = [t for page in lists for t in texts(page)]
    labelled = {t.split()[-1] for page in steps for t in texts(page)}
    for kind in kinds:
        assert kind.letter in listed
        assert " × ".join(map(str, kind.size)) + " mm" in listed
        assert kind.letter in labelled
    numbers = [int(t) for page in steps for t in texts(page) if t.isdigit()]
    assert set(range(1, len(manual.steps) + 1)) <= set(numbers)


def test_the_manual_of_the_built_in_chair_is_short_small_and_quick() -> None:
    piece = catalogue.make("ladder", 0)
    actions = [s.action for s in solve(piece, 0).plan.steps]
    begun = time.process_time()
    manual = make_manual(piece, actions, 0)
    made = pages_of(manual)
    content = pdf(made, "chair")
    page = html(made, "chair")
    assert time.process_time() - begun < 6.0
    assert len(made) <= 12
    assert len(content) < 2_000_000
    assert len(page.encode()) < 2_000_000
    assert content.startswith(b"%PDF")
    assert len(re.findall(rb"/Type /Page\b", content)) == len(made)
    # Vectors, and nothing from elsewhere.
    assert b"/Subtype /Image" not in content
    assert "<img" not in page
    assert "<script" not in page
    assert not re.search(r"(src|href)=", page)
    assert page.count("<svg") == len(made)
    assert pdf(made, "chair") == content


def test_another_reader_finds_texts_and_paths_in_the_pdf_and_no_pictures() -> None:
    made = pages("ladder", 0)
    document = pypdfium2.PdfDocument(pdf(made, "chair"))
    assert len(document) == len(made)
    for page, read in zip(made, document, strict=True):
        assert read.get_size() == pytest.approx((595.3, 841.9), abs=0.1)  # A4 [points]
        assert {o.type for o in read.get_objects()} <= {raw.FPDF_PAGEOBJ_PATH, raw.FPDF_PAGEOBJ_TEXT}
        words = read.get_textpage().get_text_range().split()
        assert sorted(words) == sorted(word for text in texts(page) for word in text.split())


def test_what_comes_is_drawn_clear_of_what_is_there(chair) -> None:
    piece: Furniture = chair("ladder", 0)
    for step in manual_of("ladder", 0).steps:
        for mover in step.movers:
            for p in mover.parts:
                coming = piece.parts[p].mesh.transformed(mover.away * piece.assembled[p])
                for q in piece.neighbours[p] & step.base:
                    there = piece.parts[q].mesh.transformed(piece.assembled[q])
                    assert nearest_points(coming, there).distance > 1e-4


def test_views_show_the_joints_and_keep_their_side() -> None:
    manual = manual_of("ladder", 0)
    views = viewed_steps(manual)
    for view in views:
        assert view.camera.toward @ view.camera.up == pytest.approx(0.0, abs=1e-9)
        spots = joint_spots(manual.furniture, view.step)
        assert {spot.mover for spot in spots} == set(range(len(view.step.movers)))
        for mover in view.step.movers:
            way = mover.away.translation
            if len(mover.way) == 2:
                # The arrow is not seen end on.
                assert abs(way @ view.camera.toward) < 0.95 * np.linalg.norm(way)
        if view.detail is not None:
            assert contact_size(manual.furniture, view.detail) < HAND


def test_the_size_of_a_contact_is_that_of_the_smaller_part(table: Furniture) -> None:
    manual = make_manual(table, [s.action for s in solve(table, 0).plan.steps], 0)
    (step,) = manual.steps
    assert len(step.movers) == 4
    for spot in joint_spots(table, step):
        assert contact_size(table, spot) == pytest.approx(40.0, abs=5.0)
    page = next(p for p in pages_of(manual) if p.title.startswith("Steps"))
    assert any(t.startswith("4× ") for t in texts(page))
    assert manual.final_turn == 1


def test_equal_sub_assemblies_are_described_once() -> None:
    parts = {"board": box((-0.5, -0.2, 0.3 + GAP), (0.5, 0.2, 0.33 + GAP))}
    for side, x in (("left", -0.35), ("right", 0.35)):
        # A T of a post and a foot, each under one end of the board.
        parts[f"{side}_post"] = box((x - 0.03, -0.12, 0.05), (x + 0.03, 0.12, 0.3))
        parts[f"{side}_foot"] = box((x - 0.05, -0.19, 0.0), (x + 0.05, 0.19, 0.05 - GAP))
    piece = furniture("trestle", parts)
    index = {p.name: i for i, p in enumerate(piece.parts)}

    def ends(a: str, b: str) -> tuple[int, ...]:
        c = next(c for c in piece.connections if {c.part_a, c.part_b} == {index[a], index[b]})
        u, v = (c.part_a, c.part_b), (c.point_a, c.point_b)
        return (*u, *v, 0)

    actions = [
        ends("left_post", "left_foot"), ends("left_post", "board"), ends("right_post", "right_foot"),
        ends("right_post", "board"),
    ]  # fmt: skip
    manual = make_manual(piece, actions, 0)
    assert sorted(s.count for s in manual.steps) in ([1, 2], [1, 1, 2])
    twice = next(s for s in manual.steps if s.count == 2)
    assert len(twice.merges) == 2
    assert len(twice.merges[0] & twice.merges[1]) == 0
    steps = [p for p in pages_of(manual) if p.title.startswith("Steps")]
    assert any("2×" in texts(page) for page in steps)


def test_heavy_and_tottering_things_need_two_people(table: Furniture) -> None:
    light = make_manual(table, [s.action for s in solve(table, 0).plan.steps], 0)
    assert helps(light) == []
    slab = {"top": box((-0.8, -0.5, 0.6 + GAP), (0.8, 0.5, 0.66 + GAP))}
    for i, (x, y) in enumerate(((-0.7, -0.4), (0.7, -0.4), (0.7, 0.4), (-0.7, 0.4))):
        slab[f"leg{i}"] = box((x - 0.04, y - 0.04, 0.0), (x + 0.04, y + 0.04, 0.6))
    piece = furniture("slab", slab)
    heavy = make_manual(piece, [s.action for s in solve(piece, 0).plan.steps], 0)
    (end,) = [h for h in helps(heavy) if "stand the finished piece up" in h.reason]
    # 600 kg/m³ of 1.6 × 1 × 0.06 m³ and four legs of 0.08 × 0.08 × 0.6 m³.
    mass = 600 * (1.6 * 1.0 * 0.06 + 4 * 0.08 * 0.08 * 0.6)
    assert mass > HEAVY
    assert f"about {mass:.0f} kg" in end.reason
    assert "1.6 m long" in end.reason
    last = pages_of(heavy)[-1]
    assert any("about 67 kg" in t for t in texts(last))


def test_letters_go_on_after_z() -> None:
    assert [letter_of(i) for i in (0, 25, 26, 27, 51, 52, 701, 702)] == ["A", "Z", "AA", "AB", "AZ", "BA", "ZZ", "AAA"]


def test_sizes_of_parts_are_those_of_the_smallest_box() -> None:
    together = {"bar": box((0, 0, 0), (0.5, 0.04, 0.03)), "plate": box((0, 0, 0.03 + GAP), (0.6, 0.4, 0.05 + GAP))}
    slanted = pose(0.1, 0.2, 0.3, rotation=turn((1, 2, 3), 0.7))
    piece = furniture("two", {name: mesh.transformed(slanted) for name, mesh in together.items()})
    plate, bar = part_kinds(piece)
    assert (plate.name, plate.letter, plate.size) == ("plate", "A", (600, 400, 20))
    assert (bar.name, bar.letter, bar.size) == ("bar", "B", (500, 40, 30))
    assert bar.axes @ bar.axes.T == pytest.approx(np.eye(3), abs=1e-9)
    assert abs(bar.axes[0] @ slanted.rotation[:, 0]) == pytest.approx(1.0, abs=1e-9)


def test_texts_are_measured_cut_and_wrapped() -> None:
    # Helvetica's digits are 0.556 of its size wide.
    assert text_width("0000", 10.0) == pytest.approx(4 * 0.556 * 10 * 25.4 / 72)
    assert shortened("a long name of a part", 10, 20.0).endswith("…")
    assert text_width(shortened("a long name of a part", 10, 20.0), 10) <= 20.0
    lines = wrapped("one two three four five", 10, 20.0)
    assert " ".join(lines) == "one two three four five"
    assert all(text_width(line, 10) <= 20.0 for line in lines)
    assert printable("椅子 × –") == "?? × –"


def test_names_of_files_cannot_break_the_page() -> None:
    page = Page("<b>&")
    page.text(20, 20, "</text><script>alert(1)</script> 椅子", 10)
    page.path([np.array([[0, 0], [1, 0], [1, 1]])], stroke=(0, 0, 0), width=0.2)
    out = html([page], "</title><script>")
    assert "<script" not in out
    assert "椅子" in out
    assert b"/Page" in pdf([page], "</title>")
    assert isinstance(page.items[1], Outline)
