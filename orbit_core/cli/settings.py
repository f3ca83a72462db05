"""Settings of the commands: dataclasses, from which the options and the keys of TOML files come, and their checks.

The command line wins over a TOML file, and a TOML file over defaults.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

import tyro
from tyro.conf import Positional, Suppress, UseAppendAction, arg

from orbit_core.configuration import configured, field_types, read_toml
from orbit_core.files import storage_faults, sweep
from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError

Name = Annotated[str | None, arg(metavar="NAME")]
File = Annotated[Path | None, arg(metavar="FILE")]
KeyValues = Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="KEY=VALUE")]
_Parsed = TypeVar("_Parsed")
# A file has tables ([fields], [settings] ...) in place of these, and names no other file.
COMMAND_LINE_ONLY = ("set", "setting", "renderer_setting", "matter_setting", "config")


@dataclass(frozen=True, kw_only=True)
class EnvironmentSettings:
    """Settings of an environment: task, robot, backend and the like."""

    # None and not required: a TOML file may name the task.
    task: Annotated[Positional[str | None], arg(metavar="TASK")] = None
    """Name of a task ('orbit list tasks'); may stand in the file instead."""
    backend: Name = None
    """Physics backend ('orbit list backends'); may be left out if only one is installed."""
    robot: Name = None
    """Robot of the catalogue ('orbit list robots') in the place of the task's own."""
    action: Name = None
    """Action space in the place of the task's own."""
    renderer: Name = None
    """Renderer ('orbit list renderers') or backend that draws; the physics backend if left out."""
    matter: Name = None
    """Matter solver of cloth and rope ('orbit list matter'), or 'native' for the backend's own; the first installed one
    that does what the task needs if left out."""
    device: Annotated[str, arg(metavar="NAME")] = "cpu"
    """Torch device that holds all state, such as 'cpu' or 'cuda:0'."""
    cameras: Annotated[tuple[str, ...], arg(metavar="NAME:WxH")] = ()
    """Cameras whose colour pictures the policy sees in place of the state that they show, such as front:84x84; the
    task's own observations if left out."""
    compile: bool = False
    """Compile the layer's part of a step: seconds at the first steps, and less time in all that follow."""
    capture: bool = True
    """Capture the step once on a GPU and repeat it without its Python; without, a task may count in plain Python, and
    each step waits for the device."""
    check_finite: bool = False
    """Stop at an observation that is NaN or infinite on a GPU too; each step then waits for the device."""
    seed: int = 0
    """Seed of every environment's random stream."""
    set: KeyValues = ()
    """A field of the task, such as tolerance=0.03 ('orbit info TASK')."""
    setting: KeyValues = ()
    """A setting of the physics backend, such as iterations=50 ('orbit info BACKEND')."""
    renderer_setting: KeyValues = ()
    """A setting of what draws, such as samples_per_pixel=4 ('orbit info RENDERER')."""
    matter_setting: KeyValues = ()
    """A setting of the matter solver, such as substep=0.0005."""
    config: File = None
    """TOML file with the same keys as these options, and the tables [fields], [settings], [renderer_settings] and
    [matter_settings]; options win over it."""
    fields: Suppress[Mapping[str, Any]] = field(default_factory=dict)
    """The task's fields from the file; ``set`` wins over them."""
    settings: Suppress[Mapping[str, Any]] = field(default_factory=dict)
    """The physics backend's settings from the file; ``setting`` wins over them."""
    renderer_settings: Suppress[Mapping[str, Any]] = field(default_factory=dict)
    """The renderer's settings from the file; ``renderer_setting`` wins over them."""
    matter_settings: Suppress[Mapping[str, Any]] = field(default_factory=dict)
    """The matter solver's settings from the file; ``matter_setting`` wins over them."""


