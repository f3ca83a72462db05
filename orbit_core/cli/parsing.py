"""Command line over TOML file over defaults, into one dataclass."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import tyro

from orbit_core.cli.settings import EnvironmentSettings
from orbit_core.configuration import configured, field_types, read_toml
from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError

_Settings = TypeVar("_Settings", bound=EnvironmentSettings)
_Parsed = TypeVar("_Parsed")

# In a file, tables ([fields], [settings] ...) stand for these, and a file names no other file.
_COMMAND_LINE_ONLY = ("set", "setting", "renderer_setting", "matter_setting", "config")


def parse_settings(settings_type: type[_Settings], words: Sequence[str], program: str) -> _Settings:
    """Settings from the words of the command line, and from the file that they name.

    Raises:
        ConfigurationError: the file is not readable or not TOML, or a value is not of its key's type.
        UnknownNameError: an option or a key of the file is unknown; names the nearest.
    """
    settings = parse_words(settings_type, words, program)
    if settings.config is None:
        return settings
    return parse_words(settings_type, words, program, read_file(settings_type, settings.config))


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


def read_file(settings_type: type[_Settings], path: Path) -> _Settings:
    """The settings of a TOML file over the defaults of ``settings_type``."""
    values = read_toml(path, "configuration file")
    known = field_types(settings_type).keys() - {*_COMMAND_LINE_ONLY}
    for key in values.keys() - known:
        raise UnknownNameError("key", key, known, f"configuration file {path}")
    return configured(settings_type(), values, f"configuration file {path}", "key")


def _check_options(kind: type, words: Sequence[str], program: str) -> None:
    """Refuse an option that the dataclass does not have, with the nearest that it has."""
    known = {f"--{name.replace('_', '-')}" for name, hint in _hints(kind).items() if _is_option(hint)}
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


def _hints(kind: type) -> dict[str, Any]:
    """The types of a dataclass's fields, with the parser's marks."""
    hints = get_type_hints(kind, include_extras=True)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def _is_option(hint: Any) -> bool:
    marks = getattr(hint, "__metadata__", ())
    return tyro.conf.Positional not in marks and tyro.conf.Suppress not in marks
