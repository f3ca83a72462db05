"""Engines of a training: one, or several that it learns on together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

from orbit_core.backends import backend
from orbit_core.cli.making import make_environment
from orbit_core.interfaces.errors import ConfigurationError

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment
    from orbit_learn.cli.train import TrainSettings


def several_engines(settings: TrainSettings) -> tuple[str, ...]:
    """Return the engines that a training learns on together; none if it has one.

    Raises:
        UnknownNameError: an engine is unknown.
        ConfigurationError: an engine is named twice, or there are fewer environments than engines.
    """
    names = settings.backend
    if names is None or isinstance(names, str) or len(names) == 1:
        return ()
    if len(set(names)) != len(names):
        raise ConfigurationError(f"--backend names an engine twice: {' '.join(names)}")
    for name in names:
        backend(name)
    if settings.num_envs < len(names):
        raise ConfigurationError(f"{settings.num_envs} environments do not divide over {len(names)} engines: give more")
    return names


def on_engine(settings: TrainSettings, engine: str) -> TrainSettings:
    """Return the settings with one of their several engines, and its own settings."""
    words, table = of_engine(settings.setting, settings.settings, engine, several_engines(settings))
    return replace(settings, backend=engine, setting=words, settings=table)


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


def make_training_environment(settings: TrainSettings) -> Environment:
    """Return the environment of a training; of several engines, one that divides ``num_envs`` over them.

    Raises:
        OrbitError: of many kinds; each names the setting.
    """
    resets = settings.diverged == "reset"
    engines = several_engines(settings)
    if not engines:
        return make_environment(with_one_engine(settings), settings.num_envs, reset_diverged=resets)
    from orbit_learn.across import AcrossEngines

    share, more = divmod(settings.num_envs, len(engines))
    parts: list[Environment] = []
    try:
        for place, engine in enumerate(engines):
            parts.append(make_environment(on_engine(settings, engine), share + (place < more), reset_diverged=resets))
        # Trainers with `several_engines` use of an environment only what this class has.
        return cast("Environment", AcrossEngines(parts))
    except BaseException:
        for part in parts:
            part.close()
        raise


def with_one_engine(settings: TrainSettings) -> TrainSettings:
    """Return the settings with their engine, or the first of several."""
    if engines := several_engines(settings):
        return on_engine(settings, engines[0])
    names = settings.backend
    return settings if names is None or isinstance(names, str) else replace(settings, backend=names[0])
