"""A policy server as an agent: ``orbit run Lift --agent ws://127.0.0.1:8000`` speaks OpenPI's protocol.

The server sees ``observation/<term>`` for each term of the group ``policy`` and ``prompt``; a query renames them:
``ws://host:8000/?observation/image=front&observation/state=joint_positions+goal`` sends what the server was trained
with, terms joined by ``+`` side by side. ``timeout`` is in seconds.
"""

from __future__ import annotations

import socket
import struct
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qsl, urlsplit, urlunsplit

import numpy as np
import torch
from torch import Tensor

from orbit_core.envs.observation_layout import POLICY
from orbit_core.envs.task import instruction_of
from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_learn.remote.wire import MOST_BYTES, decode, encode

if TYPE_CHECKING:
    from collections.abc import Mapping

    from orbit_core.envs.environment import Environment

BEGIN = "orbit/begin"
"""Key that tells a server of ours that an episode begins; others do not get it."""
_TIMEOUT = 30.0
# Seconds to wait for a server whose time is over, in which an answer that has arrived is read.
_LEAST_WAIT = 0.01
# Seconds to wait for the other side when a connection is closed; a server that hangs costs them for each environment.
_CLOSING = 0.1
_TOLD = "observation/"


class ServerFailure(ConfigurationError):
    """A policy server that hangs, closes, or answers what is no action."""


@dataclass(frozen=True)
class ServerAddress:
    """Address of a policy server, and observations that it is sent."""

    url: str
    """Without the query."""
    keys: tuple[tuple[str, tuple[str, ...]], ...] = ()
    """Key of each input, and the terms that are sent under it; all under their names if empty."""
    prompt: str | None = None
    """Task in words; the task's own if None."""
    timeout: float = _TIMEOUT
    """Seconds in which a server answers."""

    @staticmethod
    def parse(text: str) -> ServerAddress:
        """Read an address with its query.

        Raises:
            ConfigurationError: it is no address, or the timeout is no positive number.
        """
        parts = urlsplit(text)
        if not parts.hostname:
            raise ConfigurationError(f"'{text}' names no policy server: give ws://host:port")
        given = dict(parse_qsl(parts.query, keep_blank_values=True))
        prompt, timeout = given.pop("prompt", None), given.pop("timeout", str(_TIMEOUT))
        try:
            seconds = float(timeout)
        except ValueError:
            seconds = -1.0
        if not 0.0 < seconds < 1e6:
            raise ConfigurationError(f"timeout of '{text}' is a number of seconds above zero, not {timeout!r}")
        # A plus sign in a query is a blank once it is read.
        keys = tuple((key, tuple(value.replace("+", " ").split())) for key, value in given.items())
        return ServerAddress(urlunsplit((parts.scheme, parts.netloc, parts.path, "", "")), keys, prompt, seconds)


class PolicyServer:
    """A connection to a policy server.

    Args:
        address: where it listens.
        within: seconds in which it answers; those of the address if None.

    Raises:
        ServerFailure: nobody listens there, or it does not speak the protocol.
    """

    def __init__(self, address: ServerAddress, within: float | None = None) -> None:
        within = address.timeout if within is None else within
        try:
            from websockets.exceptions import WebSocketException
            from websockets.sync.client import connect
        except ImportError as error:
            raise ConfigurationError(f"policy servers need {error.name}: {install_extra('remote')}") from None
        self._address = address
        self._failures = (OSError, WebSocketException, EOFError)
        try:
            # Pictures hardly get smaller by compression, and the wait for it is longer than the way on loopback.
            # Without pings: a server that computes for longer than their 40 s would lose the connection, whatever its
            # timeout, since most answer none meanwhile.
            self._socket = connect(
                address.url, compression=None, max_size=MOST_BYTES, open_timeout=within, close_timeout=_CLOSING,
                ping_interval=None,
            )  # fmt: skip
            # A server that reads nothing would hold a large observation up for ever.
            seconds = struct.pack("ll", int(address.timeout), int(address.timeout % 1 * 1e6))
            self._socket.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, seconds)
        except self._failures as error:
            raise ServerFailure(f"no policy server answers at {address.url}: {_first_line(error)}") from None
        self.metadata = self._receive(within)
        """What the server told of itself."""

    def ask(self, observation: Mapping[str, Any]) -> None:
        """Send an observation, whose :meth:`answer` is due then.

        Raises:
            ServerFailure: the server has closed the connection.
        """
        try:
            self._socket.send(encode(dict(observation)))
        except self._failures as error:
            raise ServerFailure(f"{self._address.url} closed the connection: {_first_line(error)}") from None

    def answer(self, within: float | None = None) -> np.ndarray:
        """Return actions (H, A) for the observation that was sent.

        Args:
            within: seconds to wait; those of the address if None.

        Raises:
            ServerFailure: the server hangs, closes or answers something else; the connection is of no more use then.
        """
        actions = self._receive(self._address.timeout if within is None else within).get("actions")
        if not (isinstance(actions, np.ndarray) and actions.ndim == 2 and len(actions) and actions.dtype.kind == "f"):
            raise ServerFailure(f"{self._address.url} answered without 'actions' (horizon, A) of floating point")
        return actions

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def _receive(self, within: float) -> dict[str, Any]:
        try:
            message = self._socket.recv(timeout=within)
        except TimeoutError:
            raise ServerFailure(f"{self._address.url} has not answered for {self._address.timeout:g} s") from None
        except self._failures as error:
            raise ServerFailure(f"{self._address.url} closed the connection: {_first_line(error)}") from None
        if isinstance(message, str):
            # OpenPI sends the traceback of its error as text.
            # The last line of a traceback names the error.
            last = (message.strip().splitlines() or ["no reason"])[-1]
            raise ServerFailure(f"{self._address.url} reports an error: {last[:200]}")
        try:
            return decode(message)
        except ConfigurationError as error:
            raise ServerFailure(f"{self._address.url} sent a message that is none: {error}") from None


