"""Access control of the studio: the addresses that it answers to, the pages that may connect to it, and the token.

A page of another site can send requests to this machine, and can make its own name point to it (DNS rebinding). The
browser's headers reveal that: `Origin` names the page, `Host` names the requested address. Both are checked on every
request. Other machines also need a token, which is part of the address that is printed at the start.
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
_MOST_REPORTS = 20
"""Largest number of refused origins that the terminal reports, so that nobody can flood it."""
_WRONG_ADDRESS = """\
The studio does not answer to this address. Use the address that `roboassembly view` printed.
To use another address, for example behind a proxy or a tunnel, start the studio with --allow-origin and that address.
"""
_WRONG_TOKEN = (
    "The token is missing or wrong. Open the address that `roboassembly view` printed; it contains ?token=...\n"
)


def _ignore(_: str) -> None:
    pass


@dataclass(frozen=True)
class Origin:
    """Origin of a web page."""

    scheme: str
    host: str
    """Host name in lower case; an IPv6 address has no brackets."""
    port: int

    @staticmethod
    def parse(text: str) -> Origin | None:
        """Parse `http://HOST[:PORT]` or `https://HOST[:PORT]`; return None for any other text."""
        scheme, _, rest = text.partition("://")
        place = _parse_host(rest)
        if scheme not in _DEFAULT_PORTS or place is None:
            return None
        return Origin(scheme, place[0], place[1] or _DEFAULT_PORTS[scheme])


class Access:
    """Access rules of one studio.

    Args:
        host: address that the server listens on.
        token: token that every client needs. If empty, a random token is needed, or none if `host` is a loopback
            address.
        origins: further addresses of the page.
        report: called with a line for the terminal about each refused origin.

    Raises:
        InputError: `token` or one of `origins` is not valid.
    """

    def __init__(
        self, host: str, token: str = "", origins: Iterable[str] = (), report: Callable[[str], None] = _ignore
    ) -> None:
        if token and not _TOKEN.fullmatch(token):
            raise InputError("--token must have 8 to 200 characters: letters, digits and . _ ~ -")
        self.host = host
        self.token = token or ("" if is_loopback(host) else secrets.token_urlsafe(32))
        """Token that clients need; empty if they need none."""
        # Different from the token: browsers send cookies to every port of a host.
        self._cookie = secrets.token_urlsafe(32)
        self._allowed = [_origin(text) for text in origins]
        self._report = report
        self._reported: set[str] = set()

    def urls(self, port: int) -> list[str]:
        """Return the addresses of the page, with the token if one is needed; an address for this machine comes first.

        Args:
            port: port of the server.
        """
        hosts = [self.host]
        if is_loopback(self.host):
            hosts = ["localhost"]
        elif _is_any(self.host):
            hosts = ["localhost", *network_addresses()]
        query = f"/?token={self.token}" if self.token else ""
        return [f"http://{f'[{host}]' if ':' in host else host}:{port}{query}" for host in hosts]

    def refuse(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the response to a forbidden request; None if the request is allowed."""
        local, port = connection.local_address[:2]
        names = request.headers.get_all("Host")
        if len(names) != 1 or not self._answers_to(names[0], local, port):
            return plain_response(http.HTTPStatus.FORBIDDEN, _WRONG_ADDRESS)
        pages = request.headers.get_all("Origin")
        if len(pages) > 1 or (pages and not self._trusts(pages[0], local, port)):
            self._report_origin(pages[0])
            return plain_response(http.HTTPStatus.FORBIDDEN, _WRONG_ADDRESS)
        query = parse_qs(urlsplit(request.path).query, keep_blank_values=True)
        if not self._knows_token(request.headers, query):
            return plain_response(http.HTTPStatus.FORBIDDEN, _WRONG_TOKEN)
        if "Upgrade" not in request.headers and set(query) - {"token"}:
            # The address of viser's page can contain commands: `?websocket=` and `?playbackPath=` make it load content
            # from another server, which may include scripts.
            return plain_response(http.HTTPStatus.FOUND, "", Location=f"/?token={self.token}" if self.token else "/")
        return None

    def headers(self, request: Request) -> Mapping[str, str]:
        """Return the headers of the page, which let it connect only to this server and keep it out of frames."""
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
        """Return the names of this server.

        Args:
            local: numeric address of this machine that received the request; no name server can forge it.
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
        # Clients may send bytes that are not valid text.
        pairs = ((value.encode(errors="surrogatepass"), secret.encode()) for value, secret in given)
        return any(hmac.compare_digest(value, secret) for value, secret in pairs)

    def _report_origin(self, origin: str) -> None:
        """Report a refused page once; if the studio is behind a proxy, this is the address to allow."""
        shown = ascii(origin[:100])
        if shown not in self._reported and len(self._reported) < _MOST_REPORTS:
            self._reported.add(shown)
            self._report(
                f"refused a page from {shown}; if it is yours, start the studio with --allow-origin and that address"
            )


def _origin(text: str) -> Origin:
    origin = Origin.parse(text.removesuffix("/"))
    if origin is None:
        raise InputError(f"--allow-origin {text!a} is not an address; use one like https://studio.example.org")
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
    """Return a numeric address as in a URL; an IPv4 address from an IPv6 socket becomes plain IPv4."""
    try:
        number = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    mapped = number.ipv4_mapped if isinstance(number, ipaddress.IPv6Address) else None
    return str(mapped or number)


def network_addresses() -> list[str]:
    """Return this machine's address on its network; empty without a network. No data is sent."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect(("192.0.2.1", 9))
            address = probe.getsockname()[0]
    except OSError:
        return []
    return [] if is_loopback(address) else [address]


def _parse_host(text: str) -> tuple[str, int | None] | None:
    """Return host (lower case, no brackets) and port of `HOST` or `HOST:PORT`; None if the text is neither."""
    found = _HOST.fullmatch(text)
    if found is None:
        return None
    port = None if found[2] is None else int(found[2])
    if port is not None and not 0 < port < 65536:
        return None
    return found[1].lower().strip("[]"), port


def _cookie_name(place: tuple[str, int | None] | None) -> str:
    """Return the name of the cookie, with the port: all ports of a host share cookies, but studios must not."""
    return f"roboassembly-{place[1] if place and place[1] else 'default'}"
