"""Virtual environments of the peers, made by venv and pip."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from peers import Peer

from orbit_core.interfaces.errors import ConfigurationError

_STAMP = "requirements.txt"


def python_of(peer: Peer, folder: Path) -> Path:
    """Return the interpreter of a peer's environment, which is made where it is not there or of other versions.

    Args:
        peer: whose packages are installed; one without packages runs in this environment.
        folder: of the environments of all peers.

    Raises:
        ConfigurationError: the packages could not be installed.
    """
    if not peer.packages:
        return Path(sys.executable)
    environment = folder.absolute() / peer.name
    python, stamp = environment / "bin" / "python", environment / _STAMP
    wanted = "".join(f"{package}\n" for package in peer.packages)
    if stamp.exists() and stamp.read_text() == wanted:
        return python
    print(f"making the environment of {peer.title} in {environment}", flush=True)
    shutil.rmtree(environment, ignore_errors=True)
    subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True)
    command = [str(python), "-m", "pip", "install", "-q", "--no-cache-dir", *peer.packages]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        last = (done.stderr or done.stdout).strip().splitlines()[-1:]
        raise ConfigurationError(f"pip could not install {', '.join(peer.packages)}: {' '.join(last)}")
    # Last, because an environment without it is made again.
    stamp.write_text(wanted)
    return python
