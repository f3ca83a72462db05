"""``orbit record``: a task's episodes as a dataset of demonstrations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import UseAppendAction, arg

from orbit_core.cli.making import check_actor, make_actor, make_environment
from orbit_core.cli.output import console, new_table, progress_bar
from orbit_core.cli.settings import EnvironmentSettings, check_output, check_positive, make_folder, parse_settings
from orbit_core.interfaces.errors import OrbitError

SUFFIX = ".hdf5"


@dataclass(frozen=True, kw_only=True)
class RecordSettings(EnvironmentSettings):
    """Record a task's episodes, by a scripted expert or a policy, as a dataset of demonstrations."""

    num_envs: int = 64
    """Environments stepped together."""
    episodes: int = 100
    """Episodes in the dataset, divided evenly over the environments, so that short ones are not preferred."""
    agent: Annotated[str, arg(metavar="{expert,random,zero,hold,POLICY}")] = "expert"
    """Agent that acts: one of these, a kept policy ('orbit list policies'), or the file or folder of a learned one."""
    output: Annotated[Path, arg(metavar="FILE")] = Path("out/demonstrations.hdf5")
    """The dataset, HDF5 in robomimic's layout; its card is written next to it."""
    group: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME")] = ()
    """An observation group to record; repeatable, all if left out."""
    noise: float = 0.0
    """Standard deviation of noise on the executed actions, in their units, each episode between none and twice this;
    the demonstrator's own actions are kept as clean_actions, the labels that cloning learns."""
    resume: bool = False
    """Continue an interrupted recording, or extend a complete one."""
    overwrite: bool = False
    """Replace an existing dataset or recording of that name once the new one is complete."""


def main(words: Sequence[str]) -> None:
    """Record, with a progress bar, and show what the dataset contains."""
    record(parse_settings(RecordSettings, words, "orbit record"))


def record(settings: RecordSettings) -> None:
    """Record as the settings say.

    Raises:
        OrbitError: of many kinds; each names the setting.
    """
    from orbit_data import recording
    from orbit_data.card import facts
    from orbit_data.hdf5 import Hdf5Dataset
    from orbit_data.recording import check_groups

    check_actor(settings.agent)
    check_positive("episodes", settings.episodes)
    check_positive("num_envs", settings.num_envs)
    make_folder(settings.output)
    check_output(settings.output, SUFFIX, settings.overwrite or settings.resume)
    file = recording.RecordingFile(settings.output)
    file.check_begun(settings.resume, settings.overwrite)
    environment = make_environment(settings, settings.num_envs)
    check_groups(settings.group, environment)
    if settings.overwrite:
        file.begin_anew()
    with progress_bar() as bar:
        counting = bar.add_task(f"{settings.task} demonstrations", total=settings.episodes)
        try:
            pace = recording.record(
                environment,
                lambda: make_actor(settings.agent, environment, settings.seed),
                file,
                settings.task or "",
                settings.episodes,
                settings.seed,
                settings.group or None,
                lambda recorded: bar.update(counting, completed=recorded),
                settings.noise,
            )
        except (OrbitError, KeyboardInterrupt):
            if kept := len(file.parts.infos()):
                message = f"{kept} finished episodes are kept in {file.parts.path}: --resume goes on"
                console().print(message, soft_wrap=True)
            raise
        finally:
            environment.close()
    dataset = Hdf5Dataset(settings.output)
    table = new_table("", "value", title=str(settings.output))
    for name, value in facts(dataset).items():
        table.add_row(name, value)
    dataset.close()
    if pace.env_steps:
        table.add_row("environment steps per second", f"{pace.env_steps_per_second:,.0f}, recording left out")
    console().print(table)
