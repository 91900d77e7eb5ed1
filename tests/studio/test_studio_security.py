"""Attacks on the studio: all speak the real protocol to a real server on this machine."""

from __future__ import annotations

import math
import resource
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
import viser
from viser import ViserServer, _messages
from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException

from roboassembly.datasets.catalogue import make
from roboassembly.errors import InputError
from roboassembly.furniture import storage
from roboassembly.studio import incoming
from roboassembly.studio.access import Access
from roboassembly.studio.client_session import ClientSession
from roboassembly.studio.viser_internals import controls_of, identifier_of, uploads_in_progress
from roboassembly.viewer.server import quiet_server
from studio_client import CAMERA, Browser, begin_steps, merges, note_clients, open_websocket, packed, served, until

pytestmark = [pytest.mark.security, pytest.mark.filterwarnings("ignore:Queued a")]


@pytest.fixture
def clients(monkeypatch) -> list[ClientSession]:
    return note_clients(monkeypatch)


@pytest.fixture(scope="module")
def running() -> Iterator[ViserServer]:
    """A studio for attacks that leave nothing behind."""
    with served() as server:
        yield server


@pytest.fixture(scope="module")
def guarded() -> Iterator[tuple[ViserServer, Access]]:
    """A studio that other machines reach, and so needs a token."""
    access = Access("0.0.0.0")
    with served(access=access) as server:
        yield server, access


@pytest.fixture
def visit(clients) -> Iterator[tuple[Browser, ClientSession]]:
    """One browser that has the stool open."""
    with served() as server:
        browser = Browser(server)
        until(lambda: len(clients) == 1)
        begin_steps(browser, clients[0])
        yield browser, clients[0]
        browser.connection.close()


def ask(port: int, path: str = "/", hosts: tuple[str, ...] | None = None, **headers: str) -> tuple[int, dict, bytes]:
    """Status, headers and body of an HTTP request, with any `Host` headers."""
    lines = [f"Host: {host}" for host in ((f"localhost:{port}",) if hosts is None else hosts)]
    lines += [f"{name}: {value}" for name, value in headers.items()]
    with socket.create_connection(("127.0.0.1", port), timeout=10) as raw:
        raw.sendall("\r\n".join([f"GET {path} HTTP/1.1", *lines, "", ""]).encode())
        reply = b"".join(iter(lambda: raw.recv(65536), b""))
    head, _, body = reply.partition(b"\r\n\r\n")
    status, *rest = head.decode().split("\r\n")
    return int(status.split()[1]), dict(line.split(": ", 1) for line in rest), body


def refused(port: int, **asked: str) -> bool:
    """Whether the websocket does not open."""
    try:
        open_websocket(port, **asked).close()
    except InvalidStatus as error:
        return error.response.status_code == 403
    return False


def settled(browser: Browser, client: ClientSession) -> None:
    """Wait until all that was sent before has been handled: messages are handled in their order."""
    control = client.panel.frames
    wanted = not control.value
    browser.set(control, wanted)
    until(lambda: control.value == wanted, 10.0)


# Who may connect


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", "http://localhost.evil.example:{port}", "http://localhost:{port}.evil.example",
     "https://localhost:{port}", "http://localhost", "http://localhost:1", "file://", "http://0.0.0.0:{port}",
     "http://localhost:{port}@evil.example", "ws://localhost:{port}", "HTTP://", " "],
)  # fmt: skip
def test_pages_of_other_origins_are_refused(running, origin):
    port = running.get_port()
    origin = origin.format(port=port)
    assert refused(port, origin=origin)
    assert ask(port, Origin=origin)[0] == 403


def test_own_pages_and_programs_without_a_page_connect(running):
    port = running.get_port()
    for name in ("localhost", "127.0.0.1", "[::1]", "LOCALHOST"):
        assert not refused(port, host=f"{name}:{port}", origin=f"http://{name.lower()}:{port}")
        assert ask(port, hosts=(f"{name}:{port}",))[0] == 200
    assert not refused(port)


