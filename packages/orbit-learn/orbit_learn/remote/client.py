"""A policy server as an agent: ``orbit run Lift --agent ws://127.0.0.1:8000`` speaks OpenPI's protocol.

The server sees ``observation/<term>`` for each term of the group ``policy`` and ``prompt``; a query renames them:
``ws://host:8000/?observation/image=front&observation/state=joint_positions+goal`` sends what the server was trained
with, terms joined by ``+`` side by side. ``timeout`` is in seconds.
"""

from __future__ import annotations

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

    Raises:
        ServerFailure: nobody listens there, or it does not speak the protocol.
    """

    def __init__(self, address: ServerAddress) -> None:
        try:
            from websockets.exceptions import WebSocketException
            from websockets.sync.client import connect
        except ImportError as error:
            raise ConfigurationError(f"policy servers need {error.name}: {install_extra('remote')}") from None
        self._address = address
        self._failures = (OSError, WebSocketException, EOFError)
        try:
            # Pictures hardly get smaller by compression, and the wait for it is longer than the way on loopback.
            self._socket = connect(
                address.url, compression=None, max_size=MOST_BYTES, open_timeout=address.timeout, close_timeout=1.0
            )
        except self._failures as error:
            raise ServerFailure(f"no policy server answers at {address.url}: {_first_line(error)}") from None
        self.metadata = self._receive()
        """What the server told of itself."""

    def infer(self, observation: Mapping[str, Any]) -> np.ndarray:
        """Return actions (H, A) for an observation.

        Raises:
            ServerFailure: the server hangs, closes or answers something else; the connection is of no more use then.
        """
        try:
            self._socket.send(encode(dict(observation)))
        except self._failures as error:
            raise ServerFailure(f"{self._address.url} closed the connection: {_first_line(error)}") from None
        actions = self._receive().get("actions")
        if not (isinstance(actions, np.ndarray) and actions.ndim == 2 and len(actions) and actions.dtype.kind == "f"):
            raise ServerFailure(f"{self._address.url} answered without 'actions' (horizon, A) of floating point")
        return actions

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def _receive(self) -> dict[str, Any]:
        try:
            message = self._socket.recv(timeout=self._address.timeout)
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
        self.failed = 0
        """Episodes that ended without an answer."""
        self.failures: dict[str, int] = {}
        """What went wrong, and how often."""

    def act(self) -> Tensor:
        """(N, A) the next action."""
        begun = (self._environment.state.episode_step == 0).tolist()
        seen: dict[str, np.ndarray] | None = None
        actions = np.zeros((len(begun), self._environment.action_size), np.float32)
        for i, begins in enumerate(begun):
            if begins:
                self._plans[i], self.unanswered[i] = self._plans[i][:0], False
            # Still until the episode ends: a query at each step would wait for the timeout at each step.
            if self.unanswered[i]:
                continue
            if not len(self._plans[i]):
                # Copied from the device once for all environments, and only where a plan is used up.
                seen = self._terms() if seen is None else seen
                self._plans[i] = self._ask(i, seen, begins)
            if len(self._plans[i]):
                actions[i], self._plans[i] = self._plans[i][0], self._plans[i][1:]
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

    def _ask(self, index: int, terms: dict[str, np.ndarray], begins: bool) -> np.ndarray:
        """Return the plan (H, A) of an environment; empty where the server fails."""
        message: dict[str, Any] = {"prompt": self._prompt}
        for key, names in self._keys:
            values = [terms[name][index] for name in names]
            message[key] = values[0] if len(values) == 1 else np.concatenate([each.ravel() for each in values])
        if self._ours and begins:
            message[BEGIN] = True
        try:
            server = self._servers[index] or PolicyServer(self._address)
            self._servers[index] = server
            plan = server.infer(message)
            if plan.shape[1] != self._environment.action_size:
                raise ServerFailure(
                    f"{self._address.url} answered actions of {plan.shape[1]} components, and the task has "
                    f"{self._environment.action_size}"
                )
            # A model may overshoot the range a little, which is no reason to end an episode.
            return plan.astype(np.float32).clip(-1.0, 1.0)
        except ServerFailure as failure:
            if (broken := self._servers[index]) is not None:
                broken.close()
            self._servers[index], self.unanswered[index] = None, True
            self.failed += 1
            self.failures[str(failure)] = self.failures.get(str(failure), 0) + 1
            return np.zeros((0, self._environment.action_size), np.float32)


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
