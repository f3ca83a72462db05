"""Policies behind sockets: ours as a server, any server as an agent, and servers that misbehave."""

from __future__ import annotations

import threading
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
import torch

from orbit_core.backends import default_backend
from orbit_core.cli import main
from orbit_core.envs import make
from orbit_core.envs.environment import Environment
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_learn.policy import PolicyActor, load_policy
from orbit_learn.pretrained import policy_path
from orbit_learn.remote import client
from orbit_learn.remote.client import PolicyServer, RemoteActor, ServerAddress, ServerFailure
from orbit_learn.remote.server import PolicyService
from orbit_learn.remote.wire import decode, encode

websockets = pytest.importorskip("websockets.sync.server")


@contextmanager
def listening(handle: Callable[[Any], None]) -> Iterator[str]:
    """Address of a server that hands each connection to ``handle``."""
    with websockets.serve(handle, "127.0.0.1", 0, compression=None) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        server.shutdown()
        thread.join()


@contextmanager
def serving(name: str = "reach") -> Iterator[str]:
    """Address of a server of a kept policy."""
    server = PolicyService(load_policy(policy_path(name))).listen("127.0.0.1", 0)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
    server.shutdown()
    thread.join()


@pytest.fixture(scope="module")
def environment() -> Iterator[Environment]:
    environment = make("Reach", num_envs=2, backend=default_backend(), episode_length=0.5)
    yield environment
    environment.close()


def test_a_served_policy_acts_as_it_does_here(environment: Environment) -> None:
    here: list[torch.Tensor] = []
    environment.reset(4)
    actor = PolicyActor(environment, policy_path("reach"))
    for _ in range(5):
        here.append(actor.act())
        environment.step(here[-1])
    with serving() as address:
        environment.reset(4)
        remote = RemoteActor(environment, ServerAddress.parse(address))
        for action in here:
            there = remote.act()
            torch.testing.assert_close(there, action, rtol=0.0, atol=1e-5)
            environment.step(there)
        remote.close()
    assert remote.failed == 0


def test_a_server_tells_that_it_is_healthy() -> None:
    with serving() as address:
        assert urllib.request.urlopen(address.replace("ws://", "http://") + "/healthz").read() == b"OK\n"


def test_messages_come_back_as_they_were_sent() -> None:
    sent = {
        "observation/state": np.arange(6, dtype=np.float32).reshape(2, 3),
        "image": np.zeros((2, 2, 3), np.uint8),
        "prompt": "lift the cube",
        "nested": {"list": [1, 2.5, True]},
    }
    found = decode(encode(sent))
    assert found["prompt"] == "lift the cube"
    assert found["nested"] == {"list": [1, 2.5, True]}
    for name in ("observation/state", "image"):
        np.testing.assert_array_equal(found[name], sent[name])
        assert found[name].dtype == sent[name].dtype


def array(dtype: str, data: bytes, shape: list[Any]) -> bytes:
    packed = {b"__ndarray__": True, b"data": data, b"dtype": dtype, b"shape": shape}
    return msgspec.msgpack.encode({"actions": packed})