@pytest.mark.parametrize(
    "host",
    ["evil.example:{port}", "evil.example", "localhost.evil.example:{port}", "localhost", "127.0.0.1", "localhost:1",
     "0.0.0.0:{port}", "127.0.0.2:{port}", "192.0.2.1:{port}", "localhost.:{port}", "[::1%eth0]:{port}",
     "localhost:{port}x", "localhost:0{port}0", "@localhost:{port}", ""],
)  # fmt: skip
def test_names_that_point_here_from_elsewhere_are_refused(running, host):
    """DNS rebinding: the browser takes the page of a foreign name for ours, but sends that name."""
    port = running.get_port()
    host = host.format(port=port)
    status, _, body = ask(port, hosts=(host,))
    assert status == 403
    assert b"--allow-origin" in body
    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
    key = {"Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA=="}
    assert ask(port, hosts=(host,), **upgrade, **key)[0] == 403


def test_requests_with_no_host_or_with_two_are_refused(running):
    port = running.get_port()
    assert ask(port, hosts=())[0] == 403
    assert ask(port, hosts=(f"localhost:{port}", "evil.example"))[0] == 403


def test_further_origins_are_let_in_where_they_were_named():
    noted: list[str] = []
    access = Access("127.0.0.1", origins=("https://studio.example.org", "http://box:9000/"), report=noted.append)
    with served(access=access) as server:
        port = server.get_port()
        for host, origin in (
            ("studio.example.org", "https://studio.example.org"), ("box:9000", "http://box:9000"),
            (f"localhost:{port}", "https://studio.example.org"),
        ):  # fmt: skip
            assert not refused(port, host=host, origin=origin)
            assert ask(port, hosts=(host,))[0] == 200
        for origin in (
            "http://studio.example.org",
            "https://studio.example.org:8443",
            "http://box",
            "https://box:9000",
        ):
            assert refused(port, origin=origin)
        assert ask(port, hosts=("studio.example.org:80",))[0] == 403
        assert ask(port, Origin="http://\u202eev\u00edl")[0] == 403
        assert any("'http://box'" in line for line in noted), "the terminal names the address to allow"
        for k in range(100):
            ask(port, Origin=f"http://evil{k}")
        assert len(noted) <= 20
        assert all(line.isprintable() for line in noted)


@pytest.mark.parametrize(
    "wrong", ["*", "studio.example.org", "https://", "ftp://a", "https://a/b", "http://a:99999", ""]
)
def test_invalid_origins_print_one_line(wrong):
    with pytest.raises(InputError, match="--allow-origin"):
        Access("127.0.0.1", origins=(wrong,))


@pytest.mark.parametrize("token", ["", "wrong", "{token}x", "{half}", "%00", "\u00e9"])
def test_without_the_token_neither_the_page_nor_the_websocket_opens(guarded, token):
    server, access = guarded
    port = server.get_port()
    token = token.format(token=access.token, half=access.token[:20])
    cookie = {"Cookie": f"roboassembly-{port}={access.token}; token={access.token}"}
    assert ask(port, "/" if not token else f"/?token={token}")[0] == 403
    assert ask(port, "/assets", **cookie)[0] == 403, "the cookie is not the token"
    if token.isascii():
        assert refused(port, query=f"?token={token}")
    assert refused(port, origin=f"http://localhost:{port}", **cookie)
    assert "Set-Cookie" not in ask(port)[1]


