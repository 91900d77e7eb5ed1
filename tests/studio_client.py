"""Client of the studio that speaks the protocol of a browser and shows nothing."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any

import msgspec
import numpy as np
import pytest
import viser
import zstandard
from viser import GuiButtonHandle, ViserServer, _messages
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from roboassembly.studio.access import Access
from roboassembly.studio.client_session import ClientSession
from roboassembly.studio.config import StudioConfig
from roboassembly.studio.page_commands import LINK
from roboassembly.studio.server import run_studio
from roboassembly.studio.viser_internals import controls_of, identifier_of

CAMERA = _messages.ViewerCameraMessage(
    (1.0, 0.0, 0.0, 0.0), (2.0, 2.0, 1.0), 0.6, 0.01, 100.0, 600, 800, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
)


def config(**changed: Any) -> StudioConfig:
    return StudioConfig(**({"folders": (), "policies": ("relational",), "furniture": "stool", "scale": None,
                     "setting": "object-centric", "seed": 0} | changed))  # fmt: skip


def served(
    port: int = 0, host: str = "127.0.0.1", access: Access | None = None, **changed: Any
) -> AbstractContextManager[ViserServer]:
    """A studio on this machine; `changed` replaces fields of its configuration."""
    return run_studio(config(**changed), access or Access(host), port)


def packed(message: _messages.Message) -> bytes:
    return msgspec.msgpack.encode({"type": type(message).__name__, **vars(message)})


def unpacked(raw: bytes) -> list[dict[str, Any]]:
    """Messages of the server, without their arrays."""
    size, length = (int.from_bytes(raw[i : i + 8], "little") for i in (0, 8))
    content = zstandard.ZstdDecompressor().decompress(raw[16 : 16 + length], max_output_size=size)
    return msgspec.msgpack.decode(content)["messages"]


def open_websocket(
    port: int, host: str | None = None, origin: str | None = None, query: str = "", **headers: str
) -> ClientConnection:
    """Connect to this machine.

    Args:
        port: that is served.
        host: `Host` that is sent; 127.0.0.1 and the port if None.
        origin: `Origin` that is sent; none if None.
        query: of the address, `?token=...` for instance.
        headers: sent too.
    """
    raw = socket.create_connection(("127.0.0.1", port))
    return connect(
        f"ws://{host or f'127.0.0.1:{port}'}/{query}",
        sock=raw,
        origin=None if origin is None else Origin(origin),
        subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
        additional_headers=headers,
        compression=None,
        max_size=None,
        max_queue=None,
    )


class Browser:
    """A page that is open, its camera sent."""

    def __init__(self, server: ViserServer, camera: _messages.ViewerCameraMessage = CAMERA, **asked: str) -> None:
        self.connection = open_websocket(server.get_port(), **asked)
        self.send(camera)

    def send(self, message: _messages.Message) -> None:
        self.connection.send(packed(message))

    def set(self, control: Any, value: object) -> None:
        self.send(_messages.GuiUpdateMessage(identifier_of(control), {"value": value}))

    def press(self, button: GuiButtonHandle) -> None:
        self.set(button, True)

    def command(self, client: ClientSession, text: str) -> None:
        """Type a command of the page, such as `1 steps`."""
        self.set(link_of(client), text)

    def click(self, origin: Any, direction: Any) -> None:
        """A click on what lies along a ray; the direction, of any length, is sent as the page does."""
        self.send_ray(origin, np.divide(direction, np.linalg.norm(direction)))

    def send_ray(self, origin: Any, direction: Any) -> None:
        ray = (tuple(map(float, numbers)) for numbers in (origin, direction))
        self.send(_messages.ScenePointerMessage("click", *ray, ((0.5, 0.5),), None))

    def upload(self, client: ClientSession, name: str, says: int, parts: list[bytes]) -> None:
        source = identifier_of(client.panel.upload)
        self.send(_messages.FileTransferStartUpload(source, "t1", name, "application/zip", len(parts), says))
        for index, part in enumerate(parts):
            self.send(_messages.FileTransferPart(source, "t1", index, part))

    def messages(self, seconds: float = 20.0) -> Iterator[dict[str, Any]]:
        """What the server sends, until it sends nothing for so long."""
        while True:
            try:
                raw = self.connection.recv(timeout=seconds)
            except TimeoutError:
                return
            assert isinstance(raw, bytes)
            yield from unpacked(raw)

    def sees(self, text: str) -> None:
        """Wait for a message that holds the text."""
        for message in self.messages():
            if text in repr(message):
                return
        pytest.fail(f"the server never said {text!r}")


def note_clients(monkeypatch: pytest.MonkeyPatch) -> list[ClientSession]:
    """Visitors, in the order in which they came."""
    clients: list[ClientSession] = []
    own = ClientSession.__init__

    def noted(self, client, *rest):
        own(self, client, *rest)
        clients.append(self)
        clients.sort(key=lambda v: v.handle.client_id)

    monkeypatch.setattr(ClientSession, "__init__", noted)
    return clients


def until(true: Callable[[], bool], seconds: float = 60.0, every: float = 0.02) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it did not come to that"
        time.sleep(every)


def link_of(client: ClientSession) -> Any:
    """The text control that the page types commands into."""
    return next(c for c in controls_of(client.handle).values() if getattr(c, "label", "") == LINK)


def is_open(client: ClientSession) -> bool:
    """Whether furniture is open and shown."""
    return client.editor is not None and not len(client.requests)


def begin_steps(browser: Browser, client: ClientSession) -> None:
    """Leave the opening view, as a press on Step by step does."""
    until(lambda: is_open(client))
    browser.command(client, "1 steps")
    until(lambda: client.editor is not None and not client.editor.view.is_opening)
    # The parts are shown; the thread of the session now draws what is on them.
    done = threading.Event()
    client.submit(done.set)
    assert done.wait(60)


def merges(client: ClientSession) -> int:
    return -1 if client.session is None else client.session.merges
