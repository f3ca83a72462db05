"""The socket of a leader arm: who may send, what is taken, and what strangers can do, which is nothing."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress

import pytest

from orbit_core.interfaces import ConfigurationError
from orbit_data.teleoperation import leader as module
from orbit_data.teleoperation.device import MOST_EVENTS, DeviceLostError, Event, Reading
from orbit_data.teleoperation.leader import Leader

NOTHING = Reading()
PAGE = (
    b"POST / HTTP/1.1\r\nHost: 127.0.0.1:8090\r\nOrigin: https://evil.example\r\nContent-Type: text/plain\r\n"
    b'Content-Length: 52\r\n\r\n\n{"joints":{"a":1.5},"event":"discard"}\n'
)


@pytest.fixture
def leader() -> Iterator[Leader]:
    made = Leader(("a", "b"), 0)
    yield made
    made.close()


def connected(leader: Leader, *lines: bytes) -> socket.socket:
    client = socket.create_connection(("127.0.0.1", leader.port), timeout=10)
    client.sendall(b"".join(lines))
    return client


def greeted(leader: Leader, *lines: bytes) -> socket.socket:
    return connected(leader, leader.greeting.encode() + b"\n", *lines)


def error_of(client: socket.socket) -> str:
    with client.makefile("rb") as answers:
        return json.loads(answers.readline())["error"]


def awaited(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_leader_sends_lines_and_learns_what_is_wrong(leader: Leader) -> None:
    with greeted(leader) as client, client.makefile("rb") as answers:
        for bad in (
            b"no json\n",
            b'{"joints": {"c": 1}}\n',
            b'{"joints": {"a": "1"}}\n',
            b'{"joints": {"a": 1e308}}\n',
            b'{"joints": {"a": -1e5}}\n',
            b'{"joint": {}}\n',
            b"[" * 5000 + b"\n",
            b"\xff\n",
        ):
            client.sendall(bad)
            assert "error" in json.loads(answers.readline())
        assert leader.read() == NOTHING
        client.sendall(b'{"joints": {"a": 0.5}}\n{"gripper_open": false, "event": "record"}\n')
        with greeted(leader) as other:
            assert "another leader" in error_of(other)
        awaited(lambda: len(leader._events) == 1)
        reading = leader.read()
        assert reading == Reading(
            joints={"a": 0.5}, gripper_open=False, events=(Event.RECORD,), moved_at=reading.moved_at
        )
    awaited(lambda: bool(leader._lost))
    with pytest.raises(DeviceLostError, match="closed"):
        leader.read()


def test_what_strangers_do_changes_nothing(leader: Leader) -> None:
    """Pages of other sites, connections that leave, say nothing, send no end or a wrong token; and then the leader."""
    with ExitStack() as strangers:
        for _ in range(2 * module._STRANGERS):
            strangers.enter_context(connected(leader))
        for lines in (
            PAGE,
            b'{"joints": {"a": 1.5}, "event": "discard"}\n',
            b'{"token": "guessed"}\n{"joints": {"a": 1.5}}\n',
            b'{"token": "\\ud800"}\n',
            b'{"token": "\xc3\xa9"}\n',
            b'{"token": 1}\n',
            b"[" * 5000 + b"\n",
            b"x" * 200_000,
            b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\n",
        ):
            stranger = strangers.enter_context(connected(leader, lines))
            try:
                assert "token" in error_of(stranger)
            except ConnectionResetError:  # it was still sending
                assert len(lines) > 1000 or lines is PAGE
        connected(leader).close()
        assert leader.read() == NOTHING
        with greeted(leader, b'{"joints": {"b": 0.25}}\n'):
            awaited(lambda: leader._joints is not None)
            assert leader.read().joints == {"b": 0.25}
            assert leader.read().joints == {"b": 0.25}, "joints hold until others are named"


def test_a_connection_that_sends_no_token_is_closed(leader: Leader, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_PATIENCE", 0.1)
    with connected(leader, b'{"tok') as silent:
        assert "token" in error_of(silent)
        assert silent.recv(1) == b""


def test_events_that_wait_are_few(leader: Leader) -> None:
    lines = b'{"event": "reset"}\n' * 3000
    with greeted(leader, lines, b'{"joints": {"a": 1.0}}\n') as client:
        assert f"{MOST_EVENTS} events wait" in error_of(client)
        awaited(lambda: leader._joints is not None)
        assert leader.read().events == (Event.RESET,) * MOST_EVENTS


def test_the_leaders_socket_is_this_computers_alone_and_is_closed_at_the_end(leader: Leader) -> None:
    assert leader._socket.getsockname()[0] == "127.0.0.1"
    with pytest.raises(ConfigurationError, match=f"port {leader.port}.*--leader-port"):
        Leader(("a",), leader.port)
    with greeted(leader) as client:
        awaited(lambda: leader._connected)
        leader.close()
        leader.close()
        with suppress(ConnectionResetError):
            assert client.recv(1) == b""
    with pytest.raises(ConnectionRefusedError):
        connected(leader)
