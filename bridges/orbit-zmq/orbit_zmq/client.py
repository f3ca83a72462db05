"""Client: a link to a robot's computer, whose own thread keeps the session, the clock's offset and the newest state."""

from __future__ import annotations

import itertools
import os
import queue
import socket
import threading
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path

import zmq
from zmq.utils.monitor import recv_monitor_message

from orbit_core.interfaces import ConfigurationError
from orbit_deploy.clocks import ClockOffset, Latencies, StampWatch
from orbit_deploy.computer import not_finite
from orbit_deploy.follower import PathKind
from orbit_deploy.link import RobotLink, RobotLinkError, fault_error, misfit
from orbit_deploy.messages import PASSING, VERSION, Arrangement, Fault, JointCommand, RobotState
from orbit_deploy.pictures import PictureBox
from orbit_zmq.keys import CLIENT, ROBOT, check_keys, key_pair, public_key, split_address
from orbit_zmq.wire import (
    MOST_PICTURE_BYTES,
    Answer,
    Codec,
    FromClient,
    Hello,
    MoveTo,
    Offer,
    Order,
    Ping,
    Pong,
    Refusal,
)

_numbers = itertools.count()
# Seconds in which a robot answers a hello or a request
_ANSWER = 3.0
# Seconds without a state after which the robot no longer answers
_LOST = 0.5
# Seconds between questions for the robot's clock: many at first, then a few
_PING, _FIRST_PINGS = 0.1, 20
# ns: three centuries
_MOST_TIME = 1 << 63
_FAILED = (
    zmq.Event.HANDSHAKE_FAILED_AUTH, zmq.Event.HANDSHAKE_FAILED_PROTOCOL, zmq.Event.HANDSHAKE_FAILED_NO_DETAIL,
)  # fmt: skip


