"""The page of the studio in headless Chromium, as a person uses it, at the sizes of a desk and of a telephone."""

from __future__ import annotations

import json
import threading
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
import trimesh

from browsing import SECONDS, chromium, picture, press, turn_to, until
from roboassembly.studio.assembly_session import AssemblySession
from roboassembly.studio.client_session import ClientSession
from studio_client import note_clients, served

pytestmark = pytest.mark.slow
DESK, TELEPHONE = (1280, 800), (390, 844)
MERGES = 8
"""Of the stool."""


@pytest.fixture(scope="module")
def browser():
    yield from chromium()


@pytest.fixture
def clients(monkeypatch) -> list[ClientSession]:
    return note_clients(monkeypatch)


class Visit:
    """A page of a studio in this process, and its session there."""

    def __init__(self, browser, url: str, clients: list[ClientSession], size: tuple[int, int]) -> None:
        small = {"has_touch": True, "is_mobile": True, "device_scale_factor": 1} if size == TELEPHONE else {}
        before = len(clients)
        self.page = browser.new_page(
            viewport={"width": size[0], "height": size[1]}, accept_downloads=True, service_workers="block", **small
        )
        self.page.set_default_timeout(1e3 * SECONDS)
        self.errors: list[str] = []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(url)
        self.page.wait_for_selector("#studio[data-ready=yes]")
        until(lambda: len(clients) > before)
        self.client = clients[before]
        for close in self.page.locator(".mantine-Notification-closeButton").all():
            close.click()  # that WebGL is slow here

    def start(self, name: str) -> None:
        self.page.locator("#studio-start").get_by_role("button", name=name).click()

    def notice(self, text: str) -> str:
        """Wait for a message in the scene."""
        box = self.page.locator("#studio-notice")
        box.get_by_text(text).wait_for()
        return box.inner_text()

    def choose(self, label: str, option: str) -> None:
        """Choose in a dropdown of the panel."""
        row = self.page.locator("label", has_text=label).locator("xpath=ancestor::*[contains(@class,'mantine-Flex')]")
        row.locator("input:visible").click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def dropped(self, files: dict[str, bytes]) -> None:
        """Drop files on the page."""
        self.page.evaluate(
            """files => {
                const data = new DataTransfer();
                for (const [name, bytes] of files) data.items.add(new File([new Uint8Array(bytes)], name));
                for (const kind of ["dragenter", "dragover", "drop"])
                    document.body.dispatchEvent(new DragEvent(kind, {bubbles: true, dataTransfer: data}));
            }""",
            [[name, list(content)] for name, content in files.items()],
        )


@pytest.fixture
def desk(browser, clients) -> Iterator[Visit]:
    with served() as server:
        visit = Visit(browser, f"http://localhost:{server.get_port()}", clients, DESK)
        yield visit
        assert not visit.errors
        visit.page.close()


def table(folder: Path) -> Path:
    """A table of five parts as STL files in metres: legs with pegs in holes of the top."""
    folder.mkdir()
    top = trimesh.creation.box((0.6, 0.4, 0.03))
    top.apply_translation((0.0, 0.0, 0.415))
    holes, legs = [], []
    for x in (-0.25, 0.25):
        for y in (-0.15, 0.15):
            leg = trimesh.creation.box((0.04, 0.04, 0.4))
            leg.apply_translation((x, y, 0.2))
            peg = trimesh.creation.cylinder(0.010, 0.025)
            peg.apply_translation((x, y, 0.4075))
            hole = trimesh.creation.cylinder(0.0105, 0.022)
            hole.apply_translation((x, y, 0.41))
            legs.append(trimesh.boolean.union([leg, peg]))
            holes.append(hole)
    trimesh.boolean.difference([top, *holes]).export(folder / "top.stl")
    for number, leg in enumerate(legs):
        leg.apply_translation((0.0, 0.0, -0.0005))
        leg.export(folder / f"leg{number}.stl")
    return folder


@pytest.mark.parametrize("size", [DESK, TELEPHONE], ids=["desk", "telephone"])
def test_the_text_is_there_within_three_seconds(browser, clients, size):
    """The best of three: other work on the machine makes all of them slower."""
    begun, painted = [], []
    with served() as server:
        for _ in range(3):
            page = browser.new_page(viewport={"width": size[0], "height": size[1]})
            start = time.monotonic()
            page.goto(f"http://localhost:{server.get_port()}", wait_until="commit")
            page.locator("#studio-start").get_by_text("My own furniture").wait_for(timeout=1e3 * SECONDS)
            begun.append(time.monotonic() - start)
            entries = "performance.getEntriesByName('first-contentful-paint')"
            until(lambda page=page, entries=entries: page.evaluate(f"{entries}.length"))
            painted.append(page.evaluate(f"{entries}[0].startTime") / 1e3)
            assert page.title() == "RoboAssembly"
            assert "c2540a" in page.locator("link[rel=icon]").get_attribute("href")
            page.close()
    print(f"{size[0]} x {size[1]}: first text painted after {min(painted):.2f} to {max(painted):.2f} s, start buttons "
          f"found after {min(begun):.2f} to {max(begun):.2f} s")  # fmt: skip
    assert min(painted) <= 3.0


