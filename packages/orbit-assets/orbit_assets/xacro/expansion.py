"""Xacro files expanded to URDF by a process with limits, which can read the model's files only."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

from orbit_assets.options import ReadOptions
from orbit_assets.source_text import parse_xml, read_xml
from orbit_assets.xacro.order import Expansion, Order
from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import AssetError

# Seconds for one file: macros may call themselves forever.
_SECONDS = 15
# Bytes of address space of the process, Python's own included.
_MEMORY = 2**30
# Most characters of the URDF.
_CHARACTERS = 16 * 2**20
# Most bytes that are read from the process: a character has up to four.
_BYTES = 4 * _CHARACTERS
# Substitutions of ROS in attributes, which files without a macro have too.
_SUBSTITUTION = re.compile(r"\$\((optenv|env|arg|eval)\s")


@dataclass(frozen=True)
class ExpandedXml:
    """Root element of a URDF file without macros, and notes on how they were expanded; without macros, no notes."""

    root: Element
    notes: tuple[str, ...] = ()


def is_xacro(root: Element) -> bool:
    """Return True if a document holds xacro's macros, or substitutions in attributes that describe the robot."""
    if any(element.tag.startswith("xacro:") for element in root.iter()):
        return True
    # Only elements that describe the robot count: simulators' own elements use the same syntax for other purposes.
    described = (element for tag in ("link", "joint") for part in root.findall(tag) for element in part.iter())
    return any(_SUBSTITUTION.search(value) for element in described for value in element.attrib.values())


def read_expanded(path: Path, options: ReadOptions) -> ExpandedXml:
    """Read a URDF or xacro file, and expand its macros if it holds some.

    Raises:
        AssetError: it is no XML, or cannot be expanded.
    """
    root = read_xml(path, options)
    if is_xacro(root) or path.suffix.lower() == ".xacro":
        return expand_xacro(path, options)
    return ExpandedXml(root)


def expand_xacro(path: Path, options: ReadOptions) -> ExpandedXml:
    """Expand a xacro file to URDF, with the defaults of its arguments.

    A process with limits of memory, time and output does it (:mod:`orbit_assets.xacro.process`).

    Raises:
        AssetError: the package ``xacro`` is not installed, or the file cannot be expanded.
    """
    if importlib.util.find_spec("xacro") is None:
        raise AssetError(
            f"URDF file '{path}' holds xacro macros: {install_extra('xacro')}, or expand it with xacro first"
        )
    outside = options.allow_outside if isinstance(options.allow_outside, tuple) else ()
    order = Order(
        path=str(path.absolute()),
        packages={name: str(folder) for name, folder in options.packages.items()},
        outside=("/",) if options.allow_outside is True else tuple(map(str, outside)),
        environment={name: os.environ[name] for name in options.environment if name in os.environ},
        limits=options.limits,
        characters=_CHARACTERS,
        memory=_MEMORY,
        seconds=_SECONDS,
    )
    code, said = _answer(order)
    if code is None:
        raise AssetError(f"xacro file '{path}' takes over {_SECONDS} s to expand: a macro may call itself")
    if code != 0:
        raise AssetError(
            f"xacro file '{path}' cannot be expanded ({said or f'exit status {code}'}): correct it, or expand it "
            "with xacro yourself"
        )
    expansion = Expansion.decoded(said)
    notes = ["the file's xacro macros are expanded"]
    # A default may surprise a user who has set the variable.
    if held := sorted(set(os.environ) & set(expansion.unnamed)):
        notes.append(
            f"$(optenv ...) has its default for {', '.join(held)}, which are set: name them in "
            "ReadOptions(environment=...)"
        )
    return ExpandedXml(parse_xml(expansion.document, str(path), options.limits), tuple(notes))


def _answer(order: Order) -> tuple[int | None, str]:
    """Return the process's exit code, None if its time ran out, and its output."""
    process = subprocess.Popen(
        # -P keeps the working folder, which may be the model's, from where Python finds modules.
        [sys.executable, "-P", "-m", f"{__package__}.process"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ
        | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "PYTHONUTF8": "1", "PYTHONHASHSEED": "0"},
    )
    # The event distinguishes a timeout from a crash by a signal.
    late = threading.Event()

    def stop() -> None:
        late.set()
        process.kill()

    timer = threading.Timer(_SECONDS, stop)
    timer.start()
    said = bytearray()
    try:
        with process:
            assert process.stdin is not None
            assert process.stdout is not None
            with contextlib.suppress(BrokenPipeError), process.stdin as orders:
                orders.write(order.encoded().encode())
            # Output is limited here too: the process could write without end.
            while len(said) <= _BYTES and (read := os.read(process.stdout.fileno(), 2**20)):
                said += read
            if len(said) > _BYTES:
                process.kill()
    except BaseException:
        process.kill()
        raise
    finally:
        timer.cancel()
    if late.is_set():
        return None, ""
    return process.returncode, said.decode("utf-8", "replace").strip() if len(said) <= _BYTES else "it writes too much"