@dataclass(frozen=True, kw_only=True)
class RunSettings(EnvironmentSettings):
    """Run a task's episodes and report success, metrics, return and speed."""

    num_envs: int = 16
    """Environments stepped together."""
    episodes: int = 200
    """Episodes that count, divided evenly over the environments, so that short ones are not preferred."""
    agent: Annotated[str, arg(metavar="{expert,random,zero,hold,POLICY}")] = "expert"
    """Who acts: one of these, a kept policy ('orbit list policies'), or the file or folder of a learned one."""
    json: File = None
    """Write the result here."""
    video: File = None
    """Write an mp4 of the first episode of up to four environments here."""
    # Multiples of 16, an encoder's macroblock.
    video_size: tuple[int, int] = (400, 304)
    """Width and height of an environment's picture in the video, multiples of 16."""
    frames: bool = False
    """Draw axes in the video at the robot's base, end effectors, finger tips, feet and wheels."""
    overwrite: bool = False
    """Replace files of those names that are there already."""


@dataclass(frozen=True, kw_only=True)
class BenchSettings(EnvironmentSettings):
    """Measure throughput over numbers of environments, with random actions."""

    num_envs: tuple[int, ...] = (1, 4, 16, 64, 256)
    """Numbers of environments to measure at."""
    steps: int = 200
    """Steps of all environments that are timed at each number, after a tenth as many to warm up."""
    json: File = None
    """Write the figures here."""
    plot: File = None
    """Draw the figures here, as PNG."""
    overwrite: bool = False
    """Replace files of those names that are there already."""


def check_output(path: Path | None, suffix: str, overwrite: bool) -> None:
    """Reject an output file that cannot be written, before the work whose result it is to hold.

    What a program that was killed has left in its folder is deleted.

    Args:
        path: of the file; None is no file.
        suffix: that its name must have.
        overwrite: whether it may exist.
    """
    if path is None:
        return
    if path.suffix != suffix:
        raise ConfigurationError(f"the name of output file {path} must end in {suffix}")
    check_parent(path)
    if path.is_dir():
        raise ConfigurationError(f"cannot write {path}: it is a folder")
    if path.exists() and not path.is_file():
        raise ConfigurationError(f"cannot write {path}: it is no regular file")
    if path.exists() and not overwrite:
        raise ConfigurationError(f"{path} is there already: give another name, or --overwrite")
    sweep(path.parent)


def check_parent(path: Path) -> None:
    """Reject the path of an output file or folder whose own folder is missing or read-only.

    Raises:
        ConfigurationError: it is; the message names the folder.
    """
    if not path.parent.is_dir():
        raise ConfigurationError(f"cannot write {path}: there is no folder {path.parent}")
    # Tested now: a command should not fail after an hour of work.
    if not os.access(path.parent, os.W_OK):
        raise ConfigurationError(f"cannot write {path}: folder {path.parent} is read-only for this user")


def make_folder(path: Path) -> None:
    """Make the folder that an output file is to lie in.

    Raises:
        StorageError: it cannot be made.
    """
    with storage_faults(path):
        path.parent.mkdir(parents=True, exist_ok=True)


def check_port(name: str, port: int) -> None:
    """Refuse what is no port."""
    if not 0 <= port <= 65535:
        raise ConfigurationError(f"{name} must be from 0 to 65535, not {port}")


def check_positive(name: str, value: int) -> None:
    """Refuse a number below one."""
    if value < 1:
        raise ConfigurationError(f"{name} must be at least 1, not {value}")


def check_steps(max_steps: int | None) -> None:
    """Refuse a limit of steps below one."""
    if max_steps is not None:
        check_positive("max_steps", max_steps)


def check_size(name: str, size: tuple[int, ...]) -> None:
    """Refuse what is no width and height; a file's list may have any length."""
    if len(size) != 2:
        raise ConfigurationError(f"{name} must be a width and a height, not {list(size)}")


_Settings = TypeVar("_Settings", bound=EnvironmentSettings)


