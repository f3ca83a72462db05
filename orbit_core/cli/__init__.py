"""The ``orbit`` command. Each command is a module that is imported only when it is called."""

from __future__ import annotations

import importlib
import os
import sys
import warnings
from collections.abc import Sequence

from orbit_core.cli.signals import Terminated, termination_interrupts
from orbit_core.interfaces.errors import OrbitError, UnknownNameError

COMMANDS = {
    "list": ("listing", "Names of all tasks, robots or backends"),
    "info": ("info", "Everything about one task, robot or backend"),
    "run": ("run", "Run a task's episodes with an expert, random or zero agent, and report how they went"),
    "view": ("view", "Watch a task live in the browser"),
    "train": ("train", "Learn a task with a reinforcement learning library"),
    "play": ("play", "Run a learned policy on any backend, and report how it went"),
    "export": ("export", "Write a learned policy as safetensors and ONNX, with its description"),
    "bench": ("bench", "Measure throughput over numbers of environments"),
    "conformance": ("conformance", "Hold backends against known answers and whole tasks, and report"),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    It is 2 for a user's mistake, told in one line, 130 when interrupted, and 143 when ended by SIGTERM, which closes
    everything as an interrupt does.

    ``--debug``, or ORBIT_DEBUG=1 in the process's environment, shows the traceback of such a mistake.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words or os.environ.get("ORBIT_DEBUG", "") not in ("", "0")
    words = [word for word in words if word != "--debug"]
    try:
        with warnings.catch_warnings(), termination_interrupts():
            if not debug:
                warnings.showwarning = _show_warning
            return _dispatch(words)
    except OrbitError as error:
        if debug:
            raise
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except Terminated:
        return 143
    except KeyboardInterrupt:
        return 130


def _show_warning(message: Warning | str, *_: object) -> None:
    """A warning is a sentence to the user; where in the code it arose is for ``--debug``."""
    print(f"warning: {' '.join(str(message).split())}", file=sys.stderr)


def _dispatch(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help"):
        print(_usage())
        return 0
    if words[0] == "--version":
        from orbit_core import __version__

        print(__version__)
        return 0
    if words[0] not in COMMANDS:
        raise UnknownNameError("command", words[0], COMMANDS)
    module = importlib.import_module(f"{__name__}.{COMMANDS[words[0]][0]}")
    return module.main(words[1:]) or 0


def _usage() -> str:
    lines = [f"  {name:<11} {description}" for name, (_, description) in COMMANDS.items()]
    hint = "'orbit COMMAND --help' describes a command's options; --debug shows where an error arose."
    return "\n".join(["usage: orbit [--version] COMMAND ...", "", *lines, "", hint])
