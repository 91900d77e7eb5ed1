"""Server of the studio: one session per client."""

from __future__ import annotations

import functools
import logging
import socket
import threading
import warnings
from collections.abc import Generator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from viser import ClientHandle, ViserServer

from roboassembly.errors import InputError, RoboAssemblyError
from roboassembly.studio.access import Access
from roboassembly.studio.config import StudioConfig
from roboassembly.studio.incoming import Clients, StudioConnection
from roboassembly.studio.page import make_page
from roboassembly.viewer.server import Guard, quiet_server

if TYPE_CHECKING:
    from roboassembly.studio.client_session import ClientSession
    from roboassembly.studio.step_pictures import PictureDrawer

MOST_CLIENTS = 64
"""Largest number of clients at a time; each has its own thread and memory."""


@contextmanager
def run_studio(config: StudioConfig, access: Access, port: int) -> Generator[ViserServer]:
    """Run a studio for a `with` block.

    Args:
        config: configuration of the studio.
        access: access rules, and the address to listen on.
        port: port to listen on; any free one if 0.

    Raises:
        InputError: the server cannot listen on the address.
    """
    _check_address(access.host, port)
    registered = Clients()
    connection = functools.partial(StudioConnection, clients=registered)
    guard = Guard(access.refuse, access.headers, connection, make_page())
    with quiet_server(access.host, port, guard) as server:
        registered.attach(server)
        sessions: dict[int, ClientSession] = {}
        lock = threading.Lock()
        ready = threading.Thread(target=_prepare, args=(config,), name="prepare", daemon=True)
        ready.start()
        drawers: list[PictureDrawer] = []

        def connect(client: ClientHandle) -> None:
            ready.join()
            from roboassembly.studio.client_session import ClientSession
            from roboassembly.studio.step_pictures import PictureDrawer

            with lock:
                if client.client_id not in server.get_clients():
                    return  # it has gone already
                full = len(sessions) >= MOST_CLIENTS
                if not drawers:
                    drawers.append(PictureDrawer())
                if not full:
                    sessions[client.client_id] = ClientSession(client, config, drawers[0])
            if full:
                client.gui.add_markdown(f"All {MOST_CLIENTS} places are taken. Reload the page later.")

        def disconnect(client: ClientHandle) -> None:
            with lock:
                session = sessions.pop(client.client_id, None)
            if session is not None:
                session.close()

        server.on_client_connect(connect)
        server.on_client_disconnect(disconnect)
        try:
            yield server
        finally:
            with lock:
                open_sessions = list(sessions.values())
            for session in open_sessions:
                session.close()
            for drawer in drawers:
                drawer.close()


def _prepare(config: StudioConfig) -> None:
    """Import the modules of a session and open the first furniture while the browser loads the page."""
    from roboassembly.studio import client_session

    # The client gets the error when its session opens the furniture.
    with suppress(RoboAssemblyError):
        client_session.open_first(config)


def _check_address(host: str, port: int) -> None:
    """Check that the address is free; viser would silently use the next port.

    Raises:
        InputError: the server cannot listen on it.
    """
    if not 0 <= port < 65536:
        raise InputError(f"--port {port} is not valid; it must be 0 (any free port) to 65535")
    try:
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except (OSError, UnicodeError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise InputError(f"cannot listen on {host}:{port}: {reason}; choose another --host or --port") from None


def silence_connection_messages() -> None:
    """Keep messages about closed connections off the terminal."""
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection", category=UserWarning)
