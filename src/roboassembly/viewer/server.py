"""viser's server behind a guard, for the studio and for the recording of pages. It imports little and starts fast.

viser serves its page and its websocket to everyone: it checks neither `Origin` nor `Host`, and has no hook for either.
Each server here has a `Guard`, which checks every request before viser sees it.
"""

from __future__ import annotations

import gzip
import http
import inspect
import threading
from collections.abc import Callable, Generator, Mapping
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
"""Largest message from a browser [bytes]. viser's page sends files in chunks of half that size."""
_MOST_QUEUED = 4
"""Largest number of unhandled messages per connection; beyond it, the socket is not read."""
_PATCHING = threading.Lock()


@dataclass(frozen=True)
class Guard:
    """Decides who may connect to a server, and checks what they send."""

    refuse: Callable[[ServerConnection, Request], Response | None]
    """Returns the response to a forbidden request for the page or the websocket; None if the request is allowed."""
    headers: Callable[[Request], Mapping[str, str]]
    """Returns additional headers for the response to a request."""
    connect: Callable[..., ServerConnection] = ServerConnection
    """Constructs the connection, with the arguments of `ServerConnection`."""
    page: str = ""
    """Page to serve in place of viser's; viser's own if empty."""


def plain_response(status: http.HTTPStatus, text: str, **headers: str) -> Response:
    """Return a plain-text response that no browser interprets as a page."""
    body = text.encode()
    fixed = {"Content-Type": "text/plain; charset=utf-8", "X-Content-Type-Options": "nosniff"}
    fixed |= {"Content-Length": str(len(body)), "Connection": "close"}
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return Response(status.value, status.phrase, Headers(**fixed, **named), body)


class _Pages:
    """Replaces viser's page in responses.

    Args:
        page: page to serve; viser's own if empty.
    """

    def __init__(self, page: str) -> None:
        self._plain = page.encode()
        self._packed = gzip.compress(self._plain, 6, mtime=0) if page else b""

    def replace(self, response: Response) -> None:
        """Replace the body of a response if it is viser's page."""
        if not self._plain or not response.headers.get("Content-Type", "").startswith("text/html"):
            return
        response.body = self._packed if response.headers.get("Content-Encoding") == "gzip" else self._plain
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))


REFUSE_ALL = Guard(
    lambda _, __: plain_response(http.HTTPStatus.FORBIDDEN, "This server only writes a file.\n"), lambda _: {}
)
"""Refuses every request. viser records a page through a listening server, which no client needs."""


@contextmanager
def quiet_server(host: str, port: int, guard: Guard = REFUSE_ALL) -> Generator[ViserServer]:
    """Run a viser server for a `with` block, without announcements on the terminal and without world axes.

    viser announces itself through rich's console, from two threads, whatever `verbose` says; so that console is kept
    quiet meanwhile.

    Args:
        host: address to listen on.
        port: port to listen on; any free one if 0.
        guard: checks every request.

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
    and waits for. Limits, checks and the class of connections can only be set in that call, so the function is
    replaced while the constructor runs. If a later viser does not make that call, this fails at once rather than
    serve without a guard.
    """
    calls = 0
    served = _Pages(guard.page)
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
                served.replace(page)
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
