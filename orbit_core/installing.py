"""Commands that install what is missing or out of date, from a checkout or from a package index."""

from __future__ import annotations

import functools
import json
import re
import shlex
from pathlib import Path
from typing import Protocol
from urllib.parse import unquote, urlparse

import importlib_metadata


class InstalledDistribution(Protocol):
    """Metadata of an installed distribution, of whichever finder of Python's supplies it."""

    @property
    def version(self) -> str:
        """Version of the distribution."""
        ...

    @property
    def requires(self) -> list[str] | None:
        """Requirements, as its metadata state them."""
        ...

    def read_text(self, filename: str, /) -> str | None:
        """Return a file of the metadata; None if there is none of that name."""
        ...

    def locate_file(self, path: str, /) -> object:
        """Return the path of one of the distribution's files."""
        ...


def install_command(distribution: str) -> str:
    """Return the command that installs one of ORBIT's distributions, from an index or from the checkout in use."""
    folder = _checkout_folder(distribution)
    return f"pip install {distribution}" if folder is None else _in_checkout(_editable(folder))


def upgrade_command(distribution: str, specifier: str = "") -> str:
    """Return the command that replaces an installed distribution by a later version.

    Args:
        distribution: its name.
        specifier: accepted versions, such as ``"~=0.2.0"``; empty accepts all.
    """
    if _checkout_folder(distribution) is not None:
        return install_command(distribution)
    try:
        folder = editable_folder(importlib_metadata.distribution(distribution))
    except importlib_metadata.PackageNotFoundError:
        folder = None
    if folder is not None:
        return f"update the source in {folder}, then pip install -e {folder}"
    return f"pip install --upgrade {distribution}" if not specifier else f'pip install "{distribution}{specifier}"'


def install_extra(extra: str) -> str:
    """Return the command that installs an extra of orbit-core, from an index or from the checkout in use."""
    if checkout() is None:
        return f'pip install "orbit-core[{extra}]"'
    plugin = _checkout_folder(f"orbit-{extra}")
    own = "" if plugin is None else _editable(plugin)
    return _in_checkout(f'{own} -e ".[{extra}]"')


def editable_folder(distribution: InstalledDistribution) -> Path | None:
    """Return the source folder of a distribution that is installed in editable mode; None for an installed wheel."""
    text = distribution.read_text("direct_url.json")
    url = json.loads(text) if text else {}
    if not url.get("dir_info", {}).get("editable"):
        return None
    return Path(unquote(urlparse(url.get("url", "")).path)).resolve()


@functools.cache
def checkout() -> Path | None:
    """Return the root of the checkout that orbit-core is installed from; None for an installed wheel."""
    try:
        root = editable_folder(importlib_metadata.distribution("orbit-core"))
    except importlib_metadata.PackageNotFoundError:
        return None
    return root if root is not None and (root / "checkout.txt").is_file() else None


def _in_checkout(options: str) -> str:
    """Return the command that installs a checkout with further options, from any folder."""
    root = checkout()
    change = "" if root is None or Path.cwd() == root else f"cd {shlex.quote(str(root))} && "
    return f"{change}pip install -r checkout.txt{options}"


def _editable(folder: Path) -> str:
    """Return the options that install a plugin of the checkout, after those that it is built on; empty for others."""
    root = checkout()
    if root is None or folder.parent.name != "plugins":
        return ""
    needed = re.findall(
        r'"(orbit-[a-z]+)', (folder / "pyproject.toml").read_text(encoding="utf-8").split("[project.e")[0]
    )
    below = [root / "plugins" / name for name in dict.fromkeys(needed) if (root / "plugins" / name).is_dir()]
    return "".join(f" -e plugins/{each.name}" for each in [*(each for each in below if each != folder), folder])


def _checkout_folder(distribution: str) -> Path | None:
    """Return the folder of a distribution in the checkout that ORBIT runs from; None without a checkout."""
    root = checkout()
    if root is None:
        return None
    special = {"orbit-core": root, "orbit-tasks": root / "orbit_tasks", "orbit-conformance": root / "tests/conformance"}
    folders = (special.get(distribution, root / kind / distribution) for kind in ("packages", "plugins"))
    return next((folder for folder in folders if (folder / "pyproject.toml").is_file()), None)
