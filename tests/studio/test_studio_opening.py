"""What the page around the scene shows and says: opening view, messages, time line, and the page itself."""

from __future__ import annotations

import gzip
import html
import json
import re
import socket
from typing import Any

import numpy as np
import pytest

from roboassembly.datasets import catalogue
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import transform_points
from roboassembly.rendering.gl import RenderingUnavailableError, context_module
from roboassembly.studio.assembly_session import AssemblySession
from roboassembly.studio.client_session import ClientSession
from roboassembly.studio.messages import plain, title
from roboassembly.studio.page import make_page
from roboassembly.studio.page_commands import PageCommand, parse_command
from roboassembly.studio.turntable import Turntable
from roboassembly.studio.viser_internals import controls_of
from roboassembly.task.rules.connections import UP_AXES
from studio_client import Browser, begin_steps, is_open, link_of, merges, note_clients, served, until

pytestmark = pytest.mark.filterwarnings("ignore:Queued a")


@pytest.fixture(scope="module")
def stool() -> Furniture:
    return catalogue.make("stool", with_grasps=False)


@pytest.fixture
def clients(monkeypatch) -> list[ClientSession]:
    return note_clients(monkeypatch)


def told(client: ClientSession, name: str = "studio-state") -> Any:
    """What the page was told last in one of the elements that it hides."""
    for content in [h.content for h in client.panel.link.elements]:
        if f'id="{name}"' in content:
            return json.loads(html.unescape(re.search(r'data-json="([^"]*)"', content)[1]))
    return None


def test_commands_are_parsed():
    assert parse_command("12 assemble") == PageCommand(12, "assemble")
    assert parse_command("13 step 4") == PageCommand(13, "step", step=4)
    assert parse_command("14 pointer 0.5120 0.3300") == PageCommand(14, "pointer", pointer=(0.512, 0.33))


@pytest.mark.parametrize(
    "text",
    ["", "assemble", "1  assemble", "1 assemble ", "1 assemble\n", "1 delete", "-1 undo", "1 step", "1 step -1",
     "1 step 1000", "1 step 1.0", "1 pointer 1.5 0.5", "1 pointer nan 0.5", "1 pointer 0.5", "٣ undo",
     "1 pointer 0.5 0.12345", "1234567890 undo", 1, None, True],
)  # fmt: skip
def test_other_texts_are_no_commands(text):
    assert parse_command(text) is None


def test_the_turntable_stands_on_the_ground_and_turns_about_its_middle(stool):
    table = Turntable(stool)

    def points(angle: float) -> np.ndarray:
        return np.concatenate(
            [transform_points(pose, p.mesh.vertices) for pose, p in zip(table.poses(angle), stool.parts, strict=True)]
        )

    start, quarter, whole = points(0.0), points(0.5 * np.pi), points(2.0 * np.pi)
    assert start[:, 2].min() == pytest.approx(0.0, abs=1e-12)
    assert 0.5 * (start.min(axis=0) + start.max(axis=0))[:2] == pytest.approx([0.0, 0.0], abs=1e-9)
    np.testing.assert_allclose(quarter, np.stack([-start[:, 1], start[:, 0], start[:, 2]], axis=1), atol=1e-12)
    np.testing.assert_allclose(whole, start, atol=1e-12)
    assert np.abs(table.extent).max(axis=0)[:2] == pytest.approx(np.abs(start).max() * np.ones(2), rel=0.5)
    assert (table.extent.max(axis=0) >= start.max(axis=0) - 1e-9).all()


def test_the_arrow_points_along_the_axis_that_w_names(stool):
    session = AssemblySession(stool)
    joint = stool.connections[0]
    pair = joint.part_a, joint.part_b, joint.point_a, joint.point_b
    for w, axis in enumerate(UP_AXES):
        up = session.up_while_waiting((*pair, w))
        assert stool.assembled[joint.part_b].rotation @ up == pytest.approx(axis, abs=1e-9)
    assert session.up_while_waiting((joint.part_a, joint.part_a, 0, 1, 0)) is None