def test_the_token_in_the_address_opens_the_page_and_its_cookie_the_websocket(guarded):
    server, access = guarded
    port = server.get_port()
    url = access.urls(port)[0]
    assert url == f"http://localhost:{port}/?token={access.token}"
    status, headers, _ = ask(port, f"/?token={access.token}")
    assert status == 200
    assert {"HttpOnly", "SameSite=Strict"} <= set(headers["Set-Cookie"].split("; "))
    assert access.token not in headers["Set-Cookie"]
    cookie = headers["Set-Cookie"].partition(";")[0]
    assert ask(port, "/", Cookie=cookie)[0] == 200
    assert not refused(port, origin=f"http://localhost:{port}", Cookie=f"other=1; {cookie}")
    assert refused(port, origin="http://evil.example", Cookie=cookie)
    assert refused(port, host=f"evil.example:{port}", query=f"?token={access.token}")
    assert not refused(port, query=f"?token={access.token}")


def test_tokens_are_random_and_needed_on_public_addresses():
    assert Access("127.0.0.1").token == Access("localhost").token == Access("::1").token == ""
    drawn = {Access(host).token for host in ("0.0.0.0", "0.0.0.0", "::", "192.0.2.1", "studio.lan", "")}
    assert len(drawn) == 6
    assert all(len(token) >= 40 for token in drawn)
    assert Access("127.0.0.1", "my-own-secret").urls(80) == ["http://localhost:80/?token=my-own-secret"]
    assert Access("::1", "").urls(8080) == ["http://localhost:8080"]
    assert Access("fd00::1", "12345678").urls(80) == ["http://[fd00::1]:80/?token=12345678"]
    for wrong in ("short", "with space", "a&b=cdefgh", "ü" * 10, "x" * 300):
        with pytest.raises(InputError, match="--token"):
            Access("0.0.0.0", wrong)


def test_links_cannot_make_the_page_load_from_elsewhere(running):
    """viser's page takes its server, or a recording with scripts in it, from its address."""
    port = running.get_port()
    for query in (
        "?websocket=ws://evil.example",
        "?playbackPath=http://evil.example/x.viser",
        "?a",
        "?token=x&websocket=",
    ):
        status, headers, body = ask(port, f"/{query}")
        assert (status, headers["Location"], body) == (302, "/", b"")
    headers = ask(port)[1]
    policy = headers["Content-Security-Policy"]
    assert f"connect-src 'self' ws://localhost:{port} wss://localhost:{port} data: blob:" in policy
    assert "frame-ancestors 'none'" in policy
    assert headers["X-Frame-Options"] == "DENY"
    assert headers["Referrer-Policy"] == "no-referrer"


# What they may say


def test_a_policy_that_was_not_offered_is_not_loaded(visit, tmp_path):
    """Loading one in a Python file executes it."""
    browser, client = visit
    marker, file = tmp_path / "executed", tmp_path / "evil.py"
    file.write_text(f"open({str(marker)!r}, 'w')\ndef policy(seed): return None\n")
    browser.set(client.panel.policy, str(file))
    browser.press(client.panel.suggest)
    browser.press(client.panel.runs["alone"])
    until(lambda: marker.exists() or merges(client) > 0)
    assert not marker.exists()
    assert client.panel.policy.value == "relational"
    browser.sees("“Policy” does not offer")


