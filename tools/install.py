"""Install into this interpreter's environment with uv, which takes a fifth of pip's time, as pip is set up to install.

    python tools/install.py ARGUMENTS      arguments of `pip install` that uv takes as well

Where pip takes packages from, and what it caps, is passed on to uv. Where uv cannot be had, or fails, pip installs.
"""

from __future__ import annotations

import ast
import importlib.util
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

PIP = (sys.executable, "-m", "pip", "install", "--quiet", "--no-compile")
UV = "uv==0.13.9"

_PASSED_ON = {
    "index-url": "UV_DEFAULT_INDEX",
    "extra-index-url": "UV_INDEX",
    "find-links": "UV_FIND_LINKS",
    "constraint": "UV_CONSTRAINT",
    "no-index": "UV_NO_INDEX",
    "trusted-host": "UV_INSECURE_HOST",
    "cert": "SSL_CERT_FILE",
    "default-timeout": "UV_HTTP_TIMEOUT",
    "timeout": "UV_HTTP_TIMEOUT",
    "proxy": "ALL_PROXY",
}
"""uv's variables by pip's options."""
_MANY_BY_COMMA = {"UV_FIND_LINKS"}
"""Variables whose values are separated by commas rather than by spaces."""


def settings_of_pip(listed: str) -> dict[str, str]:
    """Return uv's environment variables for what ``pip config list`` printed; pip's variables go before its files.

    Args:
        listed: lines such as ``global.extra-index-url='https://a https://b'`` and ``:env:.find-links='wheels'``.
    """
    of_section: dict[str, dict[str, str]] = {section: {} for section in ("global", "install", ":env:")}
    for line in listed.splitlines():
        key, _, value = line.partition("=")
        section, _, option = key.rpartition(".")
        variable = _PASSED_ON.get(option)
        if variable and section in of_section:
            words = str(ast.literal_eval(value)).split()
            of_section[section][variable] = ("," if variable in _MANY_BY_COMMA else " ").join(words)
    return of_section["global"] | of_section["install"] | of_section[":env:"]


def environment_for_uv(listed: str, environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment in which uv installs as pip would; what the caller set for uv stays."""
    own = {
        # As pip does: the best version that any index has, rather than that of the first that knows the name.
        "UV_INDEX_STRATEGY": "unsafe-best-match",
        "UV_PYTHON_DOWNLOADS": "never",
    }
    if cache := environment.get("PIP_CACHE_DIR"):
        own["UV_CACHE_DIR"] = str(Path(cache).with_name("uv"))
    return own | settings_of_pip(listed) | dict(environment) | {"VIRTUAL_ENV": sys.prefix}


def install(arguments: list[str]) -> int:
    """Install and return the exit code."""
    try:
        if importlib.util.find_spec("uv") is None:
            subprocess.run([*PIP, UV], check=True)
        listed = subprocess.run([*PIP[:3], "config", "list"], capture_output=True, text=True, check=True).stdout
        uv = [sys.executable, "-m", "uv", "pip", "install", "--quiet", *arguments]
        subprocess.run(uv, check=True, env=environment_for_uv(listed, os.environ))
    except subprocess.CalledProcessError as error:
        print(f"note: {' '.join(error.cmd[2:5])} failed with {error.returncode}; pip installs", file=sys.stderr)
        return subprocess.run([*PIP, *arguments], check=False).returncode
    return 0


if __name__ == "__main__":
    sys.exit(install(sys.argv[1:]))