def parse_settings(settings_type: type[_Settings], words: Sequence[str], program: str) -> _Settings:
    """Return settings from the words of the command line, and from the file that they name.

    Args:
        settings_type: dataclass of the command's settings.
        words: of the command line.
        program: name of the command, for messages.

    Raises:
        ConfigurationError: the file is not readable or not TOML, or a value is not of its key's type.
        UnknownNameError: an option or a key of the file is unknown; names the nearest.
    """
    settings = parse_words(settings_type, words, program)
    # Parsed twice: the first time finds the file, whose values are the defaults of the second.
    if settings.config is None:
        return settings
    return parse_words(settings_type, words, program, read_file(settings_type, settings.config, settings))


def parse_words(kind: type[_Parsed], words: Sequence[str], program: str, default: Any = None) -> _Parsed:
    """Return a dataclass from the words of the command line alone."""
    _check_options(kind, words, program)
    complaint = io.StringIO()
    try:
        # tyro offers no other way to its messages than a box on stderr and an exit.
        with contextlib.redirect_stderr(complaint):
            parsed, unknown = tyro.cli(kind, args=words, prog=program, default=default, return_unknown_args=True)
    except SystemExit as stop:
        if not stop.code:  # the help was printed
            raise
        raise ConfigurationError(f"{_one_line(complaint.getvalue())} ({program} --help)") from None
    if unknown:
        raise ConfigurationError(f"unexpected argument '{unknown[0]}' ({program} --help)")
    return parsed


def read_file(settings_type: type[_Settings], path: Path, given: _Settings | None = None) -> _Settings:
    """Return the settings of a TOML file over the defaults of ``settings_type``.

    Args:
        settings_type: dataclass of the command's settings.
        path: path of the file.
        given: settings of the command line, for fields without a default, such as the policy to play.
    """
    values = read_toml(path, "configuration file")
    known = field_types(settings_type).keys() - {*COMMAND_LINE_ONLY}
    for key in values.keys() - known:
        raise UnknownNameError("key", key, known, f"configuration file {path}")
    fields, missing = dataclasses.fields(settings_type), dataclasses.MISSING
    required = [each.name for each in fields if each.default is missing and each.default_factory is missing]
    base = settings_type(**{name: getattr(given, name) for name in required})
    return configured(base, values, f"configuration file {path}", "key")


def _check_options(kind: type, words: Sequence[str], program: str) -> None:
    """Refuse an option that the dataclass does not have, with the nearest that it has."""
    known = {"--help"}
    for name, hint in _hints(kind).items():
        if _is_option(hint):
            known |= _words_of(name, hint)
    for word in words:
        # tyro takes underscores and dashes alike.
        option = word.partition("=")[0].replace("_", "-")
        if option.startswith("--") and option not in known:
            raise UnknownNameError("option", option, known, program)


def _one_line(complaint: str) -> str:
    """Return the sentence inside the box that tyro draws around its complaint, without title and hint."""
    text = [line for line in complaint.splitlines() if not line.startswith(("╭", "╰"))]
    sentence = " ".join(re.split(r"─{3,}", "\n".join(text))[0].replace("│", " ").split())
    return sentence.rstrip(".") or "malformed command line"


def _hints(kind: type) -> dict[str, Any]:
    """Return the types of a dataclass's fields, with the parser's marks."""
    hints = get_type_hints(kind, include_extras=True)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def _words_of(name: str, hint: Any) -> set[str]:
    """Return the options of a field: its name, or the one that it is given, and the negation of a switch."""
    marks = getattr(hint, "__metadata__", ())
    given = next((mark.name for mark in marks if getattr(mark, "name", None) is not None), name).replace("_", "-")
    switch = (get_args(hint)[0] if marks else hint) is bool
    return {f"--{given}", f"--no-{given}"} if switch else {f"--{given}"}


def _is_option(hint: Any) -> bool:
    marks = getattr(hint, "__metadata__", ())
    return tyro.conf.Positional not in marks and tyro.conf.Suppress not in marks
