"""``orbit record``: a task's episodes as a dataset of demonstrations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import UseAppendAction, arg

from orbit_core.cli.making import check_actor, make_actor, make_environment
from orbit_core.cli.output import console, new_table, progress_bar
from orbit_core.cli.settings import (
    EnvironmentSettings,
    check_output,
    check_parent,
    check_positive,
    make_folder,
    parse_settings,
)
from orbit_core.files import sweep
from orbit_core.interfaces.errors import ConfigurationError, OrbitError

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment
    from orbit_data.recording import RecordingFile

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
    output: Annotated[Path, arg(metavar="PATH")] = Path("out/demonstrations.hdf5")
    """The dataset with its card: HDF5 in robomimic's layout if the name ends in .hdf5, else a folder in LeRobot's."""
    group: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME")] = ()
    """An observation group to record; repeatable, all if left out."""
    noise: float = 0.0
    """Standard deviation of noise on the executed actions, in their units, each episode between none and twice this;
    the demonstrator's own actions are kept as clean_actions, the labels that cloning learns."""
    stray: float = 0.0
    """The same at the start of each episode only, for up to a fifth of it; the way back is shown without noise."""
    instruction: Annotated[str | None, arg(metavar="TEXT")] = None
    """What the episodes show, in words, as policies of vision and language are asked for it; the task's own if left
    out."""
    resume: bool = False
    """Continue an interrupted recording, or extend a complete one."""
    overwrite: bool = False
    """Replace an existing dataset or recording of that name once the new one is complete."""


def check_recording(path: Path, replaces: bool) -> None:
    """Reject the path of a new dataset that cannot be written, before the work whose result it is to hold.

    Args:
        path: path of the file or folder.
        replaces: whether a dataset may be there.

    Raises:
        ConfigurationError: the path has no known format, is taken, or is in no folder that can be written.
    """
    from orbit_data.formats import check_target

    if path.suffix == SUFFIX:
        return check_output(path, SUFFIX, replaces)
    check_parent(path)
    check_target(path)
    if path.exists() and not replaces:
        raise ConfigurationError(f"{path} is there already: give another name, or --overwrite")
    return sweep(path.parent)


def main(words: Sequence[str]) -> None:
    """Record, with a progress bar, and show what the dataset contains."""
    record(parse_settings(RecordSettings, words, "orbit record"))


def record(settings: RecordSettings) -> None:
    """Record as the settings say.

    Raises:
        OrbitError: of many kinds; each names the setting.
    """
    from orbit_core.envs.task import instruction_of
    from orbit_data import recording
    from orbit_data.card import facts
    from orbit_data.formats import opened
    from orbit_data.reading.budget import TRUSTED
    from orbit_data.recording import check_groups

    check_actor(settings.agent)
    check_positive("episodes", settings.episodes)
    check_positive("num_envs", settings.num_envs)
    make_folder(settings.output)
    check_recording(settings.output, settings.overwrite or settings.resume)
    file = recording.RecordingFile(settings.output)
    file.check_begun(settings.resume, settings.overwrite)
    environment = make_environment(settings, settings.num_envs)
    check_groups(settings.group, environment)
    if note := phase_note(environment) if settings.agent == "expert" else "":
        console().print(note, soft_wrap=True)
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
                instruction_of(environment.task, settings.task or "", settings.instruction),
                settings.stray,
            )
        except (OrbitError, KeyboardInterrupt):
            if kept := len(file.parts.infos()):
                message = f"{kept} finished episodes are kept in {file.parts.path}: --resume goes on"
                console().print(message, soft_wrap=True)
            raise
        finally:
            environment.close()
    table = new_table("", "value", title=str(settings.output))
    with opened(settings.output, TRUSTED) as dataset:
        for name, value in facts(dataset).items():
            table.add_row(name, value)
    if pace.env_steps:
        table.add_row("environment steps per second", f"{pace.env_steps_per_second:,.0f}, recording left out")
    console().print(table)
    show_left_out(file)


def phase_note(environment: Environment) -> str:
    """Return a note where the expert's phases end after a time that a policy would not see; empty if none do."""
    from orbit_core.envs.expert_phase import EXPERT_PHASE, PhasedExpert
    from orbit_core.envs.observation_layout import POLICY

    shown = EXPERT_PHASE in environment.observation[POLICY].terms
    expert = None if shown else environment.expert()
    if not isinstance(expert, PhasedExpert) or not expert.timed_phases:
        return ""
    listed = ", ".join(map(str, expert.timed_phases))
    return (
        f"note: {len(expert.timed_phases)} of the expert's {expert.phase_count} phases end after a time ({listed}), "
        "which a policy does not see. Clone with chunks of actions (the default of orbit train --library imitation), "
        "and disturb what is executed (--noise, --stray). --set expert_phase=true shows the policy the phase, for "
        "policies that keep the expert's tolerances"
    )


def show_left_out(file: RecordingFile) -> None:
    """Print the names of arrays that a recording's format could not store."""
    if file.left_out:
        console().print(f"not held: {', '.join(sorted(file.left_out))}", soft_wrap=True)
