"""``orbit train``: learn a task with a library of the user's choice."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from rich.table import Table
from tyro.conf import UseAppendAction, arg

from orbit_core.backends import versions_of
from orbit_core.cli.making import configured_task
from orbit_core.cli.output import console, new_table, progress_bar
from orbit_core.cli.settings import EnvironmentSettings, File, KeyValues, check_positive, parse_settings
from orbit_core.configuration import assignments, configured
from orbit_core.envs.registry import task_entry
from orbit_core.interfaces.errors import ConfigurationError
from orbit_learn.cli.engines import engines_of, environment_on, of_engine

if TYPE_CHECKING:
    from orbit_core.envs.task import TaskMetadata
    from orbit_learn.trainer import Progress, Trainer
    from orbit_learn.training import Training
    from orbit_learn.training_films import TrainingFilms


# Settings of off-policy learning that only one algorithm reads
_ONLY_OF = {"noise": "td3", "temperature": "sac", "target_entropy": "sac"}


@dataclass(frozen=True, kw_only=True)
class TrainSettings(EnvironmentSettings):
    """Learn a task."""

    backend: Annotated[str | tuple[str, ...] | None, arg(metavar="NAME")] = None  # pyright: ignore[reportIncompatibleVariableOverride]
    """Physics backend ('orbit list backends'), or several, which divide the environments; may be left out if only one
    is installed. A --setting is then ENGINE.KEY=VALUE."""
    num_envs: int = 64
    """Environments stepped together, in each process if torchrun starts several."""
    library: Annotated[str | None, arg(metavar="NAME")] = None
    """Learning library ('orbit list libraries'): rsl-rl if left out, or the one that has the algorithm; distill
    imitates a teacher, imitation clones demonstrations."""
    algorithm: Annotated[str | None, arg(metavar="NAME")] = None
    """Algorithm: sac, td3 or ppo for orbit and sb3; bc, bc-gmm, bc-rnn, bc-rnn-gmm, act or diffusion for imitation;
    other libraries have ppo."""
    dataset: Annotated[UseAppendAction[tuple[Path, ...]], arg(metavar="FILE")] = ()
    """Demonstrations, for imitation ('orbit record' makes them); repeatable."""
    teacher: Annotated[str | None, arg(metavar="POLICY")] = None
    """Teacher for distill, and for imitation one who corrects the policy as it learns (DAgger): a kept policy's name
    ('orbit list policies'), a policy's file, a training's folder, or expert, the task's own."""
    iterations: Annotated[int | None, arg(metavar="INT")] = None
    """Total iterations of collecting and learning; the task's own number if left out."""
    ppo: KeyValues = ()
    """A setting of the algorithm, such as learning_rate=3e-4 ('orbit info TASK')."""
    distillation: KeyValues = ()
    """A setting of library distill, such as batch_size=1024."""
    imitation: KeyValues = ()
    """A setting of library imitation, such as chunk=16."""
    off_policy: KeyValues = ()
    """A setting of sac and td3, such as updates_per_step=4."""
    wandb: Annotated[str | None, arg(metavar="PROJECT")] = None
    """Project of Weights & Biases that takes the curve too; WANDB_MODE=offline keeps it on this machine."""
    trackio: Annotated[str | None, arg(metavar="PROJECT")] = None
    """Project of Trackio, on this machine, that takes the curve too ('trackio show' shows it)."""
    diverged: Literal["reset", "stop"] = "reset"
    """Reaction to environments whose simulation diverges: they begin new episodes and are counted, unless one in a
    hundred does in an iteration; or the training ends."""
    save_every: int = 100
    """Iterations between checkpoints."""
    videos: bool = False
    """Film an episode of each policy that is written with a checkpoint, into the folder's videos/."""
    output: File = None
    """Folder of this training; out/train/<task>-<time> if left out."""
    resume: File = None
    """Folder of a training to continue; give the same task and settings."""


def main(words: Sequence[str]) -> None:
    """Train, with a progress bar, and print where the policy is."""
    settings = parse_settings(TrainSettings, words, "orbit train")
    train(settings)