@pytest.mark.parametrize("size", [DESK, TELEPHONE], ids=["desk", "telephone"])
def test_it_opens_on_the_finished_piece_turning_until_touched(browser, clients, size):
    with served() as server:
        visit = Visit(browser, f"http://localhost:{server.get_port()}", clients, size)
        page, client = visit.page, visit.client
        assert client.editor is not None
        view = client.editor.view
        assert view.is_opening
        name = "telephone" if size == TELEPHONE else "desk"
        canvas = page.locator("canvas[data-engine]").bounding_box()
        assert canvas is not None
        until(lambda: wood(picture(page, f"{name}-opening"), canvas) > 3_000)
        if view.is_turning:
            first = picture(page, f"{name}-opening")
            # A browser that draws less than one picture a second is shown a still one.
            until(lambda: np.abs(picture(page, f"{name}-turned") - first).max() > 40 or not view.is_turning)
        page.mouse.move(canvas["x"] + 0.5 * canvas["width"], canvas["y"] + 0.15 * canvas["height"])
        page.mouse.down()
        page.mouse.up()
        until(lambda: not view.is_turning)
        if size == TELEPHONE:
            assert (canvas["x"], canvas["y"], canvas["width"]) == (0, 0, size[0])
            assert canvas["height"] == pytest.approx(2 / 3 * size[1], abs=2)
            panel = page.locator(".mantine-Paper-root", has_text="RoboAssembly").first.bounding_box()
            assert panel is not None
            assert panel["y"] == pytest.approx(2 / 3 * size[1], abs=2)
            assert panel["height"] == pytest.approx(1 / 3 * size[1], abs=2)
            assert panel["width"] == size[0]
        for button in page.locator("#studio-start button").all():
            box = button.bounding_box()
            assert box is not None
            assert box["x"] >= 0
            assert box["x"] + box["width"] <= canvas["width"]
            assert box["y"] + box["height"] <= canvas["height"]
        visit.start("Step by step")
        until(lambda: not view.is_opening)
        page.get_by_text("of the part that should").wait_for()
        picture(page, f"{name}-steps")
        assert not visit.errors
        page.close()


def wood(image: np.ndarray, canvas) -> int:
    scene = image[: int(canvas["height"]), : int(canvas["width"])]
    return int((scene[..., 0] - scene[..., 2] > 25).sum())


def test_assemble_then_look_at_a_step_and_undo(desk):
    page, client = desk.page, desk.client
    desk.start("Assemble")
    desk.notice("Assembled")
    steps = page.locator("#studio-steps button")
    until(lambda: steps.count() == MERGES + 1)
    until(lambda: page.locator("#studio-steps img").count() == MERGES + 1)
    picture(page, "desk-assembled")
    steps.nth(3).click()
    until(lambda: client.editor.view.step == 3 and not client.editor.view.is_playing)
    until(lambda: steps.nth(3).get_attribute("aria-current") == "step")
    picture(page, "desk-third-step")
    page.locator("#studio-undo").click()
    page.get_by_text(f"{MERGES - 1} of {MERGES} merges").wait_for()
    until(lambda: steps.count() == MERGES)
    page.get_by_role("button", name="Play the steps").click()
    until(lambda: client.editor.view.is_playing)
    page.get_by_role("button", name="Stop").click()
    until(lambda: not client.editor.view.is_playing)


def test_step_by_step_with_a_wrong_choice(desk):
    page, client = desk.page, desk.client
    desk.start("Step by step")
    press(page, "Suggest")
    page.get_by_text("The policy suggests this action").wait_for()
    picture(page, "desk-suggested")
    press(page, "Join")
    page.get_by_text(f"1 of {MERGES} merges").wait_for()
    until(lambda: not client.editor.view.is_playing)
    names = [f"{i}: {part.name}" for i, part in enumerate(client.session.furniture.parts)]
    stretchers = [name for name in names if "stretcher" in name][-2:]
    desk.choose("Moves", stretchers[0])
    desk.choose("by point", "0")
    page.get_by_text("of the part that should wait").wait_for()
    desk.choose("Waits", stretchers[1])
    desk.choose("at point", "0")
    page.get_by_text("Choose how the green part waits").wait_for()
    press(page, "Join")
    assert "do not belong together" in desk.notice("wrong pair")
    picture(page, "desk-wrong")
    assert client.session.merges == 1
    page.locator("#studio-notice").get_by_role("button").click()
    until(lambda: client.editor.notice is None)
    assert not page.locator("#studio-notice").is_visible()
    page.locator("#studio-undo").click()
    page.get_by_text(f"0 of {MERGES} merges").wait_for()