def test_a_policy_named_at_start_is_offered_by_name(clients, tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("from roboassembly.learning.registry import load_policy\n"
                    "def policy(seed): return load_policy('relational')\n")  # fmt: skip
    with served(policies=("relational", str(file))) as server:
        browser = Browser(server)
        until(lambda: len(clients) == 1 and merges(clients[0]) == 0)
        browser.set(clients[0].panel.policy, str(file))
        browser.press(clients[0].panel.suggest)
        until(lambda: "The policy suggests this action" in clients[0].panel.message.content)
        assert clients[0].panel.policy.value == str(file)


WRONG: tuple[object, ...] = (
    "not offered", "", "/etc", "x" * 501, "\x1b[31m", "a\nb", math.nan, math.inf, -math.inf, -1, 0.5, 10**7, 2**63,
    1e308, True, False, None, [], [0], {}, {"value": 0}, b"x",
)  # fmt: skip


def test_controls_refuse_values_outside_their_options(visit):
    browser, client = visit
    controls = controls_of(client.handle)
    assert len(controls) > 25
    asked = []
    own = client.submit
    client.submit = lambda *request: (asked.append(request), own(*request))
    for control in controls.values():
        before, kind = control.value, type(control).__name__
        for value in WRONG:
            offered = {"GuiButtonHandle": value is True, "GuiCheckboxHandle": isinstance(value, bool)}
            if not offered.get(kind, False):
                browser.set(control, value)
        settled(browser, client)
        if control is not client.panel.frames:
            assert control.value == before, control.label
    # Only the changes of `frames` by which the test waits got through.
    assert all(request[1:] == ("view",) for request in asked)


def test_controls_take_their_options(visit):
    browser, client = visit
    panel = client.panel
    for control, value in (
        (panel.source, "built-in"), (panel.piece, "plank"), (panel.setting, "full"), (panel.seed, 10**6),
        (panel.number, 7), (panel.color, "groups"), (panel.u, panel.u.options[-1]), (panel.points, False),
    ):  # fmt: skip
        browser.set(control, value)
        until(lambda control=control, value=value: control.value == value, 5.0)


def test_only_the_value_of_a_control_can_be_set(visit):
    browser, client = visit
    control = client.panel.time
    before = dict(vars(control._impl))
    for name, value in (
        ("update_cb", []), ("removed", True), ("gui_api", 1), ("props", {}), ("sync_cb", None), ("uuid", "x"),
    ):  # fmt: skip
        browser.send(_messages.GuiUpdateMessage(identifier_of(control), {name: value}))
        browser.send(_messages.GuiUpdateMessage(identifier_of(control), {"value": 0, name: value}))
    settled(browser, client)
    assert vars(control._impl) == before


def test_disabled_or_foreign_controls_are_ignored(clients):
    with served() as server:
        browsers = [Browser(server) for _ in range(2)]
        until(lambda: len(clients) == 2 and all(merges(v) == 0 for v in clients))
        one, other = clients
        browsers[0].set(other.panel.seed, 5)
        one.panel.set_busy(True)
        browsers[0].press(one.panel.runs["search"])
        one.panel.color.visible = False
        browsers[0].set(one.panel.color, "groups")
        settled(browsers[0], one)
        assert other.panel.seed.value == 0
        assert one.panel.color.value != "groups"
        assert merges(one) == 0
        one.panel.set_busy(False)
        browsers[0].press(one.panel.runs["search"])
        until(lambda: merges(one) > 0)


def test_refused_choice_is_reset_in_the_panel(visit):
    browser, client = visit
    browser.set(client.panel.piece, "sofa")
    uuid, value = identifier_of(client.panel.piece), client.panel.piece.value
    wanted = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}
    assert any(wanted.items() <= message.items() for message in browser.messages(5.0))


@pytest.mark.parametrize("field", ["wxyz", "position", "look_at", "up_direction", "fov", "near", "far", "image_width"])
def test_invalid_cameras_are_ignored(visit, field):
    browser, client = visit
    camera, names = client.handle.camera, ("wxyz", "position", "look_at", "up_direction", "fov", "near", "far")
    before = [np.array(getattr(camera, name)) for name in names]
    own = getattr(CAMERA, field)
    vector = isinstance(own, tuple)
    for x in (math.nan, math.inf, -math.inf, 1e300, *(() if vector else (0.0, -1.0))):
        browser.send(replace(CAMERA, **{field: (x, *own[1:]) if vector else x}))
    browser.send(replace(CAMERA, look_at=CAMERA.position))
    browser.send(replace(CAMERA, up_direction=(0.0, 0.0, 0.0)))
    browser.send(replace(CAMERA, wxyz=(0.0, 0.0, 0.0, 0.0)))
    browser.connection.send(packed(CAMERA).replace(b"\xa3fov", b"\xa3fox"))
    settled(browser, client)
    for name, value in zip(names, before, strict=True):
        np.testing.assert_array_equal(getattr(camera, name), value)
    assert camera.image_width == CAMERA.image_width
    browser.send(replace(CAMERA, fov=0.7))
    until(lambda: camera.fov == 0.7)