class RemoteActor:
    """Acts in all environments by what a policy server answers, one request for each plan of an environment.

    All requests of a step are sent before the first answer is awaited, and the time in which a server answers counts
    from its last answer to any environment: a slow model may work through all, and one that hangs costs this time once
    a step, whatever the number of environments.

    An environment whose server fails holds still until its episode ends, and is counted in :attr:`failed`; the others
    go on, and the next episode asks again.

    Args:
        environment: that it acts in.
        address: of the server, with what it is sent.

    Raises:
        ServerFailure: nobody listens there.
        UnknownNameError: a term that is to be sent is none of the environment's group ``policy``.
    """

    def __init__(self, environment: Environment, address: ServerAddress) -> None:
        self._environment, self._address = environment, address
        self._layout = environment.observation[POLICY]
        terms = tuple(self._layout.terms)
        for _, names in address.keys:
            for name in names:
                if name not in terms:
                    raise UnknownNameError("observation term", name, terms, f"server {address.url}")
        self._keys = address.keys or tuple((f"{_TOLD}{name}", (name,)) for name in terms)
        self._prompt = instruction_of(environment.task, type(environment.task).__name__, address.prompt)
        count, size = environment.num_envs, environment.action_size
        # One connection now, so that a wrong address is an error at once; the others are opened when they are needed.
        self._servers: list[PolicyServer | None] = [PolicyServer(address), *([None] * (count - 1))]
        first = self._servers[0]
        assert first is not None
        # Only a server of ours gets the additional key, because others may pass unknown keys on to their model.
        self._ours = "orbit" in first.metadata
        self._plans = [np.zeros((0, size), np.float32) for _ in range(count)]
        self.unanswered = [False] * count
        """Environments whose server failed in their present episode."""
        self._heard = time.monotonic()
        self.failed = 0
        """Episodes that ended without an answer."""
        self.failures: dict[str, int] = {}
        """What went wrong, and how often."""

    def act(self) -> Tensor:
        """(N, A) the next action."""
        begun = (self._environment.state.episode_step == 0).tolist()
        actions = np.zeros((len(begun), self._environment.action_size), np.float32)
        for i, begins in enumerate(begun):
            if begins:
                self._plans[i], self.unanswered[i] = self._plans[i][:0], False
        # Still until the episode ends: a query at each step would wait for the timeout at each step.
        due = [i for i, plan in enumerate(self._plans) if not len(plan) and not self.unanswered[i]]
        if due:
            # Copied from the device once for all environments, and only where a plan is used up.
            seen = self._terms()
            self._heard = time.monotonic()
            asked = [i for i in due if self._ask(i, seen, begun[i])]
            for i in asked:
                self._take(i)
        for i, plan in enumerate(self._plans):
            if len(plan):
                actions[i], self._plans[i] = plan[0], plan[1:]
        return torch.from_numpy(actions).to(self._environment.device)

    def close(self) -> None:
        """Close all connections."""
        for server in self._servers:
            if server is not None:
                server.close()

    def _terms(self) -> dict[str, np.ndarray]:
        """Return the terms (N, ...) of the policy's group on the CPU."""
        value = self._environment.observe()[POLICY]
        if isinstance(value, Tensor):
            whole = value.cpu().numpy()
            return {name: whole[:, columns] for name, columns in self._layout.columns.items()}
        return {name: each.cpu().numpy() for name, each in value.items()}

    def _ask(self, index: int, terms: dict[str, np.ndarray], begins: bool) -> bool:
        """Request a plan for an environment; return False if the server fails."""
        message: dict[str, Any] = {"prompt": self._prompt}
        for key, names in self._keys:
            values = [terms[name][index] for name in names]
            message[key] = values[0] if len(values) == 1 else np.concatenate([each.ravel() for each in values])
        if self._ours and begins:
            message[BEGIN] = True
        try:
            server = self._servers[index]
            if server is None:
                server = self._servers[index] = PolicyServer(self._address, self._left())
                self._heard = time.monotonic()
            server.ask(message)
        except ServerFailure as failure:
            self._give_up(index, failure)
            return False
        return True

    def _take(self, index: int) -> None:
        """Receive the plan (H, A) of an environment."""
        server = self._servers[index]
        assert server is not None
        try:
            plan = server.answer(self._left())
            if plan.shape[1] != self._environment.action_size:
                raise ServerFailure(
                    f"{self._address.url} answered actions of {plan.shape[1]} components, and the task has "
                    f"{self._environment.action_size}"
                )
        except ServerFailure as failure:
            self._give_up(index, failure)
            return
        self._heard = time.monotonic()
        # A model may overshoot the range a little, which is no reason to end an episode.
        self._plans[index] = plan.astype(np.float32).clip(-1.0, 1.0)

    def _left(self) -> float:
        """Return the seconds that the server has left to answer; an answer that is there already is still read."""
        return max(self._heard + self._address.timeout - time.monotonic(), _LEAST_WAIT)

    def _give_up(self, index: int, failure: ServerFailure) -> None:
        """Close an environment's connection and count its episode as failed."""
        if (broken := self._servers[index]) is not None:
            broken.close()
        self._servers[index], self.unanswered[index] = None, True
        self.failed += 1
        self.failures[str(failure)] = self.failures.get(str(failure), 0) + 1


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
