"""Robots and clients as processes and threads on loopback: whatever one of them does, the other says it in one line."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from orbit_core.backends import default_backend
from orbit_core.interfaces import ConfigurationError, OrbitError
from orbit_deploy.computer import RobotComputer
from orbit_deploy.link import RobotFaultError, RobotLink, RobotLinkError, connect
from orbit_deploy.messages import VERSION, JointCommand, Mode, RobotState
from tests.deploy.rig import PERIOD, eventually, rests, served

zmq = pytest.importorskip("zmq")

from orbit_zmq import client as client_module  # noqa: E402
from orbit_zmq.client import ZmqLink  # noqa: E402
from orbit_zmq.keys import make_keys  # noqa: E402
from orbit_zmq.wire import Codec, Hello, Offer, Ping, Refusal  # noqa: E402


def swing(link: ZmqLink, steps: int) -> RobotState:
    begin = [*link.state().targets]
    for step in range(steps):
        link.send([begin[0] + 0.01 * step, *begin[1:]], [0.0] * 3, [0.0] * 3)
        link.wait(link.now() + PERIOD)
    return link.state()


def test_a_robot_follows_and_its_answers_are_timed(link: ZmqLink) -> None:
    state = swing(link, 25)
    assert state.positions[0] > 0.05
    assert len(link.round_trips) > 10
    # The clocks are one here, whatever the load.
    assert abs(1e-9 * link.offset.offset) <= link.offset.error + 1e-4
    assert link.ages.percentiles()[0] < 0.5


def test_a_second_client_is_refused_while_the_first_goes_on(robot: tuple[RobotComputer, str], link: ZmqLink) -> None:
    with pytest.raises(RobotLinkError, match=rf"refuses \(busy\): client {os.getpid()}@\S+ commands the robot"):
        connect(robot[1], PERIOD)
    assert swing(link, 5).mode is Mode.FOLLOWING


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (lambda now: JointCommand(10**6, now, [math.nan, 0.0, 0.0], [0.0] * 3, [0.0] * 3), "nan"),
        (lambda now: JointCommand(10**6, now + 10**10, [0.0] * 3, [0.0] * 3, [0.0] * 3), "time"),
        (lambda now: JointCommand(10**6, now, [0.0] * 2, [0.0] * 3, [0.0] * 3), "shape"),
    ],
    ids=["nan", "time", "shape"],
)
def test_a_command_that_cannot_be_meant_stops_the_robot(
    robot: tuple[RobotComputer, str], link: ZmqLink, command: object, words: str
) -> None:
    swing(link, 5)
    link._post(command(link.offset.to_remote(time.monotonic_ns())))  # type: ignore[operator]
    assert eventually(lambda: bool(link._faults))
    with pytest.raises(RobotFaultError, match=rf"has stopped \({words}\)"):
        link.state()
    assert eventually(lambda: rests(robot[0]))
    assert link.clear().mode is Mode.HOLDING
    assert swing(link, 5).command >= 5


def test_a_client_that_leaves_in_motion_leaves_a_robot_at_rest(robot: tuple[RobotComputer, str]) -> None:
    assert eventually(lambda: not robot[0].client)
    link = connect(robot[1], PERIOD)
    assert isinstance(link, ZmqLink)
    swing(link, 10)
    link.close()
    assert eventually(lambda: rests(robot[0]))
    assert robot[0].client == ""


def test_other_versions_and_messages_that_are_none_are_refused(robot: tuple[RobotComputer, str]) -> None:
    context, codec = zmq.Context(), Codec()
    socket = context.socket(zmq.DEALER)
    socket.connect(robot[1].replace("zmq", "tcp"))
    answers = []
    for data in (codec.encode(Hello(99, "other", PERIOD)), b"\xff\x00", codec.encode(JointCommand(0, 0, [], [], []))):
        socket.send(data)
        assert socket.poll(5000)
        answers.append(codec.from_robot(socket.recv()))
    socket.send(codec.encode(Ping(7)))
    assert socket.poll(5000)
    context.destroy(linger=0)
    assert [answer.code for answer in answers if isinstance(answer, Refusal)] == ["version", "message", "busy"]
    assert f"speaks version {VERSION} of the messages, and the client 99" in answers[0].text


def test_nobody_at_the_address_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_module, "_ANSWER", 0.3)
    with pytest.raises(RobotLinkError, match=r"no robot at zmq://127.0.0.1:9: none has answered within 0.3 s"):
        connect("zmq://127.0.0.1:9", PERIOD)
    for address in ("127.0.0.1:5555", "zmq://", "zmq://host"):
        with pytest.raises(OrbitError, match="is no"):
            connect(address, PERIOD)


def test_an_address_is_taken_once(robot: tuple[RobotComputer, str]) -> None:
    from orbit_zmq.server import ZmqServer

    with pytest.raises(ConfigurationError, match=r"cannot listen at 127\.0\.0\.1"):
        ZmqServer(robot[0], robot[1])


def test_beyond_this_machine_both_sides_need_keys(robot: tuple[RobotComputer, str], tmp_path: Path) -> None:
    from orbit_zmq.server import ZmqServer

    with pytest.raises(ConfigurationError, match="make keys with 'orbit robot --make-keys"):
        ZmqServer(robot[0], "zmq://0.0.0.0:0")
    with pytest.raises(ConfigurationError, match="make keys with 'orbit robot --make-keys"):
        connect("zmq://192.0.2.1:5555", PERIOD)
    make_keys(tmp_path)
    with pytest.raises(ConfigurationError, match="holds keys already"):
        make_keys(tmp_path)


def test_a_robot_with_keys_takes_the_client_with_its_key_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own, other = tmp_path / "own", tmp_path / "other"
    make_keys(own)
    make_keys(other)
    (other / "robot.key").write_bytes((own / "robot.key").read_bytes())
    with served(own) as (_, address):
        link = connect(address, PERIOD, own)
        assert link.state().mode is Mode.HOLDING
        link.close()
        monkeypatch.setattr(client_module, "_ANSWER", 0.5)
        for keys in (None, other):
            with pytest.raises(RobotLinkError, match=r"refused the keys|none has answered"):
                connect(address, PERIOD, keys)


def test_messages_return_as_they_were_sent(link: ZmqLink) -> None:
    codec, state = Codec(), link.state()
    offer = Offer(link.description, state)
    assert codec.from_robot(codec.encode(offer)) == offer
    assert codec.from_robot(codec.encode(state)) == state


@pytest.fixture(scope="module")
def process() -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A robot's computer as the command line starts it, and its address."""
    words = ["robot", "--task", "Cartpole-Balance", "--backend", default_backend(), "--port", "0"]
    code = f"from orbit_core.cli import main; raise SystemExit(main({words!r}))"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        yield process, line.split(" at ")[1].split()[0]
        process.kill()


