"""viser's server, for pages that are written and for the studio; light, so that it can listen before all else.

viser serves its page and its websocket to everyone: it checks neither `Origin` nor `Host`, and has no hook for either.
Each server here gets a `Guard`, which decides about every request before viser sees it.
"""

from __future__ import annotations

import http
import inspect
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import rich
import viser
import websockets.asyncio.server
from viser import ViserServer
from websockets import Headers
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

_LARGEST_MESSAGE = 2**20
"""Bytes of one message from a browser. viser's page sends files in pieces of half of that."""
_MOST_QUEUED = 4
"""Messages of one connection that wait to be handled; after that its socket is not read."""
_PATCHING = threading.Lock()


@dataclass(frozen=True)
class Guard:
    """Decides who may talk to a server, and checks what they say."""

    refuse: Callable[[ServerConnection, Request], Response | None]
    """Answers a request, for the page or for the websocket, that is not allowed; None lets it through."""
    headers: Callable[[Request], Mapping[str, str]]
    """Headers to add to the page that answers a request."""
    connect: Callable[..., ServerConnection] = ServerConnection
    """Makes the connection; takes what `ServerConnection` takes."""


def answer(status: http.HTTPStatus, text: str, **headers: str) -> Response:
    """A short plain answer that no browser takes for a page."""
    body = text.encode()
    fixed = {"Content-Type": "text/plain; charset=utf-8", "X-Content-Type-Options": "nosniff"}
    fixed |= {"Content-Length": str(len(body)), "Connection": "close"}
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return Response(status.value, status.phrase, Headers(**fixed, **named), body)


NOBODY = Guard(lambda *_: answer(http.HTTPStatus.FORBIDDEN, "This server only writes a file.\n"), lambda _: {})
"""Lets nobody in. viser records a page through a server that listens, and nobody needs to reach that one."""


@contextmanager
def quiet_server(host: str, port: int, guard: Guard = NOBODY) -> Iterator[ViserServer]:
    """A viser server that does not announce itself, shows no axes of the world, and is gone afterwards.

    viser announces itself through rich's console, from two threads, whatever `verbose` says; so that console is kept
    quiet meanwhile.

    Args:
        host: address to listen on.
        port: any free one if 0.
        guard: asked about every request.

    Raises:
        RuntimeError: this version of viser cannot be guarded.
    """
    console = rich.get_console()
    was_quiet, console.quiet = console.quiet, True
    try:
        server = _guarded(host, port, guard)
        server.scene.world_axes.visible = False
        try:
            yield server
        finally:
            server.stop()
    finally:
        console.quiet = was_quiet


def _guarded(host: str, port: int, guard: Guard) -> ViserServer:
    """Start a server whose requests all pass a guard.

    viser builds its server by one call of `websockets.asyncio.server.serve`, in a thread that its constructor starts
    and waits for. That call is the only place where limits, checks and the class of connections can be set, so it is
    replaced for as long as the constructor runs. If a later viser no longer makes that call, this fails at once rather
    than serve without a guard.
    """
    calls = 0
    serve: Any = websockets.asyncio.server.serve

    def guarded(*args: Any, process_request: Any, **kwargs: Any) -> Any:
        nonlocal calls
        calls += 1

        async def process(connection: ServerConnection, request: Request) -> Response | None:
            refused = guard.refuse(connection, request)
            if refused is not None:
                return refused
            page = process_request(connection, request)
            if inspect.isawaitable(page):
                page = await page
            if page is not None:
                for name, value in guard.headers(request).items():
                    page.headers[name] = value
            return page

        limits = {"max_size": _LARGEST_MESSAGE, "max_queue": _MOST_QUEUED, "server_header": None}
        return serve(*args, **(kwargs | limits), process_request=process, create_connection=guard.connect)

    with _PATCHING:
        websockets.asyncio.server.serve = guarded  # pyright: ignore[reportAttributeAccessIssue]
        try:
            server = ViserServer(host=host, port=port, verbose=False)
        finally:
            websockets.asyncio.server.serve = serve
    if not calls:
        server.stop()
        raise RuntimeError(f"viser {viser.__version__} does not start its server as 1.1 does; install viser 1.1")
    return server
