"""Guard of the viewer's web server: only pages that the server itself served may talk to it.

A browser lets any page on the web open a websocket to this computer, and sends the server the page's origin. A request
passes only if that origin is the server itself, under one of this computer's own names: a foreign name that was made to
point here (DNS rebinding) is refused as well. An address that other computers reach also requires a token, which the
printed address carries once and a cookie from then on.
"""

from __future__ import annotations

import http
import http.cookies
import ipaddress
import secrets
import threading
import urllib.parse
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError

_COOKIE = "orbit-viewer"
_PATCHING = threading.Lock()
Listener = Callable[[ServerConnection], Awaitable[None]]
ProcessRequest = Callable[[ServerConnection, Request], Response | None]


@dataclass(frozen=True)
class Page:
    """Page in addition to viser's, at the same address and behind the same guard."""

    path: str
    """Path of the page: ``/name``."""
    html: bytes
    """Content of the page."""
    listen: Listener
    """Function that serves a websocket opened at the path, until it is closed."""


def is_loopback(host: str) -> bool:
    """Return whether only this computer reaches an address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class Guard:
    """Guard that lets requests pass, or answers them itself.

    Args:
        host: address that the server listens on.
        pages: pages in addition to viser's.
    """

    def __init__(self, host: str, pages: Sequence[Page] = ()) -> None:
        self.pages = {page.path: page for page in pages}
        """Pages by their paths."""
        self._loopback = is_loopback(host)
        self.token = "" if self._loopback else secrets.token_urlsafe(24)
        """Token that the first request must carry as ``?token=``; empty if only this computer reaches the server."""

    def answer(self, request: Request) -> Response | None:
        """Return the refusal or redirection of a request, or None if the request may pass."""
        headers = request.headers
        host, origins = headers.get("Host", ""), headers.get_all("Origin")
        # A name in DNS that points to 127.0.0.1 makes a foreign page look local, except for this header.
        if self._loopback and not is_loopback(_name_of(host)):
            return _refusal(f"this server does not have the name '{host}'")
        if any(urllib.parse.urlsplit(origin).netloc != host for origin in origins):
            return _refusal("pages of other origins must not talk to this server")
        if not self.token or self._is_known(headers):
            return None
        query = urllib.parse.parse_qs(urllib.parse.urlsplit(request.path).query)
        if self._is_token(query.get("token", [""])[0]):
            # SameSite keeps other sites' requests from carrying the token; HttpOnly hides it from scripts.
            cookie = f"{_COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/"
            page = self.page(request)
            headers = Headers(Location=page.path if page else "/", **{"Set-Cookie": cookie})
            return Response(http.HTTPStatus.FOUND, "Found", headers, b"")
        return _refusal("open the address that was printed where the viewer was started: it holds a token")

    def page(self, request: Request) -> Page | None:
        """Return the page that a request asks for, if it is one of :attr:`pages`."""
        return self.pages.get(request.path.partition("?")[0])

    def _is_known(self, headers: Headers) -> bool:
        cookies = http.cookies.SimpleCookie()
        try:
            cookies.load("; ".join(headers.get_all("Cookie")))
        except http.cookies.CookieError:
            return False
        return _COOKIE in cookies and self._is_token(cookies[_COOKIE].value)

    def _is_token(self, given: str) -> bool:
        # In constant time, so that response times do not reveal how much of a guess is right.
        return secrets.compare_digest(given.encode(), self.token.encode())


@contextmanager
def guarded(guard: Guard) -> Iterator[None]:
    """Put a guard in front of a web server that viser starts within the context.

    viser has no hook for that, so the function that it starts its server with is replaced for that time.

    Raises:
        ConfigurationError: viser did not start its server by that function.
    """
    serve = websockets.asyncio.server.serve
    wrapped = 0

    def serve_guarded(
        handler: Listener, *arguments: Any, process_request: ProcessRequest | None = None, **options: Any
    ) -> Any:
        def process(connection: ServerConnection, request: Request) -> Response | None:
            try:
                return answered(connection, request)
            except (ValueError, LookupError, OSError):  # a host, repeated header or path that no browser sends
                return _refusal("malformed request", http.HTTPStatus.BAD_REQUEST)

        def answered(connection: ServerConnection, request: Request) -> Response | None:
            if answer := guard.answer(request):
                return answer
            if page := guard.page(request):
                return None if request.headers.get("Upgrade") else _shown(page)
            return None if process_request is None else process_request(connection, request)

        async def handle(connection: ServerConnection) -> None:
            page = guard.page(connection.request) if connection.request else None
            await (page.listen if page else handler)(connection)

        nonlocal wrapped
        wrapped += 1
        return serve(handle, *arguments, process_request=process, **options)

    # One patch at a time: two viewers that start together would otherwise restore each other's function.
    with _PATCHING:
        websockets.asyncio.server.serve = serve_guarded  # pyright: ignore[reportAttributeAccessIssue]
        try:
            yield
        finally:
            websockets.asyncio.server.serve = serve
    if not wrapped:
        raise ConfigurationError(
            "this version of viser starts its web server in a way that ORBIT cannot guard against pages of other "
            f"origins: {install_extra('viewer')} installs a version that it can"
        )


def _name_of(host: str) -> str:
    """Return the name or address in a ``Host`` header, without the port."""
    return urllib.parse.urlsplit(f"//{host}").hostname or ""


def _shown(page: Page) -> Response:
    headers = Headers({"Content-Type": "text/html; charset=utf-8", "Content-Length": str(len(page.html))})
    return Response(http.HTTPStatus.OK, "OK", headers, page.html)


def _refusal(why: str, status: http.HTTPStatus = http.HTTPStatus.FORBIDDEN) -> Response:
    body = f"{why}\n".encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    return Response(status, status.phrase, headers, body)
