"""CURVE keys: who may command a robot, and which robot a client trusts.

A folder holds ``robot.key`` and ``client.key``, public; ``robot.key_secret`` is copied to the robot's computer only and
``client.key_secret`` to the client only.
"""

from __future__ import annotations

from pathlib import Path
from urllib.parse import urlsplit

import zmq.auth

from orbit_core.files import storage_faults
from orbit_core.interfaces import ConfigurationError

ROBOT, CLIENT = "robot", "client"
_LOCAL = ("127.0.0.1", "localhost", "::1")


def make_keys(folder: Path) -> None:
    """Make keys of a robot and of a client.

    Raises:
        ConfigurationError: the folder holds keys already, which others may trust.
        StorageError: it cannot be written.
    """
    if any(folder.glob("*.key*")):
        raise ConfigurationError(f"folder {folder} holds keys already: give a new one")
    with storage_faults(folder):
        folder.mkdir(parents=True, exist_ok=True)
        folder.chmod(0o700)
        for name in (ROBOT, CLIENT):
            zmq.auth.create_certificates(folder, name)
            (folder / f"{name}.key_secret").chmod(0o600)


def public_key(folder: Path, name: str) -> bytes:
    """Return the public key, 40 characters.

    Raises:
        ConfigurationError: the folder lacks it.
    """
    return _load(folder / f"{name}.key")[0]


def key_pair(folder: Path, name: str) -> tuple[bytes, bytes]:
    """Return the public and the secret key.

    Raises:
        ConfigurationError: the folder lacks them.
    """
    public, secret = _load(folder / f"{name}.key_secret")
    if secret is None:
        raise ConfigurationError(f"{folder / name}.key_secret holds no secret key")
    return public, secret


def split_address(address: str) -> tuple[str, int]:
    """Return host and port of ``zmq://host:port``.

    Raises:
        ConfigurationError: it is no such address.
    """
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if urlsplit(address).scheme != "zmq" or not host or port is None:
        raise ConfigurationError(f"'{address}' is no address of a robot: give zmq://host:port")
    return host, port


def check_keys(host: str, keys: Path | None) -> None:
    """Refuse connections beyond this machine without keys.

    Raises:
        ConfigurationError: names the host and the remedy.
    """
    if keys is None and host not in _LOCAL:
        raise ConfigurationError(
            f"{host} is reached by other machines, and whoever reaches a robot moves it: make keys with "
            "'orbit robot --make-keys FOLDER' and give --keys FOLDER on both sides"
        )


def _load(path: Path) -> tuple[bytes, bytes | None]:
    try:
        return zmq.auth.load_certificate(path)
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"cannot read key {path}: {error}") from None
