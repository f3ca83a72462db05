"""PhysX's GPU library: where it must be, and ``python -m orbit_sapien.physx_gpu install``, which puts it there.

SAPIEN's package has no such library, and would download it unasked. Here nothing is downloaded but by that command,
which prints what it does and installs only an archive of the given SHA-256.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import platform
import shutil
import sys
import urllib.error
import urllib.request
import zipfile
from collections.abc import Sequence
from pathlib import Path

from orbit_core.interfaces import ConfigurationError, OrbitError
from orbit_core.plugin_kit.scratch import ScratchFolder
from orbit_sapien.native import physx

_LIBRARY = "libPhysXGpu_64.so"
_RELEASES = "https://github.com/sapien-sim/physx-precompiled/releases/download"
_ARCHIVES = {"x86_64": "linux-so.zip", "aarch64": "linux-aarch64-so.zip"}
_COMMAND = "python -m orbit_sapien.physx_gpu install"


def library_path() -> Path:
    """The path at which SAPIEN looks for the library of the PhysX that it was built with."""
    return Path.home() / ".sapien" / "physx" / physx.version() / _LIBRARY


def archive_url() -> str:
    """The address at which SAPIEN's makers publish the library.

    Raises:
        ConfigurationError: not for this kind of machine.
    """
    archive = _ARCHIVES.get(platform.machine())
    if archive is None or platform.system() != "Linux":
        raise ConfigurationError(
            f"GPU PhysX is published for Linux on {' and '.join(_ARCHIVES)}, not for {platform.system()} on "
            f"{platform.machine()}: use device 'cpu'"
        )
    return f"{_RELEASES}/{physx.version()}/{archive}"


def enable() -> None:
    """Load the library, before any other PhysX object is made. Never downloads.

    Raises:
        ConfigurationError: it is not on this machine, or does not load; says what to do.
    """
    if physx.is_gpu_enabled():
        return
    path = library_path()
    if not path.is_file():
        raise ConfigurationError(
            f"backend 'sapien' needs PhysX's GPU library for a CUDA device, and '{path}' does not exist: install it "
            f"with {_COMMAND}, or use device 'cpu'"
        )
    try:
        physx.enable_gpu()
    except (OSError, RuntimeError) as error:
        raise ConfigurationError(
            f"PhysX's GPU library '{path}' does not load ({error}): install NVIDIA's driver, or use device 'cpu'"
        ) from error


def install(url: str, sha256: str | None) -> Path:
    """Download the archive, verify it, and put its library where SAPIEN looks.

    Args:
        url: of a zip archive with the library in it.
        sha256: of the archive, in hexadecimal; None downloads, prints the checksum and installs nothing.

    Raises:
        ConfigurationError: no checksum was given, or it is another; the download fails, or holds no library.
    """
    target = library_path()
    print(f"downloading {url}")
    with ScratchFolder("orbit-physx-") as folder:
        archive = folder / "physx.zip"
        found = _download(url, archive)
        print(f"its SHA-256 is {found}")
        if sha256 is None:
            raise ConfigurationError(
                "nothing was installed, for no checksum was given to hold it against: compare that above with the one "
                f"of a source that you trust, then run {_COMMAND} --sha256 CHECKSUM"
            )
        if found != sha256.lower():
            raise ConfigurationError(f"the archive's SHA-256 is {found}, not {sha256.lower()}: nothing was installed")
        _extract(archive, target)
    print(f"installed {target}")
    return target


def _download(url: str, archive: Path) -> str:
    """The SHA-256 of what is written to ``archive``."""
    try:
        with urllib.request.urlopen(url, timeout=60) as response, archive.open("wb") as file:
            shutil.copyfileobj(response, file)
    except (OSError, urllib.error.URLError, ValueError) as error:
        raise ConfigurationError(
            f"{url} cannot be downloaded ({error}): fetch it on another machine, and give its place with --url"
        ) from error
    with archive.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _extract(archive: Path, target: Path) -> None:
    """The library alone, whole or not at all."""
    try:
        with zipfile.ZipFile(archive) as members:
            name = next((name for name in members.namelist() if Path(name).name == _LIBRARY), None)
            if name is None:
                raise ConfigurationError(f"the archive holds no {_LIBRARY}: nothing was installed")
            target.parent.mkdir(parents=True, exist_ok=True)
            partial = target.with_suffix(".partial")
            with members.open(name) as source, partial.open("wb") as file:
                shutil.copyfileobj(source, file)
    except zipfile.BadZipFile as error:
        raise ConfigurationError(f"what was downloaded is no zip archive ({error}): nothing was installed") from error
    os.replace(partial, target)


def main(words: Sequence[str] | None = None) -> int:
    """Run the command; return 2 for a fault that the user can fix."""
    parser = argparse.ArgumentParser(prog="python -m orbit_sapien.physx_gpu", description=__doc__)
    parser.add_argument("command", choices=("install", "where"), help="download the library, or say where it belongs")
    parser.add_argument("--sha256", help="of the archive; without it nothing is installed")
    parser.add_argument("--url", help="of the archive, where it is not that of SAPIEN's makers; file:// will do")
    options = parser.parse_args(words)
    try:
        if options.command == "where":
            there = "is there" if library_path().is_file() else "does not exist"
            print(f"{library_path()} {there}; published as {archive_url()}")
        else:
            install(options.url or archive_url(), options.sha256)
    except OrbitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