def test_it_opens_on_the_finished_piece_and_only_its_own_visitor_leaves_it(clients):
    with served() as server:
        browsers = [Browser(server) for _ in range(2)]
        until(lambda: len(clients) == 2 and all(is_open(c) for c in clients))
        one, other = clients
        until(lambda: told(one) is not None)
        state = told(one)
        assert (state["mode"], state["piece"], state["merges"]) == ("opening", "Stool 0 · 9 parts", 0)
        assert state["link"] in controls_of(one.handle)
        assert state["upload"] in controls_of(one.handle)
        assert one.editor is not None
        assert other.editor is not None
        turned = one.editor.view.visible.poses[0]
        until(lambda: one.editor.view.visible.poses[0] is not turned)
        browsers[0].command(one, "1 touch")
        until(lambda: not one.editor.view.is_turning)
        assert other.editor.view.is_turning
        begin_steps(browsers[0], one)
        until(lambda: told(one)["mode"] == "work")
        assert told(other)["mode"] == "opening"
        np.testing.assert_array_equal(
            [p.translation for p in one.editor.view.visible.poses],
            [p.translation for p in one.session.task_state.part_poses],
        )


def test_assemble_by_command_shows_all_steps_and_undo_takes_one_back(clients):
    with served() as server:
        browser = Browser(server)
        until(lambda: len(clients) == 1 and is_open(clients[0]))
        client = clients[0]
        browser.command(client, "1 assemble")
        until(lambda: merges(client) == 8 and (told(client) or {}).get("notice") is not None)
        assert told(client)["notice"]["title"] == "Assembled"
        assert told(client)["mode"] == "work"
        assert len(told(client, "studio-pictures")) == 9
        browser.command(client, "2 step 3")
        until(lambda: told(client)["step"] == 3 and not told(client)["is_playing"])
        browser.command(client, "3 undo")
        until(lambda: merges(client) == 7 and len(told(client, "studio-pictures")) == 8)
        until(lambda: told(client)["notice"] is None)


def test_each_step_gets_its_picture(clients):
    try:
        context_module()
    except RenderingUnavailableError as error:
        pytest.skip(str(error))
    with served() as server:
        browser = Browser(server)
        until(lambda: len(clients) == 1)
        client = clients[0]
        begin_steps(browser, client)
        browser.press(client.panel.suggest)
        browser.press(client.panel.join)
        until(lambda: merges(client) == 1)
        until(lambda: sum(bool(s["picture"]) for s in told(client, "studio-pictures")) == 2)
        start, step = told(client, "studio-pictures")
        assert start["text"] == "9 parts"
        assert " onto " in step["text"]
        assert start["picture"] != step["picture"]


def test_the_reason_of_a_failed_step_is_told_in_the_scene_until_it_is_read(clients, stool):
    with served() as server:
        browser = Browser(server)
        until(lambda: len(clients) == 1)
        client = clients[0]
        begin_steps(browser, client)
        panel = client.panel
        legs = [f"{i}: {p.name}" for i, p in enumerate(stool.parts) if p.name.startswith("leg")]
        for control, value in ((panel.u, legs[0]), (panel.v, legs[1])):
            browser.set(control, value)
        until(lambda: len(panel.k.options) > 1 and len(panel.l.options) > 1)
        assert "2." in panel.explanation.content or "1." in panel.explanation.content
        browser.set(panel.k, panel.k.options[1])
        browser.set(panel.l, panel.l.options[1])
        until(lambda: "Choose how the green part waits" in panel.explanation.content)
        browser.press(panel.join)
        until(lambda: told(client)["notice"] is not None)
        notice = told(client)["notice"]
        assert notice["kind"] == "bad"
        assert notice["title"].endswith(": wrong pair")
        assert "do not belong together" in notice["text"]
        assert client.handle.scene.get_handle_by_name("/failure") is not None
        browser.command(client, "5 read")
        until(lambda: told(client)["notice"] is None)
        assert client.handle.scene.get_handle_by_name("/failure") is None


