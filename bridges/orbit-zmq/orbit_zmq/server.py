"""Server: a thread between a robot's loop and its one client, which answers questions for the clock at once."""

from __future__ import annotations

import itertools
import threading
from pathlib import Path

import zmq
import zmq.auth.thread

from orbit_core.interfaces import ConfigurationError, OrbitError
from orbit_deploy.computer import RobotBusyError, RobotComputer
from orbit_deploy.messages import VERSION, Arrangement, Fault, JointCommand, RobotState
from orbit_deploy.pictures import Picture
from orbit_zmq.keys import CLIENT, ROBOT, check_keys, key_pair, public_key, split_address
from orbit_zmq.wire import MOST_BYTES, Answer, Codec, FromClient, Hello, MoveTo, Offer, Order, Ping, Pong, Refusal

_numbers = itertools.count()
# States that wait for a slow client before older ones are dropped
_MOST_WAITING = 20
_LOOK_MS = 200


class ZmqServer:
    """Serves one robot's computer at one port.

    Args:
        computer: of the robot; its loop runs in another thread.
        address: ``zmq://host:port``; port 0 takes any that is free.
        keys: folder with ``robot.key_secret`` and ``client.key``; needed beyond this machine.

    Raises:
        ConfigurationError: the address is taken, is none, or is reached from elsewhere and there are no keys.
    """

    def __init__(self, computer: RobotComputer, address: str, keys: Path | None = None) -> None:
        host, port = split_address(address)
        check_keys(host, keys)
        self._computer, self._codec = computer, Codec()
        self._context = zmq.Context()
        self._authenticator = self._require_keys(keys) if keys is not None else None
        self._socket = self._context.socket(zmq.ROUTER)
        self._socket.setsockopt(zmq.MAXMSGSIZE, MOST_BYTES)
        self._socket.setsockopt(zmq.SNDHWM, _MOST_WAITING)
        _secure(self._socket, host, keys)
        shown = f"[{host}]" if ":" in host else host
        # A name is resolved by connect only.
        bound = "127.0.0.1" if host == "localhost" else shown
        try:
            self._socket.bind(f"tcp://{bound}:{port or '*'}")
        except zmq.ZMQError as error:
            self._free()
            raise ConfigurationError(f"cannot listen at {host}:{port}: {error}") from None
        self.address = f"zmq://{shown}:{_port(self._socket)}"
        self._picture_codec, self._pictures_port = Codec(), 0
        self._pictures: zmq.Socket[bytes] | None = None
        if computer.description.cameras:
            self._publish_pictures(bound, port + 1 if port else 0, keys)
        # The loop wakes this thread by a message, as a queue cannot be polled with a socket.
        inside = f"inproc://robot-{next(_numbers)}"
        self._wake_in, self._wake_out = self._context.socket(zmq.PAIR), self._context.socket(zmq.PAIR)
        self._wake_in.bind(inside)
        self._wake_out.connect(inside)
        self._wake_out.setsockopt(zmq.SNDHWM, _MOST_WAITING)
        self._peer = b""
        self._ended = threading.Event()
        computer.on_state.append(self._pass_on)
        computer.on_fault.append(self._pass_on)
        self._loop_codec = Codec()
        self._thread = threading.Thread(target=self._serve, name="zmq server", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop serving; idempotent."""
        if self._ended.is_set():
            return
        self._ended.set()
        self._thread.join(2.0)
        self._computer.on_state.remove(self._pass_on)
        self._computer.on_fault.remove(self._pass_on)
        if self._pictures is not None:
            self._computer.on_picture.remove(self._show)
        self._free()

    def _free(self) -> None:
        if self._authenticator is not None:
            self._authenticator.stop()
        self._context.destroy(linger=100)

    def _publish_pictures(self, host: str, port: int, keys: Path | None) -> None:
        """Open the cameras' own socket: a large picture on that of the states would delay them."""
        socket = self._pictures = self._context.socket(zmq.PUB)
        # Of a slow client's pictures, the oldest are sent and newer ones dropped: few may wait.
        socket.setsockopt(zmq.SNDHWM, 2 * len(self._computer.description.cameras))
        _secure(socket, host, keys)
        try:
            socket.bind(f"tcp://{host}:{port or '*'}")
        except zmq.ZMQError as error:
            self._free()
            raise ConfigurationError(
                f"cannot listen at {host}:{port} for pictures, which have the port after the robot's: {error}"
            ) from None
        self._pictures_port = _port(socket)
        self._computer.on_picture.append(self._show)

    def _require_keys(self, keys: Path) -> zmq.auth.thread.ThreadAuthenticator:
        """Accept only clients with the folder's key."""
        accepted = public_key(keys, CLIENT)

        class Provider:
            def callback(self, domain: str, key: bytes) -> bool:
                return key == accepted

        # In another thread: a handshake must not hold up the commands of a client that is there.
        authenticator = zmq.auth.thread.ThreadAuthenticator(self._context)
        authenticator.start()
        authenticator.configure_curve_callback(domain="*", credentials_provider=Provider())
        return authenticator

    # The cameras' thread, the only one to use their socket

    def _show(self, picture: Picture) -> None:
        assert self._pictures is not None  # listened to with the socket only
        try:
            self._pictures.send(self._picture_codec.encode(picture), zmq.NOBLOCK, copy=False)
        except zmq.ZMQError:
            return

    # The loop's thread

    def _pass_on(self, message: RobotState | Fault) -> None:
        """Hand a message to the server's thread; dropped where that thread is behind."""
        if not self._peer:
            return
        try:
            self._wake_out.send(self._loop_codec.encode(message), zmq.NOBLOCK, copy=True)
        except zmq.ZMQError:
            return

    # The server's thread

    def _serve(self) -> None:
        poller = zmq.Poller()
        poller.register(self._socket, zmq.POLLIN)
        poller.register(self._wake_in, zmq.POLLIN)
        while not self._ended.is_set():
            ready = dict(poller.poll(_LOOK_MS))
            if self._socket in ready:
                self._receive()
            if self._wake_in in ready:
                data = self._wake_in.recv(copy=True)
                if self._peer:
                    self._send(self._peer, data)
            if self._peer and not self._computer.client:
                self._peer = b""  # the session has timed out

    def _receive(self) -> None:
        parts = self._socket.recv_multipart()
        if len(parts) != 2:
            return
        peer, data = parts
        try:
            message = self._codec.from_client(data)
        except ConfigurationError as error:
            self._refuse(peer, "message", str(error))
            return
        # Anybody may ask for the clock; only the client's questions keep the session.
        if isinstance(message, Ping):
            if peer == self._peer:
                self._computer.heard()
            self._send(peer, self._codec.encode(Pong(message.sent, self._computer.clock.now())))
        elif isinstance(message, Hello):
            self._greet(peer, message)
        elif peer != self._peer:
            self._refuse(peer, "busy", "there is no session: connect first")
        else:
            self._obey(peer, message)

    def _greet(self, peer: bytes, hello: Hello) -> None:
        if hello.version != VERSION:
            self._refuse(
                peer, "version", f"the robot speaks version {VERSION} of the messages, and the client {hello.version}"
            )
            return
        if self._peer and peer != self._peer:
            self._refuse(
                peer, "busy", f"client {self._computer.client} commands the robot: stop it, then connect again"
            )
            return
        try:
            # Others see the name in their terminals.
            name = "".join(letter if letter.isprintable() else "?" for letter in hello.client[:80])
            state = self._computer.open(name, hello.period, hello.path)
        except RobotBusyError as error:
            self._refuse(peer, "busy", str(error))
        except OrbitError as error:
            self._refuse(peer, "request", str(error))
        else:
            self._peer = peer
            self._send(peer, self._codec.encode(Offer(self._computer.description, state, self._pictures_port)))

    def _obey(self, peer: bytes, message: FromClient) -> None:
        computer = self._computer
        try:
            if isinstance(message, JointCommand):
                computer.submit(message)
                return
            computer.heard()
            if isinstance(message, MoveTo):
                state = computer.move_to(message.positions)
            elif isinstance(message, Arrangement):
                state = computer.arrange(message)
            elif isinstance(message, Order) and message.word == "clear":
                state = computer.clear()
            elif isinstance(message, Order) and message.word == "stop":
                computer.stop()
                return
            elif isinstance(message, Order) and message.word == "leave":
                computer.leave(computer.client)
                self._peer = b""
                return
            else:
                raise ConfigurationError("a request was not understood")
        except OrbitError as error:
            self._refuse(peer, "request", str(error))
            return
        self._send(peer, self._codec.encode(Answer(state)))

    def _refuse(self, peer: bytes, code: str, text: str) -> None:
        self._send(peer, self._codec.encode(Refusal(code, text)))

    def _send(self, peer: bytes, data: bytes) -> None:
        try:
            self._socket.send_multipart((peer, data), zmq.NOBLOCK)
        except zmq.ZMQError:
            return  # a client that has gone, or reads too slowly


def _port(socket: zmq.Socket[bytes]) -> int:
    return int(socket.getsockopt_string(zmq.LAST_ENDPOINT).rpartition(":")[2])


def _secure(socket: zmq.Socket[bytes], host: str, keys: Path | None) -> None:
    """Set up a listening socket: its keys, and whom it may wait for at the end."""
    socket.setsockopt(zmq.LINGER, 100)
    socket.setsockopt(zmq.IPV6, ":" in host)
    if keys is not None:
        socket.curve_publickey, socket.curve_secretkey = key_pair(keys, ROBOT)
        # Without this a socket with keys would accept anybody's.
        socket.curve_server = True