def train(settings: TrainSettings) -> Path:
    """Train by settings, and return the folder.

    Raises:
        OrbitError: of many kinds; each names the setting.
    """
    from orbit_learn.across import parts_of
    from orbit_learn.processes import part, started
    from orbit_learn.trackers import TrackioLog, WandbLog
    from orbit_learn.training import Training, check_new

    check_positive("num_envs", settings.num_envs)
    check_positive("save_every", settings.save_every)
    if settings.output is not None and settings.resume is not None:
        raise ConfigurationError("a training resumes in its own folder: leave --output out")
    # The rank before the folder: only one process may check and write it.
    settings, leader = _ranked(for_training(settings))
    if leader and settings.output is not None:
        check_new(settings.output)
    settings, make_trainer = _library(settings)
    if started() > 1 and not make_trainer.several_gpus:
        raise ConfigurationError(
            f"library '{settings.library}' trains in one process: for several, use --library rsl-rl, or "
            "--library orbit --algorithm ppo"
        )
    each = _on_each_engine(settings)
    if len(each) == 1:
        settings = each[0]  # of which a record of training reads as it always has
    environment = environment_on(each, settings.num_envs, settings.diverged == "reset")
    try:
        chosen = _algorithm(settings, make_trainer, environment.task.metadata)
        folder = settings.resume or settings.output or _new_folder(settings)
        record = {
            "settings": asdict(settings),
            "versions": versions_of(*(part.world.backend for part in parts_of(environment))),
        }
        trainer = make_trainer(environment, chosen, folder, settings.seed)
        training = Training(trainer, settings.task or "", record, leader)
        with contextlib.ExitStack() as opened:
            opened.callback(trainer.close)
            watchers: list[Callable[[Progress], None]] = []
            for tracker, project in ((WandbLog, settings.wandb), (TrackioLog, settings.trackio)):
                if project is not None and leader:
                    log = opened.enter_context(contextlib.closing(tracker(project, folder, record)))
                    watchers.append(log.add)
            if settings.videos and leader:
                from orbit_learn.training_films import TrainingFilms

                films = opened.enter_context(contextlib.closing(TrainingFilms(each[0], Path(folder))))
                watchers.append(_film_saved(films, training))
            last = _run(training, chosen.iterations, settings, watchers)
    finally:
        environment.close()
        part()
    if last is not None:
        console().print(_table(settings, last, folder))
    return folder


def _on_each_engine(settings: TrainSettings) -> list[TrainSettings]:
    """Return the settings on each of the engines, with its own."""
    names = engines_of(settings.backend)
    if len(names) < 2:
        return [dataclasses.replace(settings, backend=next(iter(names), None))]
    found: list[TrainSettings] = []
    for name in names:
        words, table = of_engine(settings.setting, settings.settings, name, names)
        found.append(dataclasses.replace(settings, backend=name, setting=words, settings=table))
    return found


def check_training(settings: TrainSettings) -> None:
    """Check the task's fields and the algorithm's settings, without an environment.

    Raises:
        OrbitError: of many kinds; each names the setting.
    """
    check_positive("num_envs", settings.num_envs)
    check_positive("save_every", settings.save_every)
    settings, make_trainer = _library(for_training(settings))
    _algorithm(settings, make_trainer, configured_task(settings).metadata)


def _library(settings: TrainSettings) -> tuple[TrainSettings, type[Trainer[Any]]]:
    """Return the settings with their library, and the class of its trainers."""
    from orbit_learn.learners import library_for, trainer_type

    library = settings.library or library_for(settings.algorithm)
    make_trainer = trainer_type(library, settings.algorithm)
    engines = engines_of(settings.backend)
    if len(engines) > 1 and not make_trainer.several_engines:
        raise ConfigurationError(
            f"library '{library}' learns on one engine: for {', '.join(engines)} together, use --library distill, or "
            "--library orbit --algorithm ppo"
        )
    algorithm = settings.algorithm
    if algorithm == "ppo" and "algorithm" not in make_trainer.options:
        algorithm = None  # these libraries have no other
    return dataclasses.replace(settings, library=library, algorithm=algorithm), make_trainer


def _film_saved(films: TrainingFilms, training: Training) -> Callable[[Progress], None]:
    """Return a function that films the policy of an iteration that has written one."""

    def film(progress: Progress) -> None:
        if (policy := training.policy_file(progress.iteration)).exists():
            films.film(policy)

    return film


def _run(
    training: Training, iterations: int, settings: TrainSettings, watchers: Sequence[Callable[[Progress], None]]
) -> Progress | None:
    """Train under a progress bar, and return the last progress; None in processes that do not lead."""
    from orbit_learn.curves import sparkline

    last: list[Progress] = []  # a list, because the inner function assigns to it
    rates: list[float] = []
    returns: list[float] = []
    with progress_bar() as bar:
        line = bar.add_task(f"{settings.task}", total=iterations, visible=training.leader)

        def show(progress: Progress) -> None:
            last[:] = [progress]
            for watch in watchers:
                watch(progress)
            rates.append(progress.success_rate)
            returns.append(progress.episode_return)
            words = f"{_words(settings, progress)} {sparkline(rates) or sparkline(returns)}"
            bar.update(line, completed=progress.iteration + 1, description=words)

        try:
            training.run(iterations, settings.save_every, show, settings.resume is not None)
        except KeyboardInterrupt:
            if training.leader:
                console().print(_left(training), soft_wrap=True)
            raise
    return last[0] if last else None