def test_a_robot_that_stops_answering_is_an_error_and_comes_back_at_rest(
    process: tuple[subprocess.Popen[str], str],
) -> None:
    running, address = process
    link = connect(address, PERIOD)
    link.send([0.0] * 2, [0.0] * 2, [1.0, 0.0])
    os.kill(running.pid, signal.SIGSTOP)
    try:
        with pytest.raises(RobotLinkError, match="has not answered for"):
            watch(link)
        os.kill(running.pid, signal.SIGCONT)
        # The command may have waited in the robot's queue, and is too old then.
        assert eventually(lambda: _mode(link) in (Mode.HOLDING, Mode.FAULT))
    finally:
        os.kill(running.pid, signal.SIGCONT)
        link.close()


def watch(link: RobotLink) -> None:
    """Read states for two seconds."""
    for _ in range(100):
        link.wait(link.now() + PERIOD)
        link.state()


def _mode(link: object) -> Mode | None:
    try:
        return link.state().mode  # type: ignore[attr-defined]
    except OrbitError:
        return None


def test_deploy_runs_a_tasks_expert_on_the_robot_and_leaves_it_at_rest(
    process: tuple[subprocess.Popen[str], str], tmp_path: Path
) -> None:
    import msgspec

    from orbit_core.cli import main

    file = tmp_path / "result.json"
    words = ["deploy", "expert", "--task", "Cartpole-Balance", "--bridge", process[1], "--countdown", "0"]
    priority = os.sched_getscheduler(0)
    assert main([*words, "--set", "episode_length=1.0", "--json", str(file)]) == 0
    assert os.sched_getscheduler(0) == priority
    result = msgspec.json.decode(file.read_bytes())
    assert (result["episodes"], result["agent"]) == (1, "expert")
    assert result["steps"] >= 10


def test_interrupting_a_robots_computer_ends_it_at_rest_with_its_timing(
    process: tuple[subprocess.Popen[str], str],
) -> None:
    running, _ = process
    running.send_signal(signal.SIGINT)
    words, _ = running.communicate(timeout=20.0)
    assert "loop: " in words
    assert running.returncode == 130
