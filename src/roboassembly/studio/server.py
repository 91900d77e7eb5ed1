"""The server behind `roboassembly view`: one session a visitor."""

from __future__ import annotations

import logging
import socket
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from viser import ClientHandle, ViserServer, _messages, infra

from roboassembly.errors import InputError, RoboAssemblyError
from roboassembly.studio.house import LARGEST_UPLOAD, House
from roboassembly.viewer.server import quiet_server

if TYPE_CHECKING:
    from roboassembly.studio.visitor import Visitor

LOOPBACK = ("127.0.0.1", "localhost", "::1")
MOST_VISITORS = 64
"""At a time; each has a thread, and memory of its own."""


@contextmanager
def studio(house: House, host: str, port: int) -> Iterator[ViserServer]:
    """Serve until the end of the `with` block.

    Args:
        house: what all visitors share.
        host: address to listen on; any but the loopback lets others in.
        port: any free one if 0.

    Raises:
        InputError: the address cannot be listened on.
    """
    _check(host, port)
    with quiet_server(host, port) as server:
        visitors: dict[int, Visitor] = {}
        gone: set[int] = set()
        """Who may have left before they were let in."""
        lock = threading.Lock()
        _shut_tunnel(server)
        ready = threading.Thread(target=_prepare, args=(house,), name="prepare", daemon=True)
        ready.start()

        def come(client: ClientHandle) -> None:
            _limit_uploads(client)
            ready.join()
            from roboassembly.studio.visitor import Visitor

            with lock:
                if client.client_id in gone:
                    return
                full = len(visitors) >= MOST_VISITORS
                if not full:
                    visitors[client.client_id] = Visitor(client, house)
            if full:
                client.gui.add_markdown(f"All {MOST_VISITORS} places are taken; come back later.")

        def go(client: ClientHandle) -> None:
            with lock:
                visitor = visitors.pop(client.client_id, None)
                gone.add(client.client_id)
            if visitor is not None:
                visitor.close()

        server.on_client_connect(come)
        server.on_client_disconnect(go)
        try:
            yield server
        finally:
            for visitor in visitors.values():
                visitor.close()


def _prepare(house: House) -> None:
    """Load what visitors need, and make what they see first, while the browser is still loading the page."""
    from roboassembly.studio import visitor

    # Whoever comes will be told what is wrong with it.
    with suppress(RoboAssemblyError):
        visitor.open_first(house)


def _check(host: str, port: int) -> None:
    """Whether the address is free: viser would take the next one without a word."""
    if not 0 <= port < 65536:
        raise InputError(f"--port {port}; 0 (any that is free) to 65535 would do")
    try:
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        raise InputError(f"cannot listen on {host}:{port}: {error.strerror or error}; name another --port") from None


def _shut_tunnel(server: ViserServer) -> None:
    """Without this anyone could make viser open a tunnel to the outside, whether or not a button for it is shown."""
    server._websock_server.unregister_handler(_messages.ShareUrlRequest)


def _limit_uploads(client: ClientHandle) -> None:
    """Forget transfers that are too large, by what they say before any of them is kept, or by what comes."""

    def refuse(sender: infra.ClientId) -> None:
        client.gui._drop_uploads_from_client(sender)
        client.add_notification("Too large", f"At most {LARGEST_UPLOAD:,} bytes would do.", color="red")

    def begun(sender: infra.ClientId, message: _messages.FileTransferStartUpload) -> None:
        if message.size_bytes > LARGEST_UPLOAD:
            refuse(sender)

    def going_on(sender: infra.ClientId, message: _messages.FileTransferPart) -> None:
        state = client.gui._current_file_upload_states.get(message.transfer_uuid)
        if state is not None and state["transferred_bytes"] > LARGEST_UPLOAD:
            refuse(sender)

    # viser has no limit of its own.
    client.gui._websock_interface.register_handler(_messages.FileTransferStartUpload, begun)
    client.gui._websock_interface.register_handler(_messages.FileTransferPart, going_on)


def silence() -> None:
    """Keep what browsers do to their connections off the terminal."""
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection", category=UserWarning)
