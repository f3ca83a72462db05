"""``orbit data``: describe, convert, merge, split and replay datasets."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from rich.table import Table
from tyro.conf import Positional, UseAppendAction, arg

from orbit_core.cli.making import make_environment
from orbit_core.cli.output import console, new_table, write_json
from orbit_core.cli.settings import (
    EnvironmentSettings,
    File,
    KeyValues,
    check_output,
    check_positive,
    make_folder,
    parse_words,
)
from orbit_core.files import check_apart
from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError
from orbit_data.cli.read_budget import ReadSettings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from orbit_data.episodes import Dataset
    from orbit_data.reading.budget import ReadBudget
    from orbit_data.replay import ReplayResult


@dataclass(frozen=True, kw_only=True)
class PlaySettings(ReadSettings):
    """Replay recorded episodes from their initial states, and measure how far they deviate."""

    dataset: Annotated[Positional[Path], arg(metavar="DATASET")]
    """An HDF5 file that orbit record wrote."""
    backend: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME")] = ()
    """Engine to replay on; repeatable, and the one that it was recorded on if left out."""
    mode: Literal["actions", "states"] = "actions"
    """Whether actions are repeated, open loop, or states are set one after the other."""
    episodes: int = 16
    """Number of episodes, from the dataset's first one on."""
    num_envs: int = 16
    """Environments stepped together."""
    device: Annotated[str, arg(metavar="NAME")] = "cpu"
    """Torch device that holds all state."""
    set: KeyValues = ()
    """A field of the task that overrides the dataset's."""
    json: File = None
    """Write the result here."""
    plot: File = None
    """Draw the distances over time here, as PNG."""
    video: File = None
    """Write an mp4 of the first four episodes here; only for one engine."""
    overwrite: bool = False
    """Replace existing files of those names."""


def play(words: Sequence[str]) -> None:
    """Replay on each engine, print a table, and draw.

    Raises:
        OrbitError: of many kinds; each names the setting.
    """
    from orbit_data.formats import opened

    settings = parse_words(PlaySettings, words, "orbit data play")
    for path, suffix in ((settings.json, ".json"), (settings.plot, ".png"), (settings.video, ".mp4")):
        check_output(path, suffix, settings.overwrite)
    if settings.plot is not None:
        _figure_type()  # now: a missing matplotlib would otherwise be noticed after the replay
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
        from orbit_core.rollout.pictures import video_recorder

        with video_recorder(environment, settings.video) as film:
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
    """Return matplotlib's figure type.

    Raises:
        ConfigurationError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ConfigurationError(f"plots need matplotlib: {install_extra('plots')}") from error
    return Figure


def _draw(results: Sequence[ReplayResult], path: Path) -> None:
    """Draw median and quartiles of the distances, with a panel for each object and a line for each engine."""
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
        # Linear around zero, where distances begin, and logarithmic above, where they span powers of ten.
        panel.set_yscale("symlog", linthresh=1e-4)
        panel.grid(alpha=0.3)
    panels[0, 0].legend(title=f"{results[0].mode} of {', '.join(results[0].recorded_on)} on")
    with written_whole(path) as written:
        figure.savefig(written, dpi=120)


Source = Annotated[Positional[Path], arg(metavar="DATASET")]
_HDF5 = (".hdf5", ".h5")


@dataclass(frozen=True, kw_only=True)
class InfoSettings(ReadSettings):
    """Show what a dataset contains: task, robot, engine, versions, success, lengths, arrays."""

    dataset: Source
    """An HDF5 file in robomimic's layout, a folder in LeRobot's, or a Zarr replay buffer."""
    card: Annotated[Path | None, arg(metavar="FILE")] = None
    """Write it here as Markdown."""
    overwrite: bool = False
    """Replace the card that is there already."""


@dataclass(frozen=True, kw_only=True)
class _Written(ReadSettings):
    """Options of commands that write a dataset."""

    output: Annotated[Path, arg(metavar="PATH")]
    """HDF5 where the name ends in .hdf5, else a folder in LeRobot's layout."""
    compression: Literal["gzip", "lzf"] | None = None
    """Compression of all arrays of an HDF5 file; if left out, only pictures are compressed, by lzf."""
    rate: float | None = None
    """Steps per second, for LeRobot, if the dataset does not state them."""
    overwrite: bool = False
    """Replace an existing dataset once the new one is complete."""


@dataclass(frozen=True, kw_only=True)
class ConvertSettings(_Written):
    """Write a dataset in another format, or with another compression."""

    dataset: Source
    """An HDF5 file in robomimic's layout, a folder in LeRobot's, or a Zarr replay buffer."""