def test_clients_without_a_camera_are_no_visitors(clients):
    with served() as server:
        for wrong in (math.nan, math.inf, 1e300):
            Browser(server, replace(CAMERA, position=(wrong, 0.0, 0.0)))
        Browser(server)
        until(lambda: len(clients) == 1)
        time.sleep(0.2)
        assert len(server.get_clients()) == len(clients) == 1


def test_unneeded_messages_are_dropped(visit, monkeypatch):
    browser, client = visit
    reached: list[str] = []
    gui, scene = type(client.handle.gui), type(client.handle.scene)
    for owner in (gui, scene):
        for name in [n for n in vars(owner) if n.startswith("_handle_") and "gui_updates" not in n]:
            monkeypatch.setattr(owner, name, lambda *_, name=name: reached.append(name))
    server = client.handle._viser_server
    seen: list[str] = []
    own = type(server._websock_server)._handle_incoming_message

    async def noted(self, number, message):
        seen.append(type(message).__name__)
        await own(self, number, message)

    monkeypatch.setattr(type(server._websock_server), "_handle_incoming_message", noted)
    needed = {
        "ViewerCameraMessage",
        "ScenePointerMessage",
        "GuiUpdateMessage",
        "FileTransferStartUpload",
        "FileTransferPart",
    }
    others = [kind for kind in _messages.Message.get_subclasses() if kind.__name__ not in needed]
    assert len(others) > 100
    for kind in others:
        browser.connection.send(msgspec.msgpack.encode({"type": kind.__name__}))
    for message in (
        _messages.ShareUrlRequest(), _messages.ShareUrlDisconnect(), _messages.RunJavascriptMessage("alert(1)"),
        _messages.GuiFormDirtyMessage("x"), _messages.GuiButtonHoldMessage(identifier_of(client.panel.join), 10.0),
    ):  # fmt: skip
        browser.send(message)
    for raw in (b"", b"\xc1", b"\xff" * 100, b"\x91" * 100_000, b"\x80", msgspec.msgpack.encode({"type": ["x"]}),
                msgspec.msgpack.encode({"type": "Message"}), msgspec.msgpack.encode([1, 2])):  # fmt: skip
        browser.connection.send(raw)
    browser.connection.send("text")
    settled(browser, client)
    assert set(seen) == {"GuiUpdateMessage"}
    assert not reached
    assert server._share_tunnel is None


def test_invalid_clicks_are_ignored(visit):
    browser, client = visit
    asked = []
    client.handle.scene.remove_click_callback()
    client.handle.scene.on_click()(asked.append)
    for origin, direction in (
        ((math.nan, 0, 0), (0, 0, 1)), ((0, 0, 0), (0, 0, math.inf)), ((0, 0, 0), (0, 0, 0)),
        ((1e300, 0, 0), (0, 0, 1)),
    ):  # fmt: skip
        browser.send_ray(origin, direction)
    browser.send(_messages.ScenePointerMessage("click", None, None, ((0.5, 0.5),), None))
    browser.send(_messages.ScenePointerMessage("rect-select", None, None, ((0.1, 0.1), (0.9, 0.9)), None))
    settled(browser, client)
    assert not asked
    browser.click((0, 0, 2), (0, 0, -1))
    until(lambda: len(asked) == 1)


# Folders


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> Path:
    """A folder with `mine`, which may be opened, and `theirs`, which may not; both contain a stool."""
    folder = tmp_path_factory.mktemp("folders")
    stool = make("stool", 3)
    for place in ("mine/stool", "theirs/stool"):
        storage.save(stool, folder / place)
    (folder / "mine" / "link").symlink_to(folder / "theirs" / "stool")
    (folder / "mine" / "holds_link").mkdir()
    (folder / "mine" / "holds_link" / "a.stl").symlink_to("/etc/passwd")
    (folder / "minefield").symlink_to(folder / "theirs")
    return folder


