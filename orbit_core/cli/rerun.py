"""``orbit rerun``: repeat a recorded run from its own file, and report whether it came out the same."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from orbit_core.backends import backend
from orbit_core.cli.making import actor_digest, check_actor
from orbit_core.cli.output import console, new_table
from orbit_core.cli.run import RunResult, run
from orbit_core.cli.settings import RunSettings, parse_words
from orbit_core.configuration import configured
from orbit_core.interfaces import Capability, Level
from orbit_core.interfaces.errors import ConfigurationError

# Largest file that is read, bytes
_MOST_BYTES = 1 << 24
# Parts of a result that the clock decides
_TIMED = ("env_steps_per_second", "wall_seconds")


@dataclass(frozen=True, kw_only=True)
class RerunSettings:
    """Repeat a run from the file that 'orbit run --json' wrote, and report whether it came out the same."""

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """Result of a run, with its settings."""


@dataclass(frozen=True)
class ResultDifference:
    """A number that came out otherwise."""

    name: str
    """Path in the result."""
    recorded: Any
    """Value in the result's file."""
    repeated: Any
    """Value of the new run."""


def main(words: Sequence[str]) -> int:
    """Repeat the run; the exit code is 1 if a number differs."""
    settings = parse_words(RerunSettings, words, "orbit rerun")
    recorded = read_result(settings.file)
    again = recorded_settings(recorded, settings.file)
    check_actor(again.agent)
    result = run(again)
    found = [*differences(recorded, result.as_json())]
    causes = [*_causes(recorded, again, result)]
    out = console()
    if not found:
        out.print(f"the same: {result.episodes} episodes of {again.task} on {result.backend}, number by number")
    else:
        table = new_table("", "recorded", "now", title=f"{again.task} on {result.backend} came out otherwise")
        for difference in found:
            table.add_row(difference.name, str(difference.recorded), str(difference.repeated))
        out.print(table)
    for line in causes:
        out.print(f"differs: {line}", soft_wrap=True)
    return 1 if found else 0


def read_result(path: Path) -> dict[str, Any]:
    """Read the result of a run.

    Raises:
        ConfigurationError: the file is not readable, is none, or holds no settings.
    """
    try:
        # Before reading, as a wrong path may be a video of gigabytes.
        if path.stat().st_size > _MOST_BYTES:
            raise ConfigurationError(f"{path} is no result of a run: it has {path.stat().st_size:,} bytes")
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigurationError(f"cannot read the result of a run from {path}: {error}") from None
    if not isinstance(values, dict) or not isinstance(values.get("settings"), dict):
        raise ConfigurationError(
            f"{path} holds no settings of a run: make it again with 'orbit run --json', which writes them"
        )
    return values


def recorded_settings(recorded: Mapping[str, Any], path: Path) -> RunSettings:
    """Return the settings that a result records, without its files.

    Raises:
        ConfigurationError: they are none.
    """
    return configured(RunSettings(), recorded["settings"], f"result {path}", "setting")


def differences(recorded: Mapping[str, Any], repeated: Mapping[str, Any]) -> Iterator[ResultDifference]:
    """Yield the numbers of two results that differ; those of the clock and descriptions of the run do not count."""
    for name in dict.fromkeys((*recorded, *repeated)):
        if name not in (*_TIMED, "settings", "versions", "agent_digest"):
            # As the file has it: JSON makes lists of tuples, and text of keys.
            yield from _apart(name, recorded.get(name), json.loads(json.dumps(repeated.get(name))))


def _apart(name: str, one: Any, other: Any) -> Iterator[ResultDifference]:
    if isinstance(one, dict) and isinstance(other, dict):
        for key in dict.fromkeys((*one, *other)):
            yield from _apart(f"{name}.{key}", one.get(key), other.get(key))
    # A mean of no episodes is NaN in both results, and NaN is unlike itself.
    elif one != other and not (_is_nan(one) and _is_nan(other)):
        yield ResultDifference(name, one, other)


def _is_nan(value: Any) -> bool:
    return isinstance(value, float) and math.isnan(value)


def _causes(recorded: Mapping[str, Any], settings: RunSettings, result: RunResult) -> Iterator[str]:
    """Yield what may explain a difference: versions, the policy's file, an engine that does not repeat itself."""
    before = recorded.get("versions")
    before = before if isinstance(before, dict) else {}
    for name in dict.fromkeys((*before, *result.versions)):
        one, other = before.get(name, "absent"), result.versions.get(name, "absent")
        if one != other:
            yield f"{name} was {one} and is {other}"
    if recorded.get("agent_digest", "") != actor_digest(settings.agent):
        yield f"the file of policy '{settings.agent}' is another"
    support = backend(result.backend).capabilities()[Capability.DETERMINISTIC]
    if support.level is not Level.EXACT:
        yield f"backend '{result.backend}' does not repeat its runs exactly: {support.reason}"
