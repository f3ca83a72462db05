"""``orbit data play``: recorded episodes again, on any engines, and how far that leads apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from rich.table import Table
from tyro.conf import Positional, UseAppendAction, arg

from orbit_core.cli.making import make_environment
from orbit_core.cli.output import console, new_table, write_json
from orbit_core.cli.settings import EnvironmentSettings, File, KeyValues, check_output, check_positive, parse_words
from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import ConfigurationError
from orbit_data.cli.read_budget import ReadSettings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from orbit_data.episodes import Dataset
    from orbit_data.replay import ReplayResult


@dataclass(frozen=True, kw_only=True)
class PlaySettings(ReadSettings):
    """Replay recorded episodes from the states that they began with, and measure how far that leads apart."""

    dataset: Annotated[Positional[Path], arg(metavar="DATASET")]
    """An HDF5 file that orbit record wrote."""
    backend: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME")] = ()
    """Engine to replay on; repeatable, and the one that it was recorded on if left out."""
    mode: Literal["actions", "states"] = "actions"
    """Whether actions are taken again, open loop, or states are set one after the other."""
    episodes: int = 16
    """How many of the dataset's first ones."""
    num_envs: int = 16
    """Environments stepped together."""
    device: Annotated[str, arg(metavar="NAME")] = "cpu"
    """Torch device that holds all state."""
    set: KeyValues = ()
    """A field of the task over those of the dataset."""
    json: File = None
    """Write the result here."""
    plot: File = None
    """Draw the distances over time here, as PNG."""
    video: File = None
    """Write an mp4 of the first four episodes here; of one engine."""
    overwrite: bool = False
    """Replace files of those names that are there already."""


def main(words: Sequence[str]) -> None:
    """Replay on each engine, print a table, and draw.

    Raises:
        OrbitError: of many kinds; each names the setting.
    """
    from orbit_data.formats import opened

    settings = parse_words(PlaySettings, words, "orbit data play")
    for path, suffix in ((settings.json, ".json"), (settings.plot, ".png"), (settings.video, ".mp4")):
        check_output(path, suffix, settings.overwrite)
    if settings.plot is not None:
        _figure_type()
    check_positive("episodes", settings.episodes)
    check_positive("num_envs", settings.num_envs)
    if settings.video is not None and len(settings.backend) > 1:
        raise ConfigurationError("a video shows one engine: name one --backend")
    with opened(settings.dataset, settings.budget) as dataset:
        if not dataset.episodes:
            raise ConfigurationError(f"{settings.dataset} holds no episodes")
        backends = settings.backend or (dataset.known().backend,)
        results = [_replayed(settings, dataset, name) for name in backends]
    console().print(_table(settings, results))
    write_json(settings.json, [_plain(result) for result in results])
    if settings.plot is not None:
        _draw(results, settings.plot)


def _replayed(settings: PlaySettings, dataset: Dataset, backend: str) -> ReplayResult:
    from orbit_data.replay import fields_of, replay

    manifest = dataset.known()
    count = min(settings.episodes, len(dataset.episodes))
    made = EnvironmentSettings(
        task=manifest.task,
        backend=backend,
        device=settings.device,
        seed=manifest.seed,
        set=settings.set,
        fields=fields_of(manifest),
    )
    environment = make_environment(made, min(settings.num_envs, count))
    try:
        if settings.video is None:
            return replay(environment, dataset, range(count), settings.mode)
        from orbit_core.rollout.video import VideoRecorder

        with VideoRecorder(environment, settings.video) as film:
            return replay(environment, dataset, range(count), settings.mode, film.before_step)
    finally:
        environment.close()


def _table(settings: PlaySettings, results: Sequence[ReplayResult]) -> Table:
    things = [*results[0].distances]
    last = [f"{name}, m apart in the end" for name in things]
    table = new_table("engine", "success", "recorded", *last, title=f"{settings.mode} of {settings.dataset}")
    for result in results:
        apart = [
            f"{values[-1, 1]:.4f} [{values[-1, 0]:.4f}, {values[-1, 2]:.4f}]" for values in result.distances.values()
        ]
        table.add_row(result.backend, result.success.percent(), result.recorded_success.percent(), *apart)
    return table


def _plain(result: ReplayResult) -> dict[str, Any]:
    return {
        "backend": result.backend,
        "recorded_on": list(result.recorded_on),
        "mode": result.mode,
        "success_rate": result.success.value,
        "recorded_success_rate": result.recorded_success.value,
        "times_s": result.times.tolist(),
        "distance_m_quartiles": {name: values.tolist() for name, values in result.distances.items()},
    }


def _figure_type() -> type[Figure]:
    """What plots are drawn on.

    Raises:
        ConfigurationError: it is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ConfigurationError(f"plots need matplotlib: {install_extra('plots')}") from error
    return Figure


def _draw(results: Sequence[ReplayResult], path: Path) -> None:
    """Median and quartiles of the distances, a panel a thing and a line an engine."""
    from orbit_core.files import written_whole

    things = [*results[0].distances]
    figure = _figure_type()(figsize=(5.0 * len(things), 3.6), layout="constrained")
    panels = figure.subplots(1, len(things), squeeze=False)
    for panel, thing in zip(panels[0], things, strict=True):
        for result in results:
            low, middle, high = result.distances[thing].T
            (line,) = panel.plot(result.times, middle, label=result.backend)
            panel.fill_between(result.times, low, high, color=line.get_color(), alpha=0.2)
        panel.set(title=thing, xlabel="s", ylabel="m from where it was recorded")
        panel.set_yscale("symlog", linthresh=1e-4)
        panel.grid(alpha=0.3)
    panels[0, 0].legend(title=f"{results[0].mode} of {', '.join(results[0].recorded_on)} on")
    with written_whole(path) as written:
        figure.savefig(written, dpi=120)
