"""``orbit augment``: a few demonstrations become many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from orbit_core.cli.making import make_environment
from orbit_core.cli.output import console, progress_bar
from orbit_core.cli.settings import EnvironmentSettings, KeyValues, Name, check_positive, parse_words
from orbit_core.files import check_apart
from orbit_core.interfaces.errors import ConfigurationError
from orbit_data.cli.read_budget import ReadSettings
from orbit_data.cli.record import check_recording, show_left_out

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment
    from orbit_motion.planning import HandTransits


@dataclass(frozen=True, kw_only=True)
class AugmentSettings(ReadSettings):
    """Cut demonstrations at the ends of subtasks, do the pieces where things are in new episodes, keep successes."""

    dataset: Annotated[Positional[Path], arg(metavar="DATASET")]
    """An HDF5 file that orbit record wrote."""
    output: Annotated[Path, arg(metavar="PATH")]
    """The new dataset: *.hdf5, or a folder of LeRobot's."""
    demonstrations: int = 10
    """How many of the dataset's first successful ones are cut."""
    episodes: int = 1000
    """How many are wanted."""
    method: Literal["mimicgen", "skillgen"] = "mimicgen"
    """Way of the hand to the begin of a piece: in a straight line, or on a planned way around what stands there."""
    num_envs: int = 64
    """Environments stepped together; as many as demonstrations at least."""
    most_attempts: Annotated[int | None, arg(metavar="INT")] = None
    """Attempts after which to end with fewer; ten times the episodes if left out."""
    backend: Name = None
    """Engine; the one that it was recorded on if left out."""
    device: Annotated[str, arg(metavar="NAME")] = "cpu"
    """Torch device that holds all state."""
    seed: int = 1
    """Of the new episodes, and of which demonstration is drawn for each."""
    set: KeyValues = ()
    """A field of the task over those of the dataset."""
    overwrite: bool = False
    """Replace the dataset that is there already, once the new one is whole."""


def main(words: Sequence[str]) -> None:
    """Augment, with a progress bar, and print the yield.

    Raises:
        OrbitError: of many kinds; each names the setting.
    """
    from orbit_data.augmentation import augment, cut
    from orbit_data.formats import opened
    from orbit_data.manifest.manifest import check_manifest
    from orbit_data.recording import RecordingFile
    from orbit_data.replay import fields_of

    settings = parse_words(AugmentSettings, words, "orbit augment")
    for name in ("demonstrations", "episodes", "num_envs"):
        check_positive(name, getattr(settings, name))
    if settings.most_attempts is not None:
        check_positive("most_attempts", settings.most_attempts)
    check_apart(settings.output, (settings.dataset,))
    check_recording(settings.output, settings.overwrite)
    file = RecordingFile(settings.output)
    file.check_begun(resume=False, overwrite=settings.overwrite)
    with opened(settings.dataset, settings.budget) as dataset:
        manifest = dataset.known()
        chosen = [place for place, info in enumerate(dataset.episodes) if info.success][: settings.demonstrations]
        if not chosen:
            raise ConfigurationError(f"no episode of {settings.dataset} succeeded: there is nothing to multiply")
        if settings.num_envs < len(chosen):
            raise ConfigurationError(
                f"{len(chosen)} demonstrations are cut side by side, in {len(chosen)} environments: give a larger "
                "--num-envs or fewer --demonstrations"
            )
        made = EnvironmentSettings(
            task=manifest.task,
            backend=settings.backend or manifest.backend,
            device=settings.device,
            seed=settings.seed,
            set=settings.set,
            fields=fields_of(manifest),
        )
        environment = make_environment(made, settings.num_envs)
        try:
            check_manifest(manifest, environment, str(settings.dataset), groups=())
            pieces = cut(environment, dataset, chosen)
            transits = _transits(environment) if settings.method == "skillgen" else None
            if settings.overwrite:
                file.begin_anew()
            most = settings.most_attempts or 10 * settings.episodes
            with progress_bar() as bar:
                line = bar.add_task(f"{manifest.task} demonstrations", total=settings.episodes)
                done = augment(
                    environment, pieces, file, manifest.task, settings.episodes, settings.seed, most,
                    lambda kept: bar.update(line, completed=kept), dataset.episodes[chosen[0]].instruction,
                    transits,
                )  # fmt: skip
        finally:
            file.release()
            environment.close()
    console().print(
        f"{settings.output}: {done.kept} kept; {done.successes} of {done.attempts} attempts on {made.backend} "
        f"succeeded, {done.share.percent()}, of {len(chosen)} demonstrations",
        soft_wrap=True,
    )
    if transits is not None:
        ways = transits.counts
        console().print(
            f"{ways.planned} ways planned around obstacles, {ways.straight} without a plan, {ways.unreachable} to "
            "poses out of reach",
            soft_wrap=True,
        )
    show_left_out(file)


def _transits(environment: Environment) -> HandTransits:
    """Return the planned ways of the hand of the robot that acts.

    Raises:
        ConfigurationError: a package that plans is not installed.
    """
    try:
        from orbit_motion.planning import HandTransits
    except ImportError:
        raise ConfigurationError("--method skillgen plans ways: install orbit-motion") from None
    robot = environment.world.robots[environment.task.agents[0]]
    generators = [generator for generator in environment.actions.generators if generator.robot is robot]
    return HandTransits(environment.world, robot, generators)
