"""Who may talk to the viewer's web server: pages that the server itself gave out, and nobody else's.

A browser lets any page on the web open a websocket to this computer, and tells the server from where the page came. A
request passes only where that origin is the server itself, under one of this computer's own names: a foreign name that
was made to point here is refused as well. An address that other computers reach asks for a token besides, which the
printed address carries once and a cookie from then on.
"""

from __future__ import annotations

import http
import http.cookies
import ipaddress
import secrets
import threading
import urllib.parse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from orbit_core.interfaces import ConfigurationError

_COOKIE = "orbit-viewer"
_PATCHING = threading.Lock()
ProcessRequest = Callable[[ServerConnection, Request], Response | None]


def is_loopback(host: str) -> bool:
    """Whether only this computer reaches an address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class Guard:
    """Lets requests pass, or answers them itself.

    Args:
        host: address that the server listens at.
    """

    def __init__(self, host: str) -> None:
        self._loopback = is_loopback(host)
        self.token = "" if self._loopback else secrets.token_urlsafe(24)
        """What the first request must carry as ``?token=``; empty where only this computer reaches the server."""

    def answer(self, request: Request) -> Response | None:
        """None for a request that may pass."""
        headers = request.headers
        host, origins = headers.get("Host", ""), headers.get_all("Origin")
        if self._loopback and not is_loopback(_name_of(host)):
            return _refusal(f"this server is not called '{host}'")
        if any(urllib.parse.urlsplit(origin).netloc != host for origin in origins):
            return _refusal("pages of other origins may not talk to this server")
        if not self.token or self._is_known(headers):
            return None
        query = urllib.parse.parse_qs(urllib.parse.urlsplit(request.path).query)
        if self._is_token(query.get("token", [""])[0]):
            cookie = f"{_COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/"
            return Response(http.HTTPStatus.FOUND, "Found", Headers(Location="/", **{"Set-Cookie": cookie}), b"")
        return _refusal("open the address that was printed where the viewer was started: it holds a token")

    def _is_known(self, headers: Headers) -> bool:
        cookies = http.cookies.SimpleCookie()
        try:
            cookies.load("; ".join(headers.get_all("Cookie")))
        except http.cookies.CookieError:
            return False
        return _COOKIE in cookies and self._is_token(cookies[_COOKIE].value)

    def _is_token(self, given: str) -> bool:
        return secrets.compare_digest(given.encode(), self.token.encode())


@contextmanager
def guarded(guard: Guard) -> Iterator[None]:
    """A web server that a library starts within asks the guard first.

    The library has no door for that, so the function that it starts its server with is wrapped for as long.

    Raises:
        ConfigurationError: the library started none in the way that is known.
    """
    serve = websockets.asyncio.server.serve
    wrapped = 0

    def serve_guarded(*arguments: Any, process_request: ProcessRequest | None = None, **options: Any) -> Any:
        def process(connection: ServerConnection, request: Request) -> Response | None:
            answer = guard.answer(request)
            return answer if answer or process_request is None else process_request(connection, request)

        nonlocal wrapped
        wrapped += 1
        return serve(*arguments, process_request=process, **options)

    with _PATCHING:
        websockets.asyncio.server.serve = serve_guarded  # pyright: ignore[reportAttributeAccessIssue]
        try:
            yield
        finally:
            websockets.asyncio.server.serve = serve
    if not wrapped:
        raise ConfigurationError(
            "this version of viser starts its web server in a way that cannot be guarded against other origins' pages: "
            'pip install "orbit-core[viewer]" brings one that can'
        )


def _name_of(host: str) -> str:
    """The name or address in a ``Host`` header, without the port."""
    return urllib.parse.urlsplit(f"//{host}").hostname or ""


def _refusal(why: str) -> Response:
    body = f"{why}\n".encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, body)