def test_the_name_under_the_pointer_is_told_with_the_number_of_the_question(clients):
    with served() as server:
        browser = Browser(server)
        until(lambda: len(clients) == 1 and is_open(clients[0]))
        client = clients[0]
        browser.command(client, "1 touch")
        for serial, (x, y) in enumerate(
            np.stack(np.meshgrid([0.3, 0.37, 0.4], np.arange(0.1, 0.6, 0.05)), -1).reshape(-1, 2), 2
        ):
            browser.command(client, f"{serial} pointer {x:.4f} {y:.4f}")
            until(lambda serial=serial: (told(client, "studio-hover") or {}).get("serial") == serial)
            if told(client, "studio-hover")["text"] == "seat":
                return
        pytest.fail("no place of the scene is named seat")


def test_a_manual_needs_the_finished_piece_and_the_page_says_so(clients):
    with served() as server:
        browser = Browser(server)
        until(lambda: len(clients) == 1 and is_open(clients[0]))
        browser.press(clients[0].panel.saves["manual.pdf"])
        until(lambda: (told(clients[0]) or {}).get("notice") is not None)
        # What the page asks by itself does not take the message away.
        browser.command(clients[0], "1 pointer 0.5 0.5")
        until(lambda: told(clients[0], "studio-hover") is not None)
        assert "assemble the furniture first" in told(clients[0])["notice"]["text"]
        browser.command(clients[0], "2 read")
        until(lambda: told(clients[0])["notice"] is None)


@pytest.mark.security
def test_the_link_takes_commands_only(clients):
    with served() as server:
        browser = Browser(server)
        until(lambda: len(clients) == 1 and is_open(clients[0]))
        link = link_of(clients[0])
        for text in ("<script>", "1 open /etc", "1 save", "x" * 400, 5, True):
            browser.set(link, text)
        browser.command(clients[0], "7 slow")
        until(lambda: link.value == "7 slow")
        assert clients[0].session.merges == 0


@pytest.mark.security
def test_names_are_plain_text_in_markdown():
    evil = "<img src=x onerror=alert(1)>*`[a](javascript:1)"
    assert not set("<>`*[]()") & set(plain(evil))
    assert html.unescape(plain(evil)) == evil
    assert plain("leg_front_left") == "leg_front_left"
    assert title("stool-0") == "Stool 0"


def test_the_page_has_the_text_first_and_then_viser_whole():
    page = make_page()
    assert page.count("<title>") == 1
    assert "<title>RoboAssembly</title>" in page
    assert page.index("My own furniture") < page.index('id="root"') < page.index('id="viser-client"')
    # What is held back is viser's script, with nothing lost.
    import viser

    original = (np.fromfile(viser.__path__[0] + "/client/build/index.html", np.uint8)).tobytes().decode()
    inner = re.search(r"<script (data-p=.*?)</script>", original, re.S)
    assert inner is not None
    assert inner[1] in page


def test_the_same_page_is_served_packed_and_not(clients):
    with served() as server:
        bodies = []
        for accepted in ("", "Accept-Encoding: gzip\r\n"):
            with socket.create_connection(("127.0.0.1", server.get_port())) as raw:
                raw.sendall(f"GET / HTTP/1.1\r\nHost: localhost:{server.get_port()}\r\n{accepted}\r\n".encode())
                reply = b"".join(iter(lambda raw=raw: raw.recv(65536), b""))
            head, _, body = reply.partition(b"\r\n\r\n")
            length = re.search(rb"Content-Length: (\d+)", head)
            assert length is not None
            assert int(length[1]) == len(body)
            bodies.append(gzip.decompress(body) if b"gzip" in head else body)
        assert bodies[0] == bodies[1] == make_page().encode()