@pytest.fixture
def offered(clients, folders) -> Iterator[tuple[Browser, ClientSession, Path]]:
    """A browser that may open the contents of `mine`."""
    with served(roots=(folders / "mine",)) as server:
        browser = Browser(server)
        until(lambda: len(clients) == 1 and merges(clients[0]) == 0)
        yield browser, clients[0], folders


def open_folder(browser: Browser, client: ClientSession, name: str) -> None:
    assert client.panel.path is not None
    browser.set(client.panel.path, name)
    controls = controls_of(client.handle).values()
    browser.press(next(c for c in controls if getattr(c, "label", "") == "Open folder"))


@pytest.mark.parametrize(
    "name",
    ["{root}/theirs/stool", "../theirs/stool", "stool/../../theirs/stool", "{root}/minefield/stool", "link", "/etc",
     "/", "holds_link", "/proc/self/root", "~", "nowhere", "stool/../..", "ladder:3"],
)  # fmt: skip
def test_nothing_is_opened_outside_of_the_folders_that_were_given(offered, name):
    browser, client, root = offered
    open_folder(browser, client, name.format(root=root))
    until(lambda: "only the contents of these folders can be opened" in client.panel.message.content, 10.0)
    assert client.session is not None
    assert client.session.furniture.name == "stool-0"


def test_furniture_in_named_folders_opens(offered):
    browser, client, root = offered
    for name in ("stool", f"{root}/mine/stool", "stool/../stool"):
        opened = client.session
        open_folder(browser, client, name)
        until(lambda opened=opened: client.session is not opened, 10.0)
        assert client.session is not None
        assert client.session.furniture.name == "stool-3"


# Floods


@pytest.mark.parametrize("size", [2 << 20, 300 << 20], ids=["2 MB", "300 MB"])
def test_large_messages_are_refused_before_they_are_kept(running, size):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    connection = open_websocket(running.get_port())
    raw, sent = connection.socket, 0
    raw.sendall(b"\x82\xff" + size.to_bytes(8, "big") + bytes(4))
    # A small message may be sent whole before the other side hangs up.
    with suppress(OSError):
        while sent < size:
            raw.sendall(bytes(65536))
            sent += 65536
            time.sleep(0.001)
    with pytest.raises(ConnectionClosed):  # noqa: PT012
        while True:
            connection.recv(timeout=10)
    assert sent < 16 << 20
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 32 << 10  # kilobytes
    assert connection.close_code in (1009, 1006)


def test_large_messages_in_small_pieces_are_refused_too(running):
    connection = open_websocket(running.get_port())
    with pytest.raises(ConnectionClosed) as closed:  # noqa: PT012
        connection.send(bytes(65536) for _ in range(300 << 4))
        while True:
            connection.recv(timeout=10)
    assert closed.value.rcvd is None or closed.value.rcvd.code == 1009


def test_a_client_that_sends_without_end_is_slowed_down(visit, monkeypatch):
    browser, client = visit
    monkeypatch.setattr(incoming, "BURST", 20.0)
    monkeypatch.setattr(incoming, "MESSAGES_PER_SECOND", 50.0)
    handled = []
    client.panel.undo.on_click(lambda _: handled.append(time.monotonic()))
    begun = time.monotonic()
    for _ in range(100):
        browser.press(client.panel.undo)
    until(lambda: len(handled) == 100)
    assert max(handled) - begun > 1.2, "20 at once, then 50 a second"


