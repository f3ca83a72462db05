"""Bytes, numbers and clients that nobody would send on purpose: the robot goes on, or rests with one error."""

from __future__ import annotations

import random
import socket
import threading
import time

import msgspec
import pytest

from orbit_core.interfaces import ConfigurationError
from orbit_deploy.computer import RobotComputer
from orbit_deploy.link import RobotFaultError, RobotLinkError, connect
from orbit_deploy.messages import VERSION, Arrangement, JointCommand, Mode
from tests.deploy.rig import PERIOD, eventually, rests

zmq = pytest.importorskip("zmq")

from orbit_zmq import client as client_module  # noqa: E402
from orbit_zmq.client import ZmqLink  # noqa: E402
from orbit_zmq.wire import Codec, FromClient, Hello, MoveTo, Offer, Order, Ping, Pong, Refusal  # noqa: E402


def mutated(data: bytes, source: random.Random) -> bytes:
    """Return a message with some bytes changed, cut off or inserted."""
    changed = bytearray(data)
    for _ in range(source.randint(1, 4)):
        place, kind = source.randrange(len(changed) + 1), source.random()
        if kind < 0.6 and place < len(changed):
            changed[place] = source.randrange(256)
        elif kind < 0.8:
            del changed[place:]
        else:
            changed[place:place] = source.randbytes(source.randint(1, 30))
    return bytes(changed)


def test_messages_with_wrong_bytes_leave_the_robot_running_and_at_rest(
    robot: tuple[RobotComputer, str], link: ZmqLink
) -> None:
    now, source, codec = link.offset.to_remote(time.monotonic_ns()), random.Random(0), Codec()
    numbers = [0.1, 0.0, 0.0]
    messages: list[FromClient] = [
        JointCommand(1, now, numbers, numbers, numbers), MoveTo(numbers), Order("stop"), Ping(5),
        Arrangement(True, numbers, "cube", [1.5, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0]), Hello(VERSION, "fuzz", PERIOD),
    ]  # fmt: skip
    for count in range(600):
        link._wake_out.send(mutated(codec.encode(source.choice(messages)), source))
        if count % 50 == 0:
            time.sleep(0.02)

    def answered() -> bool:
        count = link._answers.qsize()
        time.sleep(0.3)
        return 100 < count == link._answers.qsize()

    # Answers that are still on their way would be taken for that of the next request.
    assert eventually(answered, 20.0)
    link._faults.clear()
    # Some of the messages are still ones that a client may send, as for a slow motion.
    link.clear()
    assert eventually(lambda: rests(robot[0]), 20.0)
    assert robot[0]._running


GREETING = b"\xff" + b"\0" * 8 + b"\x7f\x03\0NULL"


@pytest.mark.parametrize("data", [b"GET / HTTP/1.0\r\n\r\n", bytes(range(256)) * 100, GREETING + b"\xff" * 100])
def test_other_protocols_on_the_robots_port_do_not_disturb_its_client(link: ZmqLink, data: bytes) -> None:
    host, _, port = link.address.removeprefix("zmq://").partition(":")
    with socket.create_connection((host, int(port))) as stranger:
        stranger.sendall(data)
        time.sleep(0.05)
    assert link.clear().mode is Mode.HOLDING


@pytest.mark.parametrize(
    "pose", [[0.0] * 7, [1e300] * 7, [1.0] * 6, [float("nan")] * 7], ids=["no rotation", "huge", "short", "nan"]
)
def test_a_pose_that_is_none_is_refused_in_one_sentence(link: ZmqLink, pose: list[float]) -> None:
    with pytest.raises(RobotLinkError, match=r"refuses \(request\)"):
        link.arrange(Arrangement(object="cube", pose=pose))
    assert link.state().mode is Mode.HOLDING


def test_commands_beyond_a_limit_are_clamped_and_counted_and_beyond_twice_refused(
    robot: tuple[RobotComputer, str], link: ZmqLink
) -> None:
    # The joints turn to 1.5 rad, at up to 2 rad/s.
    link.send([0.2, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0] * 3)
    assert eventually(lambda: link.state().clamped == 1)
    link.send([0.2, 0.0, 0.0], [4.5, 0.0, 0.0], [0.0] * 3)
    assert eventually(lambda: bool(link._faults))
    with pytest.raises(RobotFaultError, match=r"\(limit\): .* a velocity to joint joint0 that is 2.5 above its limit"):
        link.state()
    assert eventually(lambda: rests(robot[0]))