@dataclass(frozen=True, kw_only=True)
class MergeSettings(_Written):
    """Put datasets of one robot and action together."""

    datasets: Annotated[Positional[tuple[Path, ...]], arg(metavar="DATASET")]
    """HDF5 files, folders of LeRobot's, or Zarr replay buffers."""
    shared: bool = False
    """Put datasets of several tasks together: keep what all of them have alike of what the policy sees, and label each
    episode with its task's words."""


@dataclass(frozen=True, kw_only=True)
class FilterSettings(ConvertSettings):
    """Keep the episodes of a dataset that meet all given conditions."""

    success: bool = False
    """Those that reached the goal."""
    subset: str | None = None
    """Those of a subset, such as train."""
    least_return: float | None = None
    """Those whose rewards sum to this at least."""
    most_steps: int | None = None
    """Those no longer than this."""
    first: int | None = None
    """The first so many of those that are left."""


@dataclass(frozen=True, kw_only=True)
class SplitSettings(ReadSettings):
    """Divide an HDF5 dataset into the subsets train and valid, which robomimic calls filter keys."""

    dataset: Source
    """An HDF5 file in robomimic's layout; it is replaced."""
    valid: float = 0.1
    """Share of the episodes that validation gets."""
    seed: int = 0
    """Seed of the random choice."""


@dataclass(frozen=True, kw_only=True)
class ShowSettings(ReadSettings):
    """Write episodes as a recording for a viewer: Foxglove's MCAP or Rerun's RRD."""

    dataset: Source
    """An HDF5 file or a folder of LeRobot's that ORBIT recorded."""
    output: Annotated[Path, arg(metavar="FILE")]
    """Ends in .mcap for Foxglove, in .rrd for Rerun."""
    first: int = 4
    """Number of episodes, from the dataset's first one on."""
    overwrite: bool = False
    """Replace an existing file."""


def main(words: Sequence[str]) -> None:
    """Run one of the commands on datasets.

    Raises:
        UnknownNameError: the command does not exist.
    """
    if not words or words[0] in ("-h", "--help"):
        listed = "\n".join(f"  {name:<8} {about}" for name, (_, about) in _COMMANDS.items())
        print(
            f"usage: orbit data COMMAND ...\n\n{listed}\n\n'orbit data COMMAND --help' describes a command's options."
        )
        return
    if words[0] not in _COMMANDS:
        raise UnknownNameError("command of orbit data", words[0], _COMMANDS)
    _COMMANDS[words[0]][0](words[1:])


def _info(words: Sequence[str]) -> None:
    from orbit_core.files import written_whole
    from orbit_data.card import arrays, card, facts
    from orbit_data.formats import opened

    settings = parse_words(InfoSettings, words, "orbit data info")
    check_output(settings.card, ".md", settings.overwrite)
    with opened(settings.dataset, settings.budget) as dataset:
        table = new_table("", "value", title=str(settings.dataset))
        for name, value in facts(dataset).items():
            table.add_row(name, value)
        console().print(table)
        if dataset.episodes:
            table = new_table("array", "shape, of a step", "type", "unit")
            for row in arrays(dataset):
                table.add_row(*row)
            console().print(table)
        if settings.card is not None:
            with written_whole(settings.card) as written:
                written.write_text(card(dataset), encoding="utf-8")


def _convert(words: Sequence[str]) -> None:
    settings = parse_words(ConvertSettings, words, "orbit data convert")
    with _opened((settings.dataset,), settings.budget) as (dataset,):
        _write(settings, (dataset,), [*range(len(dataset.episodes))])


def _merge(words: Sequence[str]) -> None:
    settings = parse_words(MergeSettings, words, "orbit data merge")
    if len(settings.datasets) < 2:
        raise ConfigurationError("name at least two datasets: orbit data merge ONE OTHER --output BOTH")
    with _opened(settings.datasets, settings.budget) as datasets:
        _write(settings, datasets, None)


def _filter(words: Sequence[str]) -> None:
    settings = parse_words(FilterSettings, words, "orbit data filter")
    for name in ("first", "most_steps"):
        if (value := getattr(settings, name)) is not None:
            check_positive(name, value)
    with _opened((settings.dataset,), settings.budget) as (dataset,):
        positions = _wanted(settings, dataset)
        if not positions:
            raise ConfigurationError(f"no episode of {settings.dataset} meets the conditions: relax them")
        _write(settings, (dataset,), positions)


def _show(words: Sequence[str]) -> None:
    from orbit_data.viewing import SUFFIXES, write_for_viewer

    settings = parse_words(ShowSettings, words, "orbit data show")
    check_positive("first", settings.first)
    output = settings.output
    make_folder(output)
    check_output(output, output.suffix if output.suffix in SUFFIXES else " or ".join(SUFFIXES), settings.overwrite)
    with _opened((settings.dataset,), settings.budget) as (dataset,):
        episodes = map(dataset.read, range(min(settings.first, len(dataset.episodes))))
        left_out = write_for_viewer(output, episodes, dataset.known())
    console().print(f"{output} is written", soft_wrap=True)
    if left_out:
        console().print(f"not shown: {', '.join(sorted(left_out))}", soft_wrap=True)


