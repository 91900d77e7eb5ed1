"""Tests pages of the site that are generated."""

from __future__ import annotations

import re

import pytest

from scripts import ROOT, script

pytest.importorskip("ziamath")

site = script("tools/site.py")


def test_commands_page_has_every_command(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("COLUMNS", "NO_COLOR"):  # the page sets them
        monkeypatch.setenv(name, "")
    text = site.commands_page()
    headings = re.findall(r"^## (.*)$", text, re.MULTILINE)
    assert {"roboassembly", "roboassembly assemble", "roboassembly train", "roboassembly train expert"} <= set(headings)
    assert text.count("usage: ") == len(headings) == len(set(headings))
    assert "--no-film" in text
    assert "\x1b" not in text


def test_equations_are_drawn_and_code_is_left_alone() -> None:
    text = "`$a$`, $x_1 < y$ and\n\n$$\n\\frac{a}{b}\n$$\n\n```\n$c$ $$d$$\n```\n"
    drawn = site.with_equations(text)
    assert drawn.startswith("`$a$`, <span ")
    assert drawn.endswith("</div>\n\n```\n$c$ $$d$$\n```\n")
    assert drawn.count("<svg") == 2
    assert 'aria-label="x&#95;1 &lt; y"' in drawn


def test_links_to_the_root_work_on_the_site() -> None:
    moved = site.moved("[a](docs/task.md) ![b](docs/images/sixty.png) [c](CONTRIBUTING.md#release) [d](README.md)")
    assert moved == "[a](task.md) ![b](images/sixty.png) [c](contributing.md#release) [d](index.md)"
    moved = site.moved("[a](../CONTRIBUTING.md) [b](../examples/05_masked_ppo.py) [c](task.md)")
    assert moved == "[a](contributing.md) [b](examples/05_masked_ppo.py) [c](task.md)"


def test_picture_of_the_rooms_shows_every_room() -> None:
    package = ROOT / "src" / "roboassembly"
    rooms = {path.name for path in package.iterdir() if (path / "__init__.py").exists()}
    picture = (ROOT / "docs" / "images" / "rooms.svg").read_text()
    assert {f"{room}/" for room in rooms} <= set(re.findall(r">([a-z]+/)<", picture))


def test_pictures_are_small_enough_to_load_in_a_page() -> None:
    images = [path for path in (ROOT / "docs" / "images").iterdir() if path.is_file()]
    assert {path.name for path in images} >= {"two_robots.webp", "rooms.svg"}
    assert max(path.stat().st_size for path in images) <= 3_000_000
