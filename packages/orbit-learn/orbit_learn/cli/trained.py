"""Record of a training next to its policies, and the settings that playing a policy restores from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, Suppress, arg

from orbit_core.backends import backend_names, renderer_names
from orbit_core.cli.settings import Name, RunSettings
from orbit_core.configuration import Text, assignments
from orbit_core.envs.registry import task_entry
from orbit_core.files import read_bytes
from orbit_core.interfaces.errors import ConfigurationError
from orbit_data.reading.budget import MAX_DOCUMENT
from orbit_data.tensor_file import parse_json
from orbit_learn.cli.engines import of_engine

OF_TRAINING_ALONE = ("curriculum_enabled", "expert_starts")
"""Fields of a task that are only for learning: a curriculum would begin with the easiest episodes again, and a policy
is not measured from starts on an expert's way. Fields that a task sets in training are treated the same."""
_TASKS = "the task's own"
_RECORD = "training.json"


@dataclass(frozen=True, kw_only=True)
class PlaySettings(RunSettings):
    """Run a learned policy's task with it, on any backend, and report success, metrics, return and speed."""

    policy: Annotated[Positional[Path], arg(metavar="POLICY")]
    """File policy_<iteration>.safetensors or .onnx, the folder of a training (its last policy), or a kept policy's name
    ('orbit list policies')."""
    task: Name = None
    """Another task than the one it was learned for."""
    agent: Suppress[str] = ""
    """The policy."""


def training_record(path: Path) -> Mapping[str, Any]:
    """Read the record of a policy's training; empty if there is none.

    Args:
        path: path of the policy's file, or of its folder.

    Raises:
        ConfigurationError: the file is not a record of a training.
    """
    file = (path if path.is_dir() else path.parent) / _RECORD
    if not file.exists():
        return {}
    try:
        values = parse_json(read_bytes(file, MAX_DOCUMENT))
        if {"seed", "num_envs", "device"} <= values["settings"].keys() and isinstance(values["versions"], dict):
            return values
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        pass
    raise ConfigurationError(f"{file} describes no training")


@dataclass(frozen=True)
class Restored:
    """Settings that play a policy as it was learned, and a line for each difference."""

    settings: PlaySettings
    """Settings of ``orbit play``, with those of training filled in."""
    differences: tuple[str, ...]
    """Fields that were set otherwise than in training, a line each."""


def restore(settings: PlaySettings, record: Mapping[str, Any], task: str) -> Restored:
    """Complete settings by those of a training.

    Args:
        settings: settings of playing; these take precedence.
        record: settings of the training, from ``training.json``.
        task: task that is played.
    """
    if not record:
        return Restored(settings, ())
    if record["task"] != task:
        return Restored(settings, (f"task {task} in place of {record['task']}, whose fields are not restored",))
    fields, differences = _fields(record, task)
    chosen = {**settings.fields, **assignments(settings.set, f"task {task}")}
    differences += [
        f"{name} = {_told(value)} in place of {_told(fields.get(name, _TASKS))}"
        for name, value in chosen.items()
        if name not in fields or _told(value) != _told(fields[name])
    ]
    cameras = settings.cameras or tuple(record.get("cameras", ()))
    if cameras != tuple(record.get("cameras", ())):
        differences.append(f"cameras {_told(cameras)} in place of {_told(record.get('cameras') or _TASKS)}")
    played = replace(settings, fields={**fields, **settings.fields}, cameras=cameras)
    record = _of_one_engine(record, settings.backend)
    for name, installed in (("backend", backend_names()), ("renderer", renderer_names()), ("matter", None)):
        learned, own = record.get(name), getattr(settings, name)
        # A backend that is not installed here is left open, so that the policy can still be played on another.
        if own is None and learned is not None and (installed is None or learned in installed):
            played, own = replace(played, **{name: learned}), learned
        # Options of a backend are called --setting, those of others --renderer-setting and --matter-setting.
        words, table = ("setting", "settings") if name == "backend" else (f"{name}_setting", f"{name}_settings")
        # Settings belong to one backend: they are restored only with it.
        given = {**record.get(table, {}), **assignments(record.get(words, ()), name, "setting")}
        if own == learned:
            played = replace(played, **{table: {**given, **getattr(settings, table)}})
        elif learned is not None or own is not None:
            lost = f", without its settings ({', '.join(given)})" if given else ""
            differences.append(f"{name} {own or 'left open'} in place of {learned or 'the backend itself'}{lost}")
    return Restored(played, tuple(differences))


def _of_one_engine(record: Mapping[str, Any], engine: str | None) -> Mapping[str, Any]:
    """Return the record of a training across engines as that of a training on one.

    Args:
        record: settings of the training.
        engine: on which it is played; the first that is installed if None, or if it did not learn there.
    """
    engines = record.get("backend")
    if not isinstance(engines, list):
        return record
    known = [name for name in engines if name in backend_names()]
    chosen = engine if engine in engines else next(iter(known), engines[0])
    words, table = of_engine(record.get("setting", ()), record.get("settings", {}), str(chosen), engines)
    return {**record, "backend": chosen, "setting": words, "settings": table}


def _fields(record: Mapping[str, Any], task: str) -> tuple[dict[str, Any], list[str]]:
    """Return the fields that a training set, less those of training alone, and a line for each of these."""
    words, table = assignments(record.get("set", ()), f"task {task}"), record.get("fields", {})
    by_itself = task_entry(task).task_type().metadata.training
    alone = {
        name
        for name, value in {**table, **words}.items()
        if name in OF_TRAINING_ALONE or (name not in words and name in by_itself and by_itself[name] == value)
    }
    # Words of --set override fields, in training as here.
    fields = {name: value for name, value in {**table, **words}.items() if name not in alone}
    lines = [
        f"{name} = {_told({**table, **words}[name])} left out, because it belongs to training" for name in sorted(alone)
    ]
    return fields, lines


def _told(value: Any) -> str:
    if isinstance(value, Text):
        return value.text
    return str(value).lower() if isinstance(value, bool) else str(value)