def test_a_client_whose_name_is_a_command_to_terminals_is_named_without_it(
    robot: tuple[RobotComputer, str], link: ZmqLink
) -> None:
    link.close()
    assert eventually(lambda: not robot[0].client)
    context, codec = zmq.Context(), Codec()
    first = context.socket(zmq.DEALER)
    first.connect(robot[1].replace("zmq", "tcp"))
    first.send(codec.encode(Hello(VERSION, "\x1b[2J evil\n", PERIOD)))
    assert first.poll(5000)
    with pytest.raises(RobotLinkError, match=r"client \?\[2J evil\? commands the robot"):
        connect(robot[1], PERIOD)
    first.send(codec.encode(Order("leave")))
    assert eventually(lambda: not robot[0].client)
    context.destroy(linger=0)


def watch(link: ZmqLink) -> None:
    """Read states for two seconds."""
    for _ in range(200):
        link.state()
        time.sleep(0.01)


class OtherComputer:
    """Computer at a port that answers as a test says."""

    def __init__(self, description: object) -> None:
        self._context = zmq.Context()
        self.socket = self._context.socket(zmq.ROUTER)
        port = self.socket.bind_to_random_port("tcp://127.0.0.1")
        self.address, self.description = f"zmq://127.0.0.1:{port}", description

    def answer(self, reply: object) -> None:
        """Send this to the next client that says hello."""
        peer, _ = self.socket.recv_multipart()
        self.socket.send_multipart((peer, reply if isinstance(reply, bytes) else Codec().encode(reply)))

    def close(self) -> None:
        self._context.destroy(linger=0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (None, r"speaks version 2"),
        (b"\x00\x01garbage", r"refuses \(message\): a message was not understood"),
        ({"lower": []}, r"describes 3 joints and 0 of 'lower'"),
        ({"rate": float("inf")}, r"rate is inf Hz"),
        ({"home": [float("nan")] * 3}, r"'home' holds a NaN"),
        ({"clock": 1 << 64 - 1}, r"does not say what time it is"),
    ],
    ids=["version", "bytes", "lists", "rate", "nan", "clock"],
)
def test_a_robot_of_another_version_or_without_sense_is_one_error(
    change: object, words: str, link: ZmqLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not (isinstance(change, dict) and "clock" in change):  # whose test lasts as long as this
        monkeypatch.setattr(client_module, "_ANSWER", 20.0)
    other = OtherComputer(link.description)

    def speak() -> None:
        if change is None:
            other.answer(Refusal("version", "the robot speaks version 2 of the messages, and the client 3"))
        elif isinstance(change, bytes):
            other.answer(change)
        else:
            assert isinstance(change, dict)
            fields = {name: value for name, value in change.items() if name != "clock"}
            other.answer(Offer(msgspec.structs.replace(link.description, **fields), link.state()))
            for _ in range(20 * ("clock" in change)):
                other.answer(Pong(0, change["clock"]))

    thread = threading.Thread(target=speak, daemon=True)
    thread.start()
    with pytest.raises((RobotLinkError, ConfigurationError), match=words):
        connect(other.address, PERIOD)
    thread.join(2.0)
    other.close()


@pytest.mark.parametrize(
    ("name", "value"), [("positions", [0.0] * 2), ("target_efforts", []), ("objects", [[0.0] * 5]), ("imus", [[0.0]])]
)
def test_a_robot_that_sends_the_state_of_another_is_one_error_and_is_stopped(
    robot: tuple[RobotComputer, str], link: ZmqLink, name: str, value: object
) -> None:
    listeners = list(robot[0].on_state)
    robot[0].on_state[:] = [lambda state: [each(msgspec.structs.replace(state, **{name: value})) for each in listeners]]  # type: ignore[list-item]
    try:
        with pytest.raises(RobotLinkError, match=rf"sends '{name}' of another robot: it is stopped"):
            watch(link)
    finally:
        robot[0].on_state[:] = listeners


def test_deploy_refuses_a_policy_for_other_joints_before_the_robot_moves(
    robot: tuple[RobotComputer, str], capsys: pytest.CaptureFixture[str]
) -> None:
    from orbit_core.cli import main

    assert eventually(lambda: not robot[0].client)
    words = ["deploy", "expert", "--task", "Cartpole-Balance", "--bridge", robot[1], "--countdown", "0"]
    assert main(words) != 0
    told = " ".join("".join(capsys.readouterr()).split())
    assert "is a three_joints with joints joint0, joint1, joint2, and the task's is a cartpole" in told
    assert rests(robot[0])