def test_requests_that_wait_are_limited_and_those_that_say_the_same_are_one(visit, monkeypatch):
    browser, client = visit
    begun, go_on = threading.Event(), threading.Event()
    client.submit(lambda: begun.set() or go_on.wait(60))
    # The page may have asked for something since, so that the queue need not be empty.
    assert begun.wait(30)
    for value in (False, True) * 20:
        browser.set(client.panel.grasps, value)
    settled(browser, client)
    # The page itself may have asked for something, too.
    assert 1 <= len(client.requests) <= 2
    for _ in range(200):
        browser.press(client.panel.undo)
    until(lambda: "Too many requests are waiting" in client.panel.message.content)
    assert len(client.requests) == 64
    go_on.set()
    until(lambda: "no step to undo" in client.panel.message.content)
    browser.press(client.panel.runs["search"])
    until(lambda: merges(client) > 0)


def test_at_most_64_of_70_browsers_connect(clients, monkeypatch):
    monkeypatch.setattr(ClientSession, "open_path", lambda *_: None)  # the stool 64 times would take long
    with served() as server:
        browsers = [Browser(server) for _ in range(70)]
        until(lambda: len(server.get_clients()) == 70 and len(clients) == 64)
        sent_away: set[Browser] = set()

        def listen() -> int:
            sent_away.update(b for b in browsers if any("places are taken" in repr(m) for m in b.messages(0.0)))
            return len(sent_away)

        until(lambda: listen() == 6)
        time.sleep(0.3)
        assert listen() == 6
        assert len(clients) == 64
        inside = next(b for b in browsers if b not in sent_away)
        inside.connection.close()
        until(lambda: not all(v.is_running for v in clients))
        browsers.append(Browser(server))
        until(lambda: len(clients) == 65)
        assert sum(v.is_running for v in clients) == 64
        browsers.append(Browser(server))
        browsers[-1].sees("places are taken")
        assert len(clients) == 65
        for browser in browsers:
            browser.connection.close()


def test_connections_are_limited_whether_or_not_they_say_anything(monkeypatch):
    monkeypatch.setattr(incoming, "MOST_CONNECTIONS", 10)
    with served() as server:
        port = server.get_port()
        silent = [socket.create_connection(("127.0.0.1", port)) for _ in range(10)]
        time.sleep(0.2)
        with pytest.raises((OSError, EOFError, WebSocketException)):
            open_websocket(port)
        for connection in silent:
            connection.close()
        time.sleep(0.2)
        open_websocket(port).close()


def test_clients_that_never_read_are_dropped(running, monkeypatch):
    """The server answers pings at once, into memory if need be."""
    monkeypatch.setattr(incoming, "MOST_UNSENT", 1_000_000)
    port = running.get_port()
    asked = (
        f"Host: localhost:{port}", "Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==", f"Sec-WebSocket-Protocol: viser-v{viser.__version__}",
    )  # fmt: skip
    ping = (b"\x89\xfd" + bytes(4) + bytes(125)) * 500
    with socket.create_connection(("127.0.0.1", port), timeout=10) as raw:
        raw.sendall("\r\n".join(["GET / HTTP/1.1", *asked, "", ""]).encode())
        assert raw.recv(12) == b"HTTP/1.1 101"
        with pytest.raises(OSError):  # noqa: PT011, PT012 - one of several
            for _ in range(500):
                raw.sendall(ping)


# Files


