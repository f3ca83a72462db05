"""Card of a dataset: its contents, on a page for people."""

from __future__ import annotations

import statistics
from collections import Counter
from contextlib import suppress
from pathlib import Path

from orbit_core.files import as_path, written_whole
from orbit_core.interfaces import ConfigurationError
from orbit_core.rollout.estimates import proportion
from orbit_data.episodes import Dataset
from orbit_data.reading.budget import TRUSTED

CARD = "README.md"
"""Name of the card of a dataset that is a folder."""
# Lines after a card's title.
_HEAD = ("", "| | |", "|---|---|")


def card(dataset: Dataset) -> str:
    """Return Markdown: task, robot, engine, versions, success, lengths, arrays with their shapes and units."""
    lines = [f"# {dataset.path.stem}", *_HEAD, *(f"| {n} | {v} |" for n, v in facts(dataset).items())]
    if dataset.episodes:
        lines += ["", "| array | shape, of a step | type | unit |", "|---|---|---|---|"]
        lines += [f"| `{name}` | {shape} | {kind} | {unit} |" for name, shape, kind, unit in arrays(dataset)]
    return "\n".join((*lines, ""))


def facts(dataset: Dataset) -> dict[str, str]:
    """Return facts about a dataset by name: task, robot, engine, success and more."""
    episodes, manifest = dataset.episodes, dataset.manifest
    values = {"episodes": f"{len(episodes):,}", "steps": f"{sum(info.length for info in episodes):,}"}
    lengths = [info.length for info in episodes]
    if lengths:
        values["length"] = f"{min(lengths)} to {max(lengths)} steps, {statistics.mean(lengths):.0f} in the mean"
    # Imported episodes often have no label, and count neither as success nor as failure.
    labels = [info.success for info in episodes if info.success is not None]
    if labels:
        values["success"] = proportion(sum(labels), len(labels)).percent()
    for name in episodes[0].metrics if episodes else ():
        values[name] = f"{statistics.mean(info.metrics[name] for info in episodes if name in info.metrics):.4g}"
    engines = Counter(info.backend for info in episodes if info.backend)
    values["recorded on"] = ", ".join(f"{name} ({count:,})" for name, count in engines.items()) or "unknown"
    if manifest is not None:
        agents = {name: robot.model for name, robot in manifest.robots.items() if robot.agent}
        values |= {
            "task": manifest.task,
            "robot": ", ".join(agents.values()),
            "action": ", ".join(f"{n} ({len(term.components)})" for n, term in manifest.action_terms.items()),
            "rate": f"{1.0 / manifest.step_dt:g} Hz",
            "matter": manifest.matter or "none",
            **({"shown by a person with": manifest.input_device} if manifest.input_device else {}),
            "seed": str(manifest.seed),
            "versions": ", ".join(f"{name} {version}" for name, version in manifest.versions.items()),
        }
    values |= {f"subset {name}": f"{len(positions):,} episodes" for name, positions in dataset.masks.items()}
    return values


def arrays(dataset: Dataset) -> list[tuple[str, str, str, str]]:
    """Return name, shape of a step's row, type and unit of each array in the first episode."""
    units: dict[str, str] = {}
    groups = dataset.manifest.observations if dataset.manifest else {}
    for group, layout in groups.items():
        prefix = "" if group == "policy" else f"{group}/"
        units |= {prefix + name: term.unit for name, term in layout.terms.items()}
    rows: list[tuple[str, str, str, str]] = []
    # The first episode is an example of all.
    for name, array in dataset.read(0).arrays.items():
        shape = array.shape if name.startswith("initial/") else array.shape[1:]
        unit = units.get(name.partition("/")[2], "") if name.startswith(("obs/", "next_obs/")) else _UNITS.get(name, "")
        text = " x ".join(map(str, shape)) or "1"
        rows.append((name, text, str(array.dtype), _UNITS["poses"] if name.startswith("poses/") else unit))
    return rows


_UNITS = {"actions": "[-1, 1]", "states": "SI", "poses": "m, quaternion (w, x, y, z)"}


def is_card(path: Path) -> bool:
    """Return True if a file is the card of a dataset, by its first lines."""
    # The first lines suffice, and a limit of characters keeps a large file from being read.
    with suppress(OSError, ValueError), path.open(encoding="utf-8") as file:
        title, *head = (file.readline(1000).rstrip("\n") for _ in range(1 + len(_HEAD)))
        return title.startswith("# ") and tuple(head) == _HEAD
    return False


def check_card(path: Path) -> None:
    """Reject the path of a dataset's file next to which another file has the name of the card.

    Raises:
        ConfigurationError: such a file exists; the message names it.
    """
    place = path.with_suffix(".md")
    # A link counts even if it leads nowhere: writing the card would replace it.
    if (place.exists() or place.is_symlink()) and not is_card(place):
        raise ConfigurationError(
            f"{place} is in the place of the card of {path} and is not a card of a dataset: choose another name, or "
            "move the file away first"
        )


def write_card(path: Path | str) -> Path:
    """Write the card of a dataset's file next to it.

    Raises:
        ConfigurationError: the file's name is taken by a file that is not a card.
        StorageError: the disk is full, or the folder cannot be written.
    """
    from orbit_data.hdf5 import Hdf5Dataset

    path = as_path(path)
    check_card(path)
    dataset = Hdf5Dataset(path, TRUSTED)
    try:
        text = card(dataset)
    finally:
        dataset.close()
    place = path.with_suffix(".md")
    with written_whole(place) as written:
        written.write_text(text, encoding="utf-8")
    return place
