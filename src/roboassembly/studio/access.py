"""Who may open the studio: the addresses it answers to, the pages that may connect to it, and the token.

A page of any other site can send requests to this machine, and can make a name of its own point to it (DNS rebinding).
The browser then says so: `Origin` names the page, `Host` names the address that was asked for. Both are checked on
every request. Other machines also need a token, which stands in the address that is printed at start.
"""

from __future__ import annotations

import hmac
import http
import ipaddress
import re
import secrets
import socket
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from urllib.parse import parse_qs, urlsplit

from websockets import Headers
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from roboassembly.errors import InputError
from roboassembly.viewer.server import plain_response

_LOOPBACK_NAMES = ("127.0.0.1", "localhost", "::1")
_DEFAULT_PORTS = {"http": 80, "https": 443}
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(?::([0-9]{1,5}))?")
_TOKEN = re.compile(r"[A-Za-z0-9._~-]{8,200}")
_MOST_NOTES = 20
"""Refused origins that the terminal names, so that nobody can flood it."""
_WRONG_ADDRESS = """\
The studio does not answer to this address. Use the address that `roboassembly view` printed.
To reach it under another one, behind a proxy or a tunnel for instance, start it with --allow-origin and that address.
"""
_WRONG_TOKEN = "The studio needs its token. Open the address that `roboassembly view` printed, with ?token=... in it.\n"


@dataclass(frozen=True)
class Origin:
    """Where a page comes from."""

    scheme: str
    host: str
    """In lower case, an IPv6 address without its brackets."""
    port: int

    @staticmethod
    def parse(text: str) -> Origin | None:
        """Read `http://HOST` or `https://HOST:PORT`; None if it is anything else."""
        scheme, _, rest = text.partition("://")
        place = _parse_host(rest)
        if scheme not in _DEFAULT_PORTS or place is None:
            return None
        return Origin(scheme, place[0], place[1] or _DEFAULT_PORTS[scheme])


