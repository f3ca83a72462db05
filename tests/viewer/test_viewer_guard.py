"""Who may talk to the viewer: its own pages, under this computer's own names, with the token where others reach it."""

from __future__ import annotations

import asyncio
import gc
import importlib.metadata
import logging
import socket
import tracemalloc
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from types import ModuleType

import pytest
import websockets
from websockets.exceptions import InvalidStatus

from orbit_core.interfaces import ConfigurationError
from orbit_viewer.guard import Guard, guarded, is_loopback
from orbit_viewer.viewer import Viewer

PROTOCOL = f"viser-v{importlib.metadata.version('viser')}"


@pytest.fixture(scope="module")
def local(fakes: ModuleType) -> Iterator[Viewer]:
    with Viewer(fakes.FakeEnvironment(num_envs=2), fakes.FakeAgent(), port=8250) as viewer:
        yield viewer


@pytest.fixture(scope="module")
def reachable(fakes: ModuleType) -> Iterator[Viewer]:
    with Viewer(fakes.FakeEnvironment(num_envs=2), fakes.FakeAgent(), host="0.0.0.0", port=8270) as viewer:
        yield viewer


def connect(port: int, origin: str | None = None, **headers: str) -> bool:
    """Whether a websocket is let in; the server must send it something."""

    async def attempt() -> bool:
        try:
            async with websockets.connect(
                f"ws://127.0.0.1:{port}", subprotocols=[PROTOCOL], additional_headers=headers, max_size=None,
                origin=origin,
            ) as opened:  # fmt: skip
                return len(await asyncio.wait_for(opened.recv(), 10)) > 0
        except InvalidStatus:
            return False

    return asyncio.run(attempt())


def fetch(url: str, **headers: str) -> tuple[int, str]:
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=10) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def port_of(viewer: Viewer) -> int:
    port = urllib.parse.urlsplit(viewer.url).port
    assert port is not None
    return port


def test_the_servers_own_pages_and_programs_of_this_computer_are_let_in(local: Viewer) -> None:
    port = port_of(local)
    assert fetch(local.url)[0] == 200
    assert fetch(f"http://localhost:{port}")[0] == 200
    assert connect(port, f"http://127.0.0.1:{port}")
    assert connect(port)  # no browser


@pytest.mark.parametrize("origin", ["http://evil.example", "http://127.0.0.1:9", "http://localhost", "null"])
def test_pages_of_other_origins_are_not_let_in(local: Viewer, origin: str) -> None:
    assert not connect(port_of(local), origin)


def test_a_foreign_name_that_points_here_is_refused(local: Viewer) -> None:
    status, told = fetch(local.url, Host="evil.example")
    assert status == 403
    assert "does not have the name 'evil.example'" in told


@pytest.mark.parametrize(
    "lines",
    [
        b"/ HTTP/1.1\r\nHost: [::1",
        b"/ HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: evil.example",
        b"/ HTTP/1.1\r\nHost: \xff\xfe",
        b"/ HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://[x",
        b"/ HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: x\r\nUpgrade: y",
        b"/ HTTP/1.1\r\nHost: 127.0.0.1\r\nAccept-Encoding: a\r\nAccept-Encoding: b",
        b"/" + b"a" * 300 + b" HTTP/1.1\r\nHost: 127.0.0.1",
    ],
)
def test_a_malformed_request_is_refused_without_a_traceback(
    local: Viewer, lines: bytes, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    with socket.create_connection(("127.0.0.1", port_of(local)), timeout=10) as client:
        client.sendall(b"GET " + lines + b"\r\n\r\n")
        assert client.recv(100).startswith(b"HTTP/1.1 400 Bad Request")
    assert capfd.readouterr() == ("", "")
    # A line of information is written where the program that imports ORBIT asks for those.
    assert not [record for record in caplog.records if record.levelno > logging.INFO]


def test_an_address_that_others_reach_asks_for_the_token_once(reachable: Viewer) -> None:
    port = port_of(reachable)
    bare = f"http://127.0.0.1:{port}/"
    status, told = fetch(bare)
    assert status == 403
    assert "it holds a token" in told
    assert fetch(f"{bare}?token=guessed")[0] == 403
    assert not connect(port, f"http://127.0.0.1:{port}")
    assert not connect(port, Cookie="orbit-viewer=guessed")

    given = reachable.url.replace("0.0.0.0", "127.0.0.1")
    opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    with opener.open(given, timeout=10) as page:
        assert page.url == bare, "the token is gone from the address"
        assert b"<html" in page.read()
    token = urllib.parse.parse_qs(urllib.parse.urlsplit(given).query)["token"][0]
    assert connect(port, f"http://127.0.0.1:{port}", Cookie=f"orbit-viewer={token}")
    assert not connect(port, "http://evil.example", Cookie=f"orbit-viewer={token}")


def test_nothing_is_shared_over_the_internet(local: Viewer, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []
    monkeypatch.setattr("viser._viser.ViserTunnel", lambda *details: asked.append(details))
    assert local._server.request_share_url() is None
    assert not asked


def test_memory_levels_off_over_connections(local: Viewer) -> None:
    for _ in range(10):
        assert connect(port_of(local))
    gc.collect()
    tracemalloc.start()
    try:
        for _ in range(30):
            assert connect(port_of(local))
        gc.collect()
        assert tracemalloc.get_traced_memory()[0] < 1_000_000, "bytes kept of 30 connections that are closed"
    finally:
        tracemalloc.stop()


def test_a_server_that_cannot_be_guarded_is_not_started() -> None:
    with pytest.raises(ConfigurationError, match="cannot guard"), guarded(Guard("127.0.0.1")):
        pass


@pytest.mark.parametrize(
    ("host", "alone"),
    [("127.0.0.1", True), ("localhost", True), ("::1", True), ("0.0.0.0", False), ("::", False), ("robot.lab", False)],
)
def test_loopback_addresses_are_known(host: str, alone: bool) -> None:
    assert is_loopback(host) is alone
    assert (Guard(host).token == "") is alone
