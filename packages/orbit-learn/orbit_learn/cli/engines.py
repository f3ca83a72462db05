"""Engines of a training: one, or several that it learns on together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

from orbit_core.backends import backend
from orbit_core.cli.making import make_environment
from orbit_core.cli.settings import EnvironmentSettings
from orbit_core.interfaces.errors import ConfigurationError

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment


def engines_of(named: str | Sequence[str] | None) -> tuple[str, ...]:
    """Return the engines that ``--backend`` names; none if it is left out.

    Raises:
        UnknownNameError: one of several is unknown.
        ConfigurationError: one is named twice.
    """
    names = (named,) if isinstance(named, str) else tuple(named or ())
    if len(set(names)) != len(names):
        raise ConfigurationError(f"--backend names an engine twice: {' '.join(names)}")
    if len(names) > 1:
        for name in names:
            backend(name)
    return names


def of_engine(
    words: Sequence[str], table: Mapping[str, Any], engine: str, engines: Sequence[str]
) -> tuple[tuple[str, ...], Mapping[str, Any]]:
    """Return the words and the table of settings of one of several engines.

    Args:
        words: ``ENGINE.KEY=VALUE``.
        table: settings by engine.
        engine: one of them.
        engines: all of them.

    Raises:
        ConfigurationError: a setting names none of the engines.
    """
    for word in (*words, *table):
        if word.partition(".")[0] not in engines:
            raise ConfigurationError(
                f"setting '{word}' names none of the engines {', '.join(engines)}: write ENGINE.KEY=VALUE, or in a "
                "file a table for each engine"
            )
    own = tuple(word.removeprefix(f"{engine}.") for word in words if word.startswith(f"{engine}."))
    return own, table.get(engine, {})


def environment_on(engines: Sequence[EnvironmentSettings], num_envs: int, reset_diverged: bool) -> Environment:
    """Return the environment of a training; of several engines, one that divides the environments over them.

    Args:
        engines: settings on each engine.
        num_envs: environments of all of them.
        reset_diverged: whether environments that diverge begin new episodes.

    Raises:
        OrbitError: of many kinds; each names the setting.
    """
    if len(engines) == 1:
        return make_environment(engines[0], num_envs, reset_diverged=reset_diverged)
    from orbit_learn.across import AcrossEngines

    if num_envs < len(engines):
        raise ConfigurationError(f"{num_envs} environments do not divide over {len(engines)} engines: give more")
    share, more = divmod(num_envs, len(engines))
    parts: list[Environment] = []
    try:
        for place, settings in enumerate(engines):
            parts.append(make_environment(settings, share + (place < more), reset_diverged=reset_diverged))
        # Trainers with `several_engines` use of an environment only what this class has.
        return cast("Environment", AcrossEngines(parts))
    except BaseException:
        for part in parts:
            part.close()
        raise