class Access:
    """Who may open the studio.

    Args:
        host: address that is listened on.
        token: needed by everyone if given. Without one, a random token is needed unless `host` is a loopback address.
        origins: further addresses under which the page is reached.
        note: gets a line for the terminal about each origin that is refused.

    Raises:
        InputError: `token` or one of `origins` is none.
    """

    def __init__(
        self, host: str, token: str = "", origins: Iterable[str] = (), note: Callable[[str], None] = lambda _: None
    ) -> None:
        if token and not _TOKEN.fullmatch(token):
            raise InputError("--token takes 8 to 200 letters, digits or any of . _ ~ -")
        self.host = host
        self.token = token or ("" if is_loopback(host) else secrets.token_urlsafe(32))
        """Empty if none is needed."""
        # Not the token: browsers send cookies to every port of a host.
        self._cookie = secrets.token_urlsafe(32)
        self._allowed = [_origin(text) for text in origins]
        self._note = note
        self._noted: set[str] = set()

    def urls(self, port: int) -> list[str]:
        """Addresses to open, the first one on this machine where there is one; with the token, if one is needed.

        Args:
            port: that is served.
        """
        hosts = [self.host]
        if is_loopback(self.host):
            hosts = ["localhost"]
        elif _is_any(self.host):
            hosts = ["localhost", *_own_address()]
        query = f"/?token={self.token}" if self.token else ""
        return [f"http://{f'[{host}]' if ':' in host else host}:{port}{query}" for host in hosts]

    def refuse(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request that is not allowed; None if it is."""
        local, port = connection.local_address[:2]
        names = request.headers.get_all("Host")
        if len(names) != 1 or not self._answers_to(names[0], local, port):
            return plain_response(http.HTTPStatus.FORBIDDEN, _WRONG_ADDRESS)
        pages = request.headers.get_all("Origin")
        if len(pages) > 1 or (pages and not self._trusts(pages[0], local, port)):
            self._report(pages[0])
            return plain_response(http.HTTPStatus.FORBIDDEN, _WRONG_ADDRESS)
        query = parse_qs(urlsplit(request.path).query, keep_blank_values=True)
        if not self._knows_token(request.headers, query):
            return plain_response(http.HTTPStatus.FORBIDDEN, _WRONG_TOKEN)
        if "Upgrade" not in request.headers and set(query) - {"token"}:
            # viser's page takes orders from its address: `?websocket=` and `?playbackPath=` make it load what another
            # server says, which may be a script.
            return plain_response(http.HTTPStatus.FOUND, "", Location=f"/?token={self.token}" if self.token else "/")
        return None

    def headers(self, request: Request) -> Mapping[str, str]:
        """Headers for the page: it connects to this server only, and no other page shows it in a frame."""
        host = request.headers["Host"]
        policy = [
            f"connect-src 'self' ws://{host} wss://{host} data: blob:",
            "frame-ancestors 'none'", "form-action 'none'", "base-uri 'none'", "object-src 'none'",
        ]  # fmt: skip
        headers = {
            "Content-Security-Policy": "; ".join(policy),
            "X-Frame-Options": "DENY",
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cache-Control": "no-store",
        }
        if self.token:
            name = _cookie_name(_parse_host(host))
            headers["Set-Cookie"] = f"{name}={self._cookie}; Path=/; HttpOnly; SameSite=Strict"
        return headers

    def _answers_to(self, text: str, local: str, port: int) -> bool:
        place = _parse_host(text)
        if place is None:
            return False
        host, asked = place
        if (asked or _DEFAULT_PORTS["http"]) == port and host in self._own_names(local):
            return True
        return any(
            host == origin.host and (asked or _DEFAULT_PORTS[origin.scheme]) == origin.port for origin in self._allowed
        )

    def _trusts(self, text: str, local: str, port: int) -> bool:
        origin = Origin.parse(text)
        if origin is None:
            return False
        own = origin.scheme == "http" and origin.port == port and origin.host in self._own_names(local)
        return own or origin in self._allowed

    def _own_names(self, local: str) -> tuple[str, ...]:
        """Names of this server.

        Args:
            local: address of this machine that the request came to. It is a number, which no name server can forge.
        """
        names = (*_LOOPBACK_NAMES, _plain(local))
        return names if _is_any(self.host) else (*names, self.host.lower())

    def _knows_token(self, headers: Headers, query: Mapping[str, list[str]]) -> bool:
        if not self.token:
            return True
        given = [(value, self.token) for value in query.get("token", [])[:1]]
        name = _cookie_name(_parse_host(headers["Host"]))
        for line in headers.get_all("Cookie"):
            for pair in line.split(";"):
                key, _, value = pair.strip().partition("=")
                if key == name:
                    given.append((value, self._cookie))
        # What a client sends need not be text.
        pairs = ((value.encode(errors="surrogatepass"), wanted.encode()) for value, wanted in given)
        return any(hmac.compare_digest(value, wanted) for value, wanted in pairs)

    def _report(self, origin: str) -> None:
        """Tell the terminal which page was refused, once: behind a proxy that is the address to allow."""
        shown = ascii(origin[:100])
        if shown not in self._noted and len(self._noted) < _MOST_NOTES:
            self._noted.add(shown)
            self._note(f"refused a page of {shown}; if it is yours, start with --allow-origin and that address")


def _origin(text: str) -> Origin:
    origin = Origin.parse(text.removesuffix("/"))
    if origin is None:
        raise InputError(f"--allow-origin {text!a} is no address; one like https://studio.example.org would do")
    return origin


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach the address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def _is_any(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return not host


def _plain(address: str) -> str:
    """A numeric address as it stands in a URL; IPv4 that came through an IPv6 socket is IPv4."""
    try:
        number = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    mapped = number.ipv4_mapped if isinstance(number, ipaddress.IPv6Address) else None
    return str(mapped or number)


def _own_address() -> list[str]:
    """This machine's address on the network that it is connected to, if it is to any. Nothing is sent."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect(("192.0.2.1", 9))
            address = probe.getsockname()[0]
    except OSError:
        return []
    return [] if is_loopback(address) else [address]


def _parse_host(text: str) -> tuple[str, int | None] | None:
    """Host, in lower case and without brackets, and port of `HOST` or `HOST:PORT`; None if it is neither."""
    found = _HOST.fullmatch(text)
    if found is None:
        return None
    port = None if found[2] is None else int(found[2])
    if port is not None and not 0 < port < 65536:
        return None
    return found[1].lower().strip("[]"), port


def _cookie_name(place: tuple[str, int | None] | None) -> str:
    """Name of the cookie: cookies of all ports of a host go together, and two studios must not share one."""
    return f"roboassembly-{place[1] if place and place[1] else 'default'}"