def _split(words: Sequence[str]) -> None:
    from orbit_data.formats import check_target, divided, write_dataset

    settings = parse_words(SplitSettings, words, "orbit data split")
    if settings.seed < 0:
        raise ConfigurationError(f"seed must not be below zero, but is {settings.seed}")
    if settings.dataset.suffix not in _HDF5:
        raise ConfigurationError(f"{settings.dataset} has no place for subsets: convert it to HDF5 first")
    check_target(settings.dataset)
    with _opened((settings.dataset,), settings.budget) as (dataset,):
        masks = {**dataset.masks, **divided(len(dataset.episodes), settings.valid, settings.seed)}
        episodes = map(dataset.read, range(len(dataset.episodes)))
        write_dataset(settings.dataset.resolve(), episodes, dataset.manifest, masks=masks)
    sizes = ", ".join(f"{name} {len(masks[name])}" for name in ("train", "valid"))
    console().print(f"{settings.dataset}: {sizes} episodes", soft_wrap=True)


_COMMANDS: dict[str, tuple[Callable[[Sequence[str]], None], str]] = {
    "info": (_info, "Show what a dataset contains"),
    "convert": (_convert, "Write it in another format: HDF5 as robomimic's, or LeRobot's"),
    "show": (_show, "Write episodes for a viewer: MCAP for Foxglove, RRD for Rerun"),
    "play": (play, "Replay its episodes on any engine, and measure how far they deviate"),
    "merge": (_merge, "Put datasets together"),
    "filter": (_filter, "Keep the episodes that meet conditions"),
    "split": (_split, "Divide it into training and validation"),
}


@contextmanager
def _opened(paths: Sequence[Path], budget: ReadBudget) -> Iterator[list[Dataset]]:
    from orbit_data.formats import opened

    with ExitStack() as stack:
        yield [stack.enter_context(opened(path, budget)) for path in paths]


def _write(settings: _Written, datasets: Sequence[Dataset], positions: Sequence[int] | None) -> None:
    """Write the episodes of several datasets, or some of one, to a new place."""
    from orbit_data.formats import (
        check_target,
        common_manifest,
        read_all,
        read_shared,
        shared_manifest,
        write_dataset,
    )
    from orbit_data.recording import RecordingFile

    output = settings.output
    if settings.rate is not None and not 0.0 < settings.rate < math.inf:
        raise ConfigurationError(f"rate must be above zero and finite, not {settings.rate:g}")
    if output.exists() and not settings.overwrite:
        raise ConfigurationError(f"{output} is there already: give another name, or --overwrite")
    # Datasets are read while the output is written, so that neither may be within the other.
    check_apart(output, [dataset.path for dataset in datasets])
    check_target(output)
    RecordingFile(output).check_none()
    shared = isinstance(settings, MergeSettings) and settings.shared
    manifest = shared_manifest(datasets) if shared else common_manifest(datasets)
    make_folder(output)
    (first, *_) = datasets
    if shared and manifest is not None:
        episodes = read_shared(datasets, manifest)
    else:
        episodes = read_all(datasets) if positions is None else map(first.read, positions)
    # Merged datasets have no common subsets.
    masks = None if positions is None or output.suffix not in _HDF5 else _moved(first, positions)
    left_out = write_dataset(output, episodes, manifest, settings.rate, masks, settings.compression)
    console().print(f"{output} is written", soft_wrap=True)
    if left_out:
        console().print(f"not held: {', '.join(sorted(left_out))}", soft_wrap=True)


def _moved(dataset: Dataset, positions: Sequence[int]) -> dict[str, list[int]]:
    """Return the subsets of a dataset, by the places that the chosen positions get."""
    places = {position: place for place, position in enumerate(positions)}
    return {name: [places[p] for p in listed if p in places] for name, listed in dataset.masks.items()}


def _wanted(settings: FilterSettings, dataset: Dataset) -> list[int]:
    """Return the positions of the episodes that meet the conditions."""
    if settings.subset is not None and settings.subset not in dataset.masks:
        raise UnknownNameError("subset", settings.subset, dataset.masks, str(dataset.path))
    tests = {
        "success": lambda info: bool(info.success),
        "least_return": lambda info: info.episode_return >= settings.least_return,
        "most_steps": lambda info: info.length <= settings.most_steps,
    }
    asked = [test for name, test in tests.items() if getattr(settings, name) not in (None, False)]
    positions = range(len(dataset.episodes)) if settings.subset is None else dataset.masks[settings.subset]
    found = [place for place in positions if all(test(dataset.episodes[place]) for test in asked)]
    return found if settings.first is None else found[: settings.first]
