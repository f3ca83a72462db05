"""A policy of ours as a server that speaks OpenPI's protocol."""

from __future__ import annotations

import http
import logging
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError
from orbit_learn.memory import Remembering
from orbit_learn.policy import Policy
from orbit_learn.remote.client import BEGIN
from orbit_learn.remote.wire import MOST_BYTES, decode, encode

if TYPE_CHECKING:
    from websockets.sync.server import Server, ServerConnection

# A term may be sent under its name, or behind one of these.
_PREFIXES = ("", "observation/", "policy/")


class PolicyService:
    """Answers observations with actions, each connection with its own memory.

    Args:
        policy: that acts.
    """

    def __init__(self, policy: Policy) -> None:
        self._policy = policy
        description = policy.description
        self.metadata = {"orbit": description.document(), "action_horizon": 1}
        """What a client is told when it connects."""

    def handle(self, connection: ServerConnection) -> None:
        """Serve one client until it closes the connection.

        A client that sends something else gets one line with the reason, and the connection is closed.
        """
        from websockets.exceptions import ConnectionClosed

        acting = Remembering(self._policy.module, 1, "cpu")
        connection.send(encode(self.metadata))
        begun = True
        try:
            while True:
                message = connection.recv()
                begin = time.perf_counter()
                try:
                    if isinstance(message, str):
                        raise ConfigurationError("it is text, not MessagePack")
                    request = decode(message)
                    observation = self.observation(request)
                    begun = begun or request.get(BEGIN) is True
                    action = acting.act(observation, torch.tensor([begun]))
                    begun = False
                except ConfigurationError as error:
                    connection.send(f"the request was not understood: {error}")
                    connection.close(1011, "bad request")
                    return
                spent = 1e3 * (time.perf_counter() - begin)
                connection.send(encode({"actions": action.numpy(), "server_timing": {"infer_ms": spent}}))
        except ConnectionClosed:
            return

    def observation(self, request: Mapping[str, Any]) -> Tensor | dict[str, Tensor]:
        """Return the observation (1, ...) of a request.

        Raises:
            ConfigurationError: a term is missing or of another shape; names it.
        """
        description = self._policy.description
        terms: dict[str, Tensor] = {}
        for part in description.observation_parts:
            value = next((request[prefix + part.name] for prefix in _PREFIXES if prefix + part.name in request), None)
            if not isinstance(value, np.ndarray):
                raise ConfigurationError(f"it lacks 'observation/{part.name}', {part}")
            if value.shape != part.shape:
                raise ConfigurationError(f"'observation/{part.name}' has shape {value.shape}, not {part.shape}")
            if (part.dtype == "uint8") != (value.dtype == np.uint8):
                raise ConfigurationError(f"'observation/{part.name}' is of {value.dtype}, not {part.dtype}")
            terms[part.name] = torch.from_numpy(value.copy())[None].to(part.zeros(1, "cpu").dtype)
        if description.concatenated:
            return torch.cat([value.flatten(1) for value in terms.values()], 1)
        return terms

    def listen(self, host: str, port: int) -> Server:
        """Return a server that listens; ``serve_forever()`` answers until ``shutdown()``.

        Raises:
            ConfigurationError: the port is taken or is none, or the library is not installed.
        """
        try:
            from websockets.http11 import Request, Response
            from websockets.sync.server import serve
        except ImportError as error:
            raise ConfigurationError(f"policy servers need {error.name}: {install_extra('remote')}") from None

        def health(connection: ServerConnection, request: Request) -> Response | None:
            if request.path == "/healthz":
                return connection.respond(http.HTTPStatus.OK, "OK\n")
            return None

        # Its log has a traceback for every scanner of ports that comes by.
        logger = logging.getLogger("orbit_learn.remote")
        logger.setLevel(logging.CRITICAL)
        try:
            return serve(
                self.handle, host, port, compression=None, max_size=MOST_BYTES, process_request=health, logger=logger
            )
        except (OSError, OverflowError) as error:
            raise ConfigurationError(f"cannot listen at {host}:{port}: {error}") from None
