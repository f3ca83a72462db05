"""``orbit serve``: a learned policy for clients of OpenPI's protocol."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from tyro.conf import Positional, arg

from orbit_core.cli.output import console
from orbit_core.cli.settings import parse_words
from orbit_core.interfaces.errors import ConfigurationError
from orbit_learn.pretrained import policy_path

_LOCAL = ("127.0.0.1", "localhost", "::1")


@dataclass(frozen=True, kw_only=True)
class ServeSettings:
    """Serve a learned policy by OpenPI's protocol (WebSocket, MessagePack), for 'orbit run --agent ws://...' and
    others."""  # fmt: skip

    policy: Annotated[Positional[str], arg(metavar="POLICY")]
    """A policy's file, a training's folder, or a kept policy's name ('orbit list policies')."""
    host: str = "127.0.0.1"
    """Address to listen at."""
    port: int = 8000
    """Port to listen at; 0 for any that is free."""
    public: bool = False
    """Listen at an address that other machines reach: the protocol knows no keys, whoever reaches it is served."""


def main(words: Sequence[str]) -> None:
    """Serve until Ctrl-C."""
    from orbit_learn.policy import load_policy
    from orbit_learn.remote.server import PolicyService

    settings = parse_words(ServeSettings, words, "orbit serve")
    if settings.host not in _LOCAL and not settings.public:
        raise ConfigurationError(
            f"{settings.host} may be reached from other machines, and the protocol knows no keys: add --public, or "
            "listen at 127.0.0.1"
        )
    service = PolicyService(load_policy(policy_path(settings.policy)))
    with service.listen(settings.host, settings.port) as server:
        port = server.socket.getsockname()[1]
        console().print(f"serving {settings.policy} at ws://{settings.host}:{port} (Ctrl-C ends)", soft_wrap=True)
        server.serve_forever()