def for_training(settings: TrainSettings) -> TrainSettings:
    """Add the fields that the task sets in training; the user's own take precedence."""
    if settings.task is None:
        return settings
    # In this order, so that the user's words win.
    fields = {**task_entry(settings.task).task_type().metadata.training, **settings.fields}
    return dataclasses.replace(settings, fields=fields)


def _ranked(settings: TrainSettings) -> tuple[TrainSettings, bool]:
    """Give each process of torchrun its own GPU and seed, and return whether this process leads."""
    from orbit_learn.processes import rank, started

    local = os.environ.get("LOCAL_RANK")
    if local is None or started() == 1:
        return settings, True
    # The CPU is shared: each process takes the cores that it is given.
    device = f"cuda:{local}" if settings.device.startswith("cuda") else settings.device
    # Seeds are far apart, so that no process repeats another's random streams.
    return dataclasses.replace(settings, device=device, seed=settings.seed + 1000 * rank()), rank() == 0


def _algorithm(settings: TrainSettings, trainer: type[Trainer[Any]], metadata: TaskMetadata) -> Any:
    """Return the library's settings: the task's own, or the class's defaults, overridden by the user's.

    Raises:
        ConfigurationError: an option is of another library.
    """
    kind = trainer.settings_type
    for option in ("ppo", "distillation", "teacher", "imitation", "off_policy", "algorithm", "dataset"):
        if getattr(settings, option) and option not in trainer.options:
            raise ConfigurationError(f"library '{settings.library}' takes no --{option.replace('_', '-')}")
    # The first option takes KEY=VALUE words, the others are fields by themselves.
    words, *single = trainer.options
    presets = (metadata.ppo, metadata.off_policy)
    defaults = next((preset for preset in presets if isinstance(preset, kind)), None) or kind()
    values: dict[str, Any] = dict(assignments(getattr(settings, words), words, "algorithm setting"))
    for name in values.keys() & _ONLY_OF.keys() if words == "off_policy" else ():
        if settings.algorithm not in (None, _ONLY_OF[name]):
            raise ConfigurationError(f"algorithm '{settings.algorithm}' has no {name}, a setting of {_ONLY_OF[name]}")
    for option in single:
        if given := getattr(settings, option):
            values[option] = given
    if values.get("dataset"):
        values["dataset"] = tuple(str(path) for path in values["dataset"])
    if settings.iterations is not None:
        values["iterations"] = settings.iterations
    chosen = configured(defaults, values, words, "algorithm setting")
    check_positive("iterations", chosen.iterations)
    return chosen


def _new_folder(settings: TrainSettings) -> Path:
    return Path("out/train") / f"{settings.task}-{time.strftime('%Y%m%d-%H%M%S')}"


def _words(settings: TrainSettings, progress: Progress) -> str:
    rate = progress.env_steps / progress.seconds
    success = "" if math.isnan(progress.success_rate) else f", success {_success(progress)}"
    diverged = f", {progress.diverged} diverged" if progress.diverged else ""
    return f"{settings.task}: {rate:,.0f} steps/s, return {progress.episode_return:.2f}{success}{diverged}"


def _success(progress: Progress) -> str:
    """Return the rate with its interval of 95 %."""
    from orbit_core.rollout.estimates import proportion

    return proportion(round(progress.success_rate * progress.episodes), progress.episodes).percent()


def _left(training: Training) -> str:
    """Describe what an interrupted training has written."""
    if training.saved is None:
        return "interrupted before the first iteration ended: there is no checkpoint"
    folder = training.trainer.folder
    return f"interrupted: {training.saved} is written; --resume {folder} continues it, with the same task and settings"


def _table(settings: TrainSettings, last: Progress, folder: Path) -> Table:
    table = new_table("", "value", title=f"{settings.task} learned with {settings.library}")
    table.add_row("environment steps", f"{last.env_steps:,}")
    table.add_row("environment steps per second, learning included", f"{last.env_steps / last.seconds:,.0f}")
    table.add_row("time of collecting and learning", f"{last.seconds:.1f} s")
    ended = not math.isnan(last.episode_return)
    table.add_row("return of the last episodes", f"{last.episode_return:.3f}" if ended else "none has ended")
    if not math.isnan(last.success_rate):
        table.add_row("success of the last episodes, exploring", f"{_success(last)} of {last.episodes}")
    for name, rate in last.engines.items():
        table.add_row(f"of them on {name}", f"{rate:.2f}")
    if last.diverged:
        table.add_row("episodes that diverged, and were replaced", f"{last.diverged:,}")
    if not math.isnan(last.loss):
        table.add_row("mean loss of the last iteration", f"{last.loss:.5f}")
    table.add_row("play it", f"orbit play {folder}")
    return table
