"""Who may open the page, and which of several pages has control."""

from __future__ import annotations

import http
import ipaddress
import secrets
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from unifeed_ros.core.errors import ConfigError

COOKIE = "unifeed_token"


def is_loopback(host: str) -> bool:
    """Say whether an address is reached from this machine only.

    Args:
        host: Name or address.

    Raises:
        ConfigError: This machine cannot listen there.
    """
    try:
        found = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)
        with socket.socket(found[0][0], socket.SOCK_STREAM) as probe:
            probe.bind(found[0][4])
    except OSError as error:
        raise ConfigError("address of the console", expected="an address of this machine", got=f"{host}: {error}",
                          mend="127.0.0.1 is this machine alone, 0.0.0.0 every network") from error
    return all(ipaddress.ip_address(str(entry[4][0]).partition("%")[0]).is_loopback for entry in found)


def choose_token(host: str, given: str) -> str:
    """Choose the token that a page must show.

    Args:
        host: Address that is listened on.
        given: Token from the settings; empty: none was chosen.

    Returns:
        The given one, a fresh one where other machines could reach the page, and an empty one otherwise.
    """
    return given if given or is_loopback(host) else secrets.token_urlsafe(18)


class Gate:
    """Looks at every request before it reaches the page.

    A page of another site that runs in the same browser could open a connection to this machine too: what does not
    come from the page itself (Origin) or under a foreign name (Host) is refused, also without a token.

    Args:
        token: What must be shown as ?token=... once, and as a cookie from then on; empty: nothing.
        local: True if the page is for this machine only.
    """

    def __init__(self, token: str, *, local: bool) -> None:
        self._token, self._local = token, local

    def refusal(self, path: str, headers: Headers) -> str:
        """Say why a request is refused; empty if it is not.

        Args:
            path: Path with its query.
            headers: Headers of the request.
        """
        host = headers.get("Host", "")
        if self._local and not _is_local_name(host):
            return "this page is for this machine only"
        origin = headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return "the request comes from another site"
        if self._token and not self._shown(path, headers):
            return "the token is missing or wrong: open the address that the console printed"
        return ""

    def cookie(self, path: str) -> str:
        """Give the cookie to set when the address held the right token; empty otherwise."""
        given = parse_qs(urlsplit(path).query).get("token", [""])[0]
        if self._token and secrets.compare_digest(given.encode(), self._token.encode()):
            return f"{COOKIE}={self._token}; HttpOnly; SameSite=Strict; Path=/"
        return ""

    def _shown(self, path: str, headers: Headers) -> bool:
        try:
            cookies = [SimpleCookie(text) for text in headers.get_all("Cookie")]
        except CookieError:
            cookies = []
        shown = [cookie[COOKIE].value for cookie in cookies if COOKIE in cookie]
        return bool(self.cookie(path)) or any(secrets.compare_digest(s.encode(), self._token.encode()) for s in shown)


def _is_local_name(host: str) -> bool:
    name = urlsplit(f"//{host}").hostname or ""
    if name == "localhost":
        return True
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


@contextmanager
def guarded(gate: Gate) -> Iterator[None]:
    """Put a gate before every server that is started meanwhile.

    viser gives no place for a check of its own; it calls `websockets.asyncio.server.serve` while it is constructed.
    """
    original = websockets.asyncio.server.serve

    def serve(handler: Any, *places: Any, process_request: Callable[..., Response | None], **settings: Any) -> Any:
        def check(connection: Any, request: Request) -> Response | None:
            if reason := gate.refusal(request.path, request.headers):
                body = f"{reason}\n".encode()
                return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", Headers(
                    {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))}), body)
            response = process_request(connection, request)
            if response is not None and (cookie := gate.cookie(request.path)):
                response.headers["Set-Cookie"] = cookie
            return response

        return original(handler, *places, process_request=check, **settings)

    websockets.asyncio.server.serve = serve  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        websockets.asyncio.server.serve = original  # type: ignore[misc]


class Holder:
    """Which of the open pages gives commands: the first one, until it closes or hands control over.

    All pages of one console are one party of the lesson's control (console/lease.py); this divides it among them.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pages: list[int] = []
        self._holder: int | None = None

    @property
    def holder(self) -> int | None:
        """Page in control; None while no page is open."""
        return self._holder

    def open(self, page: int) -> None:
        """Note that a page was opened; the first one takes control."""
        with self._lock:
            self._pages.append(page)
            if self._holder is None:
                self._holder = page

    def close(self, page: int) -> None:
        """Note that a page was closed; control goes to the page that has been open for longest."""
        with self._lock:
            self._pages = [p for p in self._pages if p != page]
            if self._holder == page:
                self._holder = self._pages[0] if self._pages else None

    def take(self, page: int) -> None:
        """Give control to a page that asks for it."""
        with self._lock:
            if page in self._pages:
                self._holder = page

    def may(self, page: int | None) -> bool:
        """Say whether a page is the one that gives commands."""
        return page is not None and page == self._holder