@pytest.mark.parametrize(
    ("message", "told"),
    [
        (array("|O", bytes(8), [1]), "numbers of up to 8 bytes"),
        (array("<f4", bytes(8), [3]), r"shape \(3,\) and 8 bytes"),
        (array("<f4", bytes(8), [-2]), "shape is none"),
        (array("<f4", bytes(8), [True, 2]), "shape is none"),
        (array("<c16", bytes(16), [1]), "numbers of up to 8 bytes"),
        (array("<M8[s]", bytes(8), [1]), "numbers of up to 8 bytes"),
        (array("i4,f4", bytes(8), [1]), "numbers of up to 8 bytes"),
        (array("(2,)f4", bytes(8), [1]), "numbers of up to 8 bytes|numbers"),
        (array("nonsense", bytes(8), [1]), "which there is not"),
        (array("<f4", np.float32(np.nan).tobytes(), [1]), "NaN"),
        (msgspec.msgpack.encode([1, 2]), "no map"),
        (msgspec.msgpack.encode({1: 2}), "no map with texts"),
        (b"\xc1", "no MessagePack"),
        (msgspec.msgpack.encode({"actions": float("inf")}), "not finite"),
        (array("<f4", b"", [0, 1 << 26, 1 << 26, 1 << 26]), "shape is none"),
        (b"\x91" * 100_000, "no MessagePack"),
        (b"\x81\xa1a" * 500 + b"\xc0", "nested more than 16 deep"),
        (b"\x81\xa1a\xa2\xff\xff", "no MessagePack"),
        (b"\x81\xa1a\xdd\x00\x02\x00\x00" + b"\x80" * (1 << 17), "more than 65,536 values"),
        (b"\x81\xa1a\x99" + (b"\xdc\x1f\xff" + b"\x80" * 0x1FFF) * 9, "more than 65,536 values"),
    ],
)
def test_hostile_messages_are_rejected(message: bytes, told: str) -> None:
    with pytest.raises(ConfigurationError, match=told):
        decode(message)


def answers(*replies: Any) -> Callable[[Any], None]:
    """Handler of a server that tells of itself, and then answers so: bytes and texts as they are, actions packed."""

    def handle(connection: Any) -> None:
        connection.send(encode({"model": "test"}))
        for reply in replies:
            connection.recv()
            if reply is None:
                break
            connection.send(reply if isinstance(reply, bytes | str) else encode({"actions": reply}))
        # Hangs until the client gives up.
        connection.recv()

    return handle


@pytest.mark.parametrize(
    ("reply", "told"),
    [
        (None, "has not answered for 1 s"),
        (np.zeros((4, 3), np.float32), "answered actions of 3 components"),
        (np.zeros(8, np.float32), "without 'actions'"),
        (encode({"action": 1}), "without 'actions'"),
        (b"\xc1", "a message that is none"),
        ("Traceback\nValueError: no such key", "reports an error: ValueError: no such key"),
    ],
)
def test_a_server_that_misbehaves_fails_its_episode_alone(environment: Environment, reply: Any, told: str) -> None:
    size, count = environment.action_size, iter(range(10))
    good = answers(*[np.full((1, size), 0.1, np.float32)] * 20)

    def handle(connection: Any) -> None:
        (answers(reply) if next(count) == 0 else good)(connection)

    with listening(handle) as address:
        environment.reset(0)
        # Long for the environment that is answered, on a busy machine; only one that hangs is waited for.
        actor = RemoteActor(environment, ServerAddress.parse(f"{address}?timeout={1 if reply is None else 60}"))
        for _ in range(3):
            action = actor.act()
            environment.step(action)
        actor.close()
    assert not action[0].any()
    torch.testing.assert_close(action[1], torch.full((size,), 0.1))
    assert actor.failed == 1
    assert told in next(iter(actor.failures))


