"""Xacro files expanded to URDF in a process that can read the model's files alone."""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path
from xml.etree.ElementTree import Element

from orbit_core.assets.options import ReadOptions
from orbit_core.assets.outside import allowed_folders
from orbit_core.assets.source_text import parse_xml, read_xml
from orbit_core.interfaces.errors import AssetError

_SECONDS = 20
"""For one file; macros may call themselves."""
_SUBSTITUTION = re.compile(r"\$\((optenv|env|arg|eval)\s")
"""What ROS replaces in attributes, in files without a macro too."""


def is_xacro(root: Element) -> bool:
    """Whether an XML document holds xacro's macros, or substitutions in attributes of what describes the robot."""
    if any(element.tag.startswith("xacro:") for element in root.iter()):
        return True
    described = (element for tag in ("link", "joint") for part in root.findall(tag) for element in part.iter())
    return any(_SUBSTITUTION.search(value) for element in described for value in element.attrib.values())


def read_expanded(path: Path, options: ReadOptions) -> tuple[Element, bool]:
    """The root element of a URDF or xacro file without macros, and whether it held some.

    Raises:
        AssetError: it is no XML, or cannot be expanded.
    """
    root = read_xml(path, options)
    if is_xacro(root) or path.suffix.lower() == ".xacro":
        return expand_xacro(path, options), True
    return root, False


def expand_xacro(path: Path, options: ReadOptions) -> Element:
    """The root element of the URDF that a xacro file expands to, with the defaults of its arguments.

    A xacro file is a program: its expressions are Python. It runs in a process of its own, which may read files below
    the folders that the model may name, write none, start no other process and use no network, for a limited time.

    Raises:
        AssetError: the package ``xacro`` is not installed, or the file cannot be expanded.
    """
    if importlib.util.find_spec("xacro") is None:
        raise AssetError(
            f"URDF file '{path}' holds xacro macros: pip install \"orbit-core[xacro]\", or expand it with xacro first"
        )
    order = {
        "path": str(path.absolute()),
        "packages": {name: str(folder) for name, folder in options.packages.items()},
        "folders": None if options.allow_outside is True else [str(f) for f in allowed_folders(path, options)],
        "megabytes": 2048,
    }
    try:
        done = subprocess.run(
            [sys.executable, "-m", "orbit_core.assets.xacro_process"],
            input=json.dumps(order),
            capture_output=True,
            text=True,
            encoding="utf-8",
            timeout=_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise AssetError(f"xacro file '{path}' takes over {_SECONDS} s to expand: a macro may call itself") from None
    if done.returncode != 0:
        said = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        raise AssetError(f"xacro file '{path}' cannot be expanded ({said[-1]}): correct it, or expand it yourself")
    return parse_xml(done.stdout, str(path), options.limits)
