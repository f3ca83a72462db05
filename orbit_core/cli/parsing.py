"""Command line over TOML file over defaults, into one dataclass."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import re
import tomllib
import types
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import tyro

from orbit_core.cli.settings import EnvironmentSettings
from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError

_Settings = TypeVar("_Settings", bound=EnvironmentSettings)
_Parsed = TypeVar("_Parsed")

# In a file, tables ([fields], [settings], [renderer_settings]) stand for these, and a file names no other file.
_COMMAND_LINE_ONLY = ("set", "setting", "renderer_setting", "config")


def parse_settings(settings_type: type[_Settings], words: Sequence[str], program: str) -> _Settings:
    """Settings from the words of the command line, and from the file that they name.

    Raises:
        ConfigurationError: the file is not readable or not TOML, or a value is not of its key's type.
        UnknownNameError: an option or a key of the file is unknown; names the nearest.
    """
    settings = parse_words(settings_type, words, program)
    if settings.config is None:
        return settings
    return parse_words(settings_type, words, program, settings_type(**read_file(settings_type, settings.config)))


def parse_words(kind: type[_Parsed], words: Sequence[str], program: str, default: Any = None) -> _Parsed:
    """A dataclass from the words of the command line alone."""
    _check_options(kind, words, program)
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            parsed, unknown = tyro.cli(kind, args=words, prog=program, default=default, return_unknown_args=True)
    except SystemExit as stop:
        if not stop.code:  # the help was printed
            raise
        raise ConfigurationError(f"{_one_line(complaint.getvalue())} ({program} --help)") from None
    if unknown:
        raise ConfigurationError(f"unexpected argument '{unknown[0]}' ({program} --help)")
    return parsed


def read_file(settings_type: type[EnvironmentSettings], path: Path) -> dict[str, Any]:
    """The keys of a TOML file, checked against the fields of ``settings_type``."""
    try:
        with path.open("rb") as file:
            values = tomllib.load(file)
    except OSError as error:
        raise ConfigurationError(f"cannot read configuration file {path}: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"configuration file {path} is not TOML: {error}") from error
    hints = {name: hint for name, hint in _hints(settings_type).items() if name not in _COMMAND_LINE_ONLY}
    for key, value in values.items():
        if key not in hints:
            raise UnknownNameError("key", key, hints, f"configuration file {path}")
        if not _fits(value, hints[key]):
            raise ConfigurationError(f"configuration file {path}: {key} = {value!r} must be {_words(hints[key])}")
    return {key: _converted(value, hints[key]) for key, value in values.items()}


def _check_options(kind: type, words: Sequence[str], program: str) -> None:
    """Refuse an option that the dataclass does not have, with the nearest that it has."""
    known = {f"--{name.replace('_', '-')}" for name, hint in _hints(kind, True).items() if _is_option(hint)}
    known.add("--help")
    for word in words:
        option = word.partition("=")[0].replace("_", "-")
        if option.startswith("--") and option not in known:
            raise UnknownNameError("option", option, known, program)


def _one_line(complaint: str) -> str:
    """The sentence inside the box that the parser draws around its complaint; the title and the hint fall away."""
    text = [line for line in complaint.splitlines() if not line.startswith(("╭", "╰"))]
    sentence = " ".join(re.split(r"─{3,}", "\n".join(text))[0].replace("│", " ").split())
    return sentence.rstrip(".") or "malformed command line"


def _hints(kind: type, annotated: bool = False) -> dict[str, Any]:
    """The types of a dataclass's fields, with the parser's marks or without."""
    hints = get_type_hints(kind, include_extras=annotated)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def _is_option(hint: Any) -> bool:
    marks = getattr(hint, "__metadata__", ())
    return tyro.conf.Positional not in marks and tyro.conf.Suppress not in marks


def _members(hint: Any) -> tuple[Any, ...]:
    return get_args(hint) if get_origin(hint) in (types.UnionType, Union) else (hint,)


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value of a TOML file may stand for a field of that type."""
    for member in _members(hint):
        kind = get_origin(member) or member
        if kind is tuple:
            fits = isinstance(value, list) and all(_fits(item, get_args(member)[0]) for item in value)
        elif kind is Mapping:
            fits = isinstance(value, dict)
        else:
            fits = type(value) is (str if kind is Path else kind)
        if fits:
            return True
    return False


def _converted(value: Any, hint: Any) -> Any:
    if isinstance(value, list):
        return tuple(value)
    return Path(value) if Path in _members(hint) else value


def _words(hint: Any) -> str:
    """How a message calls a type."""
    names = {
        str: "text",
        Path: "text",
        int: "a whole number",
        bool: "true or false",
        tuple: "a list of whole numbers",
        Mapping: "a table",
    }
    return " or ".join(names[get_origin(m) or m] for m in _members(hint) if m is not types.NoneType)
