"""The server behind `roboassembly view`: one session a visitor."""

from __future__ import annotations

import functools
import logging
import socket
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from viser import ClientHandle, ViserServer

from roboassembly.errors import InputError, RoboAssemblyError
from roboassembly.studio.access import Access
from roboassembly.studio.house import House
from roboassembly.studio.incoming import Clients, StudioConnection
from roboassembly.viewer.server import Guard, quiet_server

if TYPE_CHECKING:
    from roboassembly.studio.visitor import Visitor

MOST_VISITORS = 64
"""At a time; each has a thread, and memory of its own."""


@contextmanager
def studio(house: House, access: Access, port: int) -> Iterator[ViserServer]:
    """Serve until the end of the `with` block.

    Args:
        house: what all visitors share.
        access: who may visit, and the address to listen on.
        port: any free one if 0.

    Raises:
        InputError: the address cannot be listened on.
    """
    _check(access.host, port)
    clients = Clients()
    guard = Guard(access.refuse, access.headers, functools.partial(StudioConnection, clients=clients))
    with quiet_server(access.host, port, guard) as server:
        clients.belong_to(server)
        visitors: dict[int, Visitor] = {}
        lock = threading.Lock()
        ready = threading.Thread(target=_prepare, args=(house,), name="prepare", daemon=True)
        ready.start()

        def come(client: ClientHandle) -> None:
            ready.join()
            from roboassembly.studio.visitor import Visitor

            with lock:
                if client.client_id not in server.get_clients():
                    return  # gone before it was let in
                full = len(visitors) >= MOST_VISITORS
                if not full:
                    visitors[client.client_id] = Visitor(client, house)
            if full:
                client.gui.add_markdown(f"All {MOST_VISITORS} places are taken. Load the page again later.")

        def go(client: ClientHandle) -> None:
            with lock:
                visitor = visitors.pop(client.client_id, None)
            if visitor is not None:
                visitor.close()

        server.on_client_connect(come)
        server.on_client_disconnect(go)
        try:
            yield server
        finally:
            with lock:
                here = list(visitors.values())
            for visitor in here:
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
    except (OSError, UnicodeError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise InputError(f"cannot listen on {host}:{port}: {reason}; name another --port") from None


def silence() -> None:
    """Keep what browsers do to their connections off the terminal."""
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection", category=UserWarning)