def test_a_run_counts_episodes_without_an_answer_as_failures(capsys: pytest.CaptureFixture[str]) -> None:
    with listening(answers(None)) as address:
        words = f"run Reach --backend {default_backend()} --num-envs 2 --episodes 2 --set episode_length=0.1"
        # Any hand is near enough, so that an answer alone decides.
        words += " --set position_tolerance=10 --set rotation_tolerance=4"
        assert main([*words.split(), "--agent", f"{address}?timeout=1"]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "success rate 0.0 %" in told
    assert "episodes without an answer 2, counted as failures" in told


def test_all_environments_are_asked_before_the_first_answer_is_awaited(environment: Environment) -> None:
    together = threading.Barrier(environment.num_envs)

    def handle(connection: Any) -> None:
        connection.send(encode({}))
        connection.recv()
        together.wait(60.0)
        connection.send(encode({"actions": np.full((1, environment.action_size), 0.1, np.float32)}))

    with listening(handle) as address:
        environment.reset(0)
        actor = RemoteActor(environment, ServerAddress.parse(f"{address}?timeout=60"))
        assert (actor.act() == 0.1).all()
        actor.close()
    assert not actor.failed


def test_a_server_that_hangs_for_all_is_waited_for_once(
    environment: Environment, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, waits = [0.0], []

    def answer(server: PolicyServer, within: float) -> np.ndarray:
        waits.append(within)
        clock[0] += within
        raise ServerFailure("it hangs")

    with listening(answers(None)) as address:
        environment.reset(0)
        actor = RemoteActor(environment, ServerAddress.parse(f"{address}?timeout=60"))
        monkeypatch.setattr(client, "time", SimpleNamespace(monotonic=lambda: clock[0]))
        monkeypatch.setattr(PolicyServer, "answer", answer)
        assert not actor.act().any()
        actor.close()
    assert actor.failed == environment.num_envs
    assert waits == pytest.approx([60.0, 0.0], abs=0.1)


def test_the_next_episode_asks_a_server_again(environment: Environment) -> None:
    size, count = environment.action_size, iter(range(10))
    good = answers(*[np.full((1, size), 0.1, np.float32)] * 20)

    def handle(connection: Any) -> None:
        if next(count) == 0:
            connection.send(encode({}))
            connection.close()
        else:
            good(connection)

    with listening(handle) as address:
        environment.reset(0)
        actor = RemoteActor(environment, ServerAddress.parse(address))
        assert not actor.act()[0].any()
        environment.reset(0)
        assert actor.act()[0].any()
        actor.close()


def test_plans_are_executed_before_the_server_is_asked_again(environment: Environment) -> None:
    size, asked = environment.action_size, []

    def handle(connection: Any) -> None:
        connection.send(encode({}))
        while True:
            asked.append(decode(connection.recv()))
            plan = np.stack([np.full(size, step / 10, np.float32) for step in range(3)])
            connection.send(encode({"actions": plan}))

    with listening(handle) as address:
        environment.reset(0)
        query = "observation/state=joint_positions+joint_velocities&prompt=reach it"
        actor = RemoteActor(environment, ServerAddress.parse(f"{address}/?{query}"))
        first = []
        for _ in range(4):
            action = actor.act()
            first.append(float(action[0, 0]))
            environment.step(action)
        actor.close()
    assert first == pytest.approx([0.0, 0.1, 0.2, 0.0])
    assert len(asked) == 4, "two environments, two plans each"
    assert asked[0]["prompt"] == "reach it"
    assert asked[0]["observation/state"].shape == (18,)
    assert "orbit/begin" not in asked[0]


def test_bad_addresses_are_told(environment: Environment) -> None:
    with pytest.raises(ServerFailure, match="no policy server answers"):
        RemoteActor(environment, ServerAddress.parse("ws://127.0.0.1:9"))
    with pytest.raises(ConfigurationError, match="names no policy server"):
        ServerAddress.parse("ws://")
    with pytest.raises(ConfigurationError, match="timeout"):
        ServerAddress.parse("ws://127.0.0.1:9?timeout=never")
    with serving() as address, pytest.raises(UnknownNameError, match="joint_positions"):
        RemoteActor(environment, ServerAddress.parse(f"{address}?observation/state=joint_position"))


@pytest.mark.parametrize(
    ("request_", "told"),
    [
        ({}, "lacks 'observation/joint_positions'"),
        ({"observation/joint_positions": np.zeros(3, np.float32)}, "has shape"),
        ({"observation/joint_positions": np.zeros(9, np.uint8)}, "is of uint8"),
    ],
)
def test_a_bad_request_is_answered_in_one_line(request_: dict[str, Any], told: str) -> None:
    with serving() as address:
        server = PolicyServer(ServerAddress.parse(address))
        server.ask(request_)
        with pytest.raises(ServerFailure, match=told):
            server.answer()