def test_files_are_limited_in_size_number_and_name(visit, monkeypatch):
    browser, client = visit
    kept = uploads_in_progress(client.handle)
    source = identifier_of(client.panel.upload)
    read: list[str] = []
    client.open_upload = lambda file: read.append(file.name)

    def start(name: str, size: int, parts: int = 1, uuid: str = source, transfer: str = "t") -> None:
        browser.send(_messages.FileTransferStartUpload(uuid, transfer, name, "", parts, size))

    start("large.zip", 50_000_001)
    start("negative.zip", -1)
    start("many.zip", 10, 10**6)
    start("none.zip", 10, 0)
    start("a\x1b[31m.zip", 10)
    start("x" * 501, 10)
    start("elsewhere.zip", 10, uuid=identifier_of(client.panel.join))
    start("nowhere.zip", 10, uuid="x")
    browser.send(_messages.FileTransferPart(source, "unknown", 0, b"x"))
    settled(browser, client)
    assert not kept

    for transfer in "abcdefgh":  # never finished
        start("half.zip", 1000, 2, transfer=transfer)
        browser.send(_messages.FileTransferPart(source, transfer, 0, bytes(500)))
    settled(browser, client)
    assert list(kept) == ["h"]
    browser.send(_messages.FileTransferPart(source, "a", 1, bytes(500)))
    browser.send(_messages.FileTransferPart(source, "h", 0, bytes(500)))
    browser.send(_messages.FileTransferPart(source, "h", 7, bytes(500)))
    settled(browser, client)
    assert not read
    browser.send(_messages.FileTransferPart(source, "h", 1, bytes(500)))
    until(lambda: read == ["half.zip"])
    until(lambda: not client.panel.upload.value.content)

    start("longer.zip", 10)
    browser.send(_messages.FileTransferPart(source, "t", 0, bytes(11)))
    start("shorter.zip", 10)
    browser.send(_messages.FileTransferPart(source, "t", 0, bytes(9)))
    settled(browser, client)
    assert not kept
    assert read == ["half.zip"]


def test_files_of_all_clients_together_are_limited(clients, monkeypatch):
    monkeypatch.setattr(incoming, "MOST_UPLOADED", 1500)
    with served() as server:
        browsers = [Browser(server) for _ in range(2)]
        until(lambda: len(clients) == 2 and all(merges(v) == 0 for v in clients))
        for browser, client in zip(browsers, clients, strict=True):
            source = identifier_of(client.panel.upload)
            browser.send(_messages.FileTransferStartUpload(source, "t", "a.zip", "", 2, 1000))
            settled(browser, client)
        kept = [bool(uploads_in_progress(v.handle)) for v in clients]
        assert kept == [True, False]
        browsers[1].sees("Too many files")
        browsers[0].connection.close()
        until(lambda: len(server.get_clients()) == 1)
        browsers[1].send(_messages.FileTransferStartUpload(source, "t", "a.zip", "", 2, 1000))
        until(lambda: bool(uploads_in_progress(clients[1].handle)))


def test_a_file_that_is_not_read_yet_is_not_followed_by_another(visit):
    browser, client = visit
    go_on, read = threading.Event(), []
    client.open_upload = lambda file: (go_on.wait(60), read.append(file.name))
    browser.upload(client, "first.zip", 3, [b"abc"])
    until(lambda: bool(client.panel.upload.value.content))
    browser.upload(client, "second.zip", 3, [b"abc"])
    browser.sees("still being read")
    go_on.set()
    until(lambda: not client.panel.upload.value.content)
    browser.upload(client, "third.zip", 3, [b"abc"])
    until(lambda: read == ["first.zip", "third.zip"])


# The guard itself


def test_page_writers_accept_no_connections():
    with quiet_server("127.0.0.1", 0) as server:
        assert ask(server.get_port())[0] == 403
        assert refused(server.get_port())


def test_a_viser_that_cannot_be_guarded_is_not_started(monkeypatch):
    """A later version might build its server in another way."""
    stopped = []

    class Later:
        def __init__(self, **_: object) -> None:
            self.scene = None

        def stop(self) -> None:
            stopped.append(self)

    monkeypatch.setattr("roboassembly.viewer.server.ViserServer", Later)
    with pytest.raises(RuntimeError, match="does not start its server"), quiet_server("127.0.0.1", 0):
        pass
    assert len(stopped) == 1


@pytest.mark.parametrize("place", ["_live_connections", "_gui_input_handle_from_uuid"])
def test_a_viser_that_keeps_its_clients_elsewhere_is_not_started(monkeypatch, place):
    belong = incoming.Clients.attach

    def later(self, server):
        for owner in (server._websock_server, server.gui):
            if hasattr(owner, place):
                delattr(owner, place)
        belong(self, server)

    monkeypatch.setattr(incoming.Clients, "attach", later)
    with pytest.raises(RuntimeError, match=place), served():
        pass