class ZmqLink(RobotLink):
    """Session with a robot's computer.

    Args:
        address: ``zmq://host:port``.
        period: seconds between commands.
        keys: folder with ``client.key_secret`` and ``robot.key``; needed beyond this machine.
        path: way in which commands become a path.

    Raises:
        ConfigurationError: the address is none, or other machines reach it and there are no keys.
        RobotLinkError: nobody answers there, the robot speaks another version, or another client commands it.
    """

    def __init__(
        self, address: str, period: float, keys: Path | None = None, path: PathKind = PathKind.QUINTIC
    ) -> None:
        host, port = split_address(address)
        check_keys(host, keys)
        self.address = address
        self.offset, self.round_trips, self.ages = ClockOffset(), Latencies(), Latencies()
        self.pictures = PictureBox()
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.DEALER)
        self._socket.setsockopt(zmq.LINGER, 200)
        _secure(self._socket, host, keys)
        self._monitor = self._socket.get_monitor_socket()
        self._answers: queue.Queue[Offer | Answer | Refusal] = queue.Queue()
        self._faults: deque[Fault] = deque()
        self._state: RobotState | None = None
        self._arrived, self._stamps = 0, StampWatch()
        self._sent: deque[tuple[int, int]] = deque(maxlen=1000)
        self._sequence = 0
        self._handshake_failed = False
        self._codec = Codec()
        inside = f"inproc://client-{next(_numbers)}"
        self._wake_in, self._wake_out = self._context.socket(zmq.PAIR), self._context.socket(zmq.PAIR)
        self._wake_in.bind(inside)
        self._wake_out.connect(inside)
        shown = f"[{host}]" if ":" in host else host
        self._socket.connect(f"tcp://{shown}:{port}")
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="zmq client", daemon=True)
        self._thread.start()
        try:
            offer = self._ask(Hello(VERSION, f"{os.getpid()}@{socket.gethostname()}", period, path))
            if not isinstance(offer, Offer):
                raise RobotLinkError(f"the robot at {address} answered a hello with something else")
            offer.description.check()
            self._wait_for_clock()
        except Exception:
            self.close()
            raise
        self.description = offer.description
        """Robot as its computer offered it."""
        self._viewer = None
        if offer.pictures:
            # Another thread: reading a large picture must not hold up commands.
            arguments = (f"tcp://{shown}:{offer.pictures}", host, keys)
            self._viewer = threading.Thread(target=self._view, args=arguments, name="zmq pictures", daemon=True)
            self._viewer.start()

    # Called by the client's thread

    def send(self, positions: Sequence[float], velocities: Sequence[float], efforts: Sequence[float]) -> None:
        now = time.monotonic_ns()
        targets = (list(values) for values in (positions, velocities, efforts))
        # Noted before it is sent, as its answer may be faster than this thread.
        self._sent.append((self._sequence, now))
        self._post(JointCommand(self._sequence, self.offset.to_remote(now), *targets))
        self._sequence += 1

    def state(self) -> RobotState:
        if self._faults:
            raise fault_error(self._faults.popleft(), self.address)
        state, age = self._state, 1e-9 * (time.monotonic_ns() - self._arrived)
        if state is None or age > _LOST:
            raise RobotLinkError(f"the robot at {self.address} has not answered for {age:.2f} s: it stops on its own")
        if name := misfit(state, self.description):
            self.stop()
            raise RobotLinkError(f"the robot at {self.address} sends '{name}' of another robot: it is stopped")
        if joint := not_finite(state, self.description):
            self.stop()
            raise RobotLinkError(f"the robot at {self.address} sends no finite number for {joint}: it is stopped")
        if self._stamps.jump:
            self.stop()
            raise RobotLinkError(
                f"the clock of the robot at {self.address} jumped by {self._stamps.jump:+.3g} s: it is stopped, "
                "connect again"
            )
        self.ages.add(1e-9 * (time.monotonic_ns() - self.offset.to_ours(state.stamp)))
        return state

    def move_to(self, positions: Sequence[float]) -> RobotState:
        return self._request(MoveTo(list(positions)))

    def arrange(self, arrangement: Arrangement) -> RobotState:
        return self._request(arrangement)

    def clear(self) -> RobotState:
        self._faults.clear()
        return self._request(Order("clear"))

    def stop(self) -> None:
        self._post(Order("stop"))

    def close(self) -> None:
        if self._ended.is_set():
            return
        self._post(Order("leave"))
        self._ended.set()
        self._thread.join(2.0)
        if (viewer := getattr(self, "_viewer", None)) is not None:
            viewer.join(2.0)
        self._socket.disable_monitor()
        self._monitor.close(0)
        self._context.destroy(linger=200)

    def _request(self, message: FromClient) -> RobotState:
        answer = self._ask(message)
        if not isinstance(answer, Answer):
            raise RobotLinkError(f"the robot at {self.address} answered a request with something else")
        return answer.state

    def _ask(self, message: FromClient) -> Offer | Answer:
        """Send a request and wait for its answer."""
        while not self._answers.empty():
            self._answers.get_nowait()  # of a request that was given up
        self._post(message)
        try:
            answer = self._answers.get(timeout=_ANSWER)
        except queue.Empty:
            cause = "it refused the keys" if self._handshake_failed else f"none has answered within {_ANSWER:g} s"
            raise RobotLinkError(f"no robot at {self.address}: {cause}") from None
        if isinstance(answer, Refusal):
            raise RobotLinkError(f"the robot at {self.address} refuses ({answer.code}): {answer.text}")
        return answer

    def _post(self, message: FromClient) -> None:
        self._wake_out.send(self._codec.encode(message), copy=True)

    def _wait_for_clock(self) -> None:
        end = time.monotonic() + _ANSWER
        while not self.offset.known:
            if time.monotonic() > end:
                raise RobotLinkError(f"the robot at {self.address} does not say what time it is")
            time.sleep(0.005)

    # The link's own thread

    def _run(self) -> None:
        codec, poller = Codec(), zmq.Poller()
        for each in (self._socket, self._wake_in, self._monitor):
            poller.register(each, zmq.POLLIN)
        pings, next_ping = 0, 0.0
        while not self._ended.is_set() or self._wake_in.poll(0):
            ready = dict(poller.poll(20))
            if self._wake_in in ready:
                self._send(self._wake_in.recv(copy=True))
            if self._socket in ready:
                self._take(codec, self._socket.recv(copy=True), time.monotonic_ns())
            if self._monitor in ready and recv_monitor_message(self._monitor)["event"] in _FAILED:
                self._handshake_failed = True
            if (now := time.monotonic()) >= next_ping:
                pings += 1
                next_ping = now + (_PING if pings > _FIRST_PINGS else 0.005)
                self._send(codec.encode(Ping(time.monotonic_ns())))

    def _view(self, address: str, host: str, keys: Path | None) -> None:
        """Keep the newest pictures, in the thread of the pictures."""
        socket, codec = self._context.socket(zmq.SUB), Codec()
        _secure(socket, host, keys)
        socket.setsockopt(zmq.MAXMSGSIZE, MOST_PICTURE_BYTES)
        socket.setsockopt(zmq.RCVHWM, 2 * len(self.description.cameras))
        socket.subscribe(b"")
        socket.connect(address)
        while not self._ended.is_set():
            if socket.poll(100):
                try:
                    self.pictures.put(codec.picture(socket.recv(copy=True)))
                except ConfigurationError as error:
                    self.pictures.fail(str(error))
        socket.close(0)

    def _send(self, data: bytes) -> None:
        try:
            # A robot that refused the keys has no queue, and would block this thread.
            self._socket.send(data, zmq.NOBLOCK, copy=True)
        except zmq.Again:
            return

    def _take(self, codec: Codec, data: bytes, now: int) -> None:
        try:
            message = codec.from_robot(data)
        except ConfigurationError as error:
            self._answers.put(Refusal("message", str(error)))
            return
        if isinstance(message, Pong):
            # A clock beyond any could not be sent back in a stamp.
            if abs(message.clock) < _MOST_TIME:
                self.offset.add(message.sent, message.clock, now)
        elif isinstance(message, RobotState):
            self._keep(message, now)
        elif isinstance(message, Fault):
            if message.code not in PASSING:
                self._faults.append(message)
        else:
            if not isinstance(message, Refusal):
                self._keep(message.state, now)
            self._answers.put(message)

    def _keep(self, state: RobotState, now: int) -> None:
        self._state, self._arrived = state, now
        self._stamps.add(1e-9 * state.stamp, 1e-9 * now)
        # A state acknowledges all commands up to its own; only that one's time is a round trip.
        while self._sent and self._sent[0][0] <= state.command:
            number, sent = self._sent.popleft()
            if number == state.command:
                self.round_trips.add(1e-9 * (now - sent))


def _secure(socket: zmq.Socket[bytes], host: str, keys: Path | None) -> None:
    """Set up a connecting socket: its keys, and the version of its address."""
    socket.setsockopt(zmq.IPV6, ":" in host)
    if keys is not None:
        socket.curve_publickey, socket.curve_secretkey = key_pair(keys, CLIENT)
        socket.curve_serverkey = public_key(keys, ROBOT)