def test_names_are_told_where_the_pointer_is(desk):
    page = desk.page
    box = page.locator("canvas[data-engine]").bounding_box()
    found = set()
    for height in np.linspace(0.1, 0.8, 15):
        page.mouse.move(box["x"] + 0.48 * box["width"], box["y"] + height * box["height"])
        time.sleep(0.4)
        name = page.locator("#studio-name")
        if name.is_visible():
            found.add(name.inner_text())
    assert "seat" in found


@pytest.mark.parametrize("way", ["dropped", "folder"])
def test_own_files_are_opened_and_assembled(desk, tmp_path, way):
    page, client = desk.page, desk.client
    folder = table(tmp_path / "my_table")
    if way == "dropped":
        desk.dropped({file.name: file.read_bytes() for file in folder.iterdir()})
        name = "my furniture"
    else:
        desk.start("My own furniture")
        picture(page, "desk-own")
        page.locator("#studio-folder").set_input_files(folder)
        name = "my_table"
    until(lambda: client.session.furniture.name == name)
    assert len(client.session.furniture.parts) == 5
    until(lambda: client.editor.view.is_opening)
    page.get_by_text("5 parts").first.wait_for()
    picture(page, f"desk-own-{way}")
    desk.start("Assemble")
    desk.notice("Assembled")
    assert client.session.task_state.complete


def test_files_that_are_no_furniture_are_refused_in_the_scene(desk):
    desk.dropped({"letter.txt": b"Dear furniture"})
    assert "letter" in desk.notice("That did not work")
    desk.dropped({f"{number}.stl": b"x" for number in range(501)})
    desk.notice("more than 500 files")
    assert desk.client.session.furniture.name == "stool-0"


def test_names_in_files_are_text_and_never_run(desk, tmp_path):
    """viser shows HTML in Markdown, scripts included."""
    page, client = desk.page, desk.client
    evil = "<img src=x onerror=hurt=1>"
    files = {f"{evil}{file.name}": file.read_bytes() for file in table(tmp_path / "t").iterdir()}
    archive = tmp_path / "a.zip"
    with zipfile.ZipFile(archive, "w") as packed:
        for name, content in files.items():
            packed.writestr(f"{evil}/{name}", content)
    desk.dropped({f"{evil}.zip": archive.read_bytes()})
    until(lambda: evil in client.session.furniture.name)
    page.get_by_text(evil).first.wait_for()
    desk.start("Assemble")
    desk.notice("Assembled")
    press(page, "Join")
    desk.notice("choose a point")
    assert page.evaluate("window.hurt === undefined")


def test_a_long_search_is_cancelled_from_the_scene(desk, monkeypatch):
    begun, search = threading.Event(), AssemblySession.search

    def slow(self, guide, watch):
        def watched(progress):
            go_on = watch(progress)
            begun.set()
            # However slow the browser is, the search is not over before it is cancelled.
            desk.client.runs.cancelled.wait(SECONDS)
            return go_on and watch(progress)

        return search(self, guide, watched)

    monkeypatch.setattr(AssemblySession, "search", slow)
    desk.start("Assemble")
    assert begun.wait(SECONDS)
    cancel = desk.page.locator("#studio-cancel")
    cancel.wait_for()
    picture(desk.page, "desk-searching")
    cancel.click()
    desk.notice("Cancelled")
    assert desk.client.session.merges == 0


def test_every_file_is_saved_and_opens(desk, tmp_path):
    page, client = desk.page, desk.client
    desk.start("Assemble")
    desk.notice("Assembled")
    client.submit(lambda: client.editor.show_step(MERGES))
    turn_to(page, "Save")
    picture(page, "desk-save")
    files = {}
    for name, button in client.panel.saves.items():
        with page.expect_download(timeout=3e3 * SECONDS) as download:
            press(page, button.label)
        assert download.value.suggested_filename == name
        files[name] = tmp_path / name
        download.value.save_as(files[name])
        until(lambda: not client.panel.join.disabled)
    plan = json.loads(files["plan.json"].read_bytes())
    assert plan["success"]
    assert len(plan["steps"]) == MERGES
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(files["film.mp4"]))
    assert frames > 30 * MERGES
    assert seconds == pytest.approx(frames / 30, abs=0.5)
    assert files["manual.pdf"].read_bytes()[:5] == b"%PDF-"
    for name, words in (("manual.html", "Assembly manual"), ("assembly.html", "stool-0")):
        other = page.context.browser.new_page()
        other.goto(files[name].as_uri())
        other.get_by_text(words).first.wait_for(timeout=1e3 * SECONDS)
        other.close()
