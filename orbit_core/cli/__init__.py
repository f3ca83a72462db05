"""The ``orbit`` command. Each command is a module that is imported only when it is called.

Installed packages add commands through the entry-point group ``orbit.commands``: an entry point bears the command's
name and names a function that takes the words after it and returns an exit code, or None for 0.
"""

from __future__ import annotations

import functools
import importlib
import io
import os
import sys
import warnings
from collections.abc import Callable, Sequence

from orbit_core.cli.signals import EndRequest
from orbit_core.files import DISK_FULL
from orbit_core.installing import install_command
from orbit_core.interfaces.errors import ConfigurationError, OrbitError
from orbit_core.registry import Registry

Command = Callable[[Sequence[str]], int | None]
"""Takes the words after the command's name and gives the exit code, None for 0."""

COMMANDS = {
    "list": ("listing", "Names of all tasks, robots or backends"),
    "info": ("info", "Everything about one task, robot or backend"),
    "run": ("run", "Run a task's episodes with an expert, random or zero agent, and report how they went"),
    "rerun": ("rerun", "Repeat a run from its file, and report whether it came out the same"),
    "bench": ("bench", "Measure throughput over numbers of environments"),
}
"""Modules of this package, and what each does."""
OTHERS = {
    "view": ("orbit-viewer", "Watch a task live in the browser"),
    "record": ("orbit-data", "Record a task's episodes as a dataset of demonstrations"),
    "teleop": ("orbit-data", "Drive a task's robot yourself, and record demonstrations"),
    "augment": ("orbit-data", "Make many demonstrations of a few, moved to where things are in new episodes"),
    "data": ("orbit-data", "Describe, convert, merge, filter, split and replay datasets of demonstrations"),
    "grasp": ("orbit-motion", "Choose, accept and move grasps of an arm in the browser, and take the arm"),
    "train": ("orbit-learn", "Learn a task: by reinforcement, from a teacher or from demonstrations"),
    "sweep": ("orbit-learn", "Train with varied settings on the machines of a Ray cluster, and compare"),
    "plot": ("orbit-learn", "Draw learning curves of trainings against each other"),
    "train-actuator": ("orbit-learn", "Fit a network to logged data of an actuator's joints"),
    "play": ("orbit-learn", "Run a learned policy on any backend, and report how it went"),
    "export": ("orbit-learn", "Write a learned policy as safetensors and ONNX, with its description"),
    "evaluate": ("orbit-learn", "Compare policies on the same starts, on several backends, with intervals"),
    "adopt": ("orbit-learn", "Describe a network made elsewhere, so that it acts as a policy of a task"),
    "serve": ("orbit-learn", "Serve a policy to programs that speak OpenPI's protocol"),
    "deploy": ("orbit-deploy", "Run an expert, a learned policy or a person on a robot, through a bridge"),
    "robot": ("orbit-deploy", "Serve a simulated robot as a robot's computer does, in real time"),
    "identify": ("orbit-deploy", "Fit a robot's friction, damping, armature, delay and payload to a log of its motion"),
    "twin": ("orbit-deploy", "Replay a robot's log in simulation, and show where robot and simulations differ"),
    "bisect": ("orbit-deploy", "Find which difference between two simulations makes a policy fail"),
    "edit": ("orbit-scenes", "Author a scene in the browser, and make a task in it"),
    "scene": ("orbit-scenes", "Make rooms, houses, tables and bins by seed, check scenes, list household things"),
    "check-asset": ("orbit-assets", "Check an asset file: masses, inertias, limits, shapes, and what was changed"),
    "check-robot": (
        "orbit-assets",
        "Check a catalogue entry or a composition: limits, gains, home, frames, stance, licence",
    ),
    "check-task": (
        "orbit-conformance",
        "Check tasks: order of returns, limits kept by experts, coverage of starts, chance",
    ),
    "convert": ("orbit-assets", "Convert between URDF, MJCF and USD, and meshes into rigid bodies"),
    "conformance": ("orbit-conformance", "Hold backends against known answers and whole tasks, and report"),
}
"""Distributions of ORBIT that bring further commands, and what each does."""
# Order in which ``orbit --help`` lists commands; those of other packages come last
_ORDER = (*list(COMMANDS)[:4], *list(OTHERS)[:-1], "bench", "conformance")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    The code is 2 for a user's mistake, reported in one line, 130 for a command that was interrupted, and 143 for one
    that SIGTERM ended; either signal closes everything first, and a second one ends the process at once.

    ``--debug``, or ORBIT_DEBUG=1 in the process's environment, shows the traceback of such a mistake.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words or os.environ.get("ORBIT_DEBUG", "") not in ("", "0")
    words = [word for word in words if word != "--debug"]
    if isinstance(sys.stdout, io.TextIOWrapper):
        # Where the terminal's encoding lacks a character, such as that of a deviation or of a file's name, a table of
        # finished work shows its number in the place of it.
        sys.stdout.reconfigure(errors="backslashreplace")
    request = EndRequest()
    try:
        with warnings.catch_warnings(), request:
            if not debug:
                warnings.showwarning = _show_warning
            code = _dispatch(words)
    except OrbitError as error:
        if debug:
            raise
        from orbit_core.cli.output import printable

        print(f"error: {printable(' '.join(str(error).split()))}", file=sys.stderr)
        code = 2
    except OSError as error:
        if debug or error.errno not in DISK_FULL:
            raise
        where = error.filename or "a temporary file"
        print(f"error: cannot write {where}: {error.strerror}; TMPDIR names another folder", file=sys.stderr)
        code = 2
    except KeyboardInterrupt:
        code = 130
    return request.exit_code or code


def _show_warning(message: Warning | str, *_: object) -> None:
    """Print a warning as one sentence; where in the code it arose is for ``--debug``."""
    print(f"warning: {' '.join(str(message).split())}", file=sys.stderr)


def _dispatch(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help"):
        print(_usage())
        return 0
    if words[0] == "--version":
        from orbit_core import __version__

        print(__version__)
        return 0
    name, registry = words[0], commands()
    # Known commands of distributions that are missing get an install command in place of "unknown command".
    if name in OTHERS and name not in registry.names:
        distribution = OTHERS[name][0]
        raise ConfigurationError(
            f"command '{name}' comes with the distribution {distribution}, which is not installed: "
            f"{install_command(distribution)}"
        )
    return registry.get(name)(words[1:]) or 0


@functools.cache
def commands() -> Registry[Command]:
    """Return all commands by name: this distribution's, and those of installed packages."""
    registry = Registry[Command]("command", "orbit.commands")
    for name, (module, _) in COMMANDS.items():
        registry.add(name, functools.partial(_run_module, module))
    return registry


def _run_module(module: str, words: Sequence[str]) -> int | None:
    return importlib.import_module(f"{__name__}.{module}").main(words)


def _usage() -> str:
    registry = commands()
    known = {**COMMANDS, **OTHERS}
    names = sorted(registry.names, key=lambda name: _ORDER.index(name) if name in _ORDER else len(_ORDER))
    lines = [f"  {name:<14} {known[name][1] if name in known else registry.origin(name)}" for name in names]
    hint = "'orbit COMMAND --help' describes a command's options; --debug shows where an error arose."
    return "\n".join(["usage: orbit [--version] COMMAND ...", "", *lines, "", hint])
