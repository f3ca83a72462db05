"""``orbit bisect``: the difference between two simulations that decides whether an agent succeeds."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from tyro.conf import Positional, UseAppendAction, arg

from orbit_core.cli.making import check_actor, make_actor
from orbit_core.cli.output import console, new_table, write_json
from orbit_core.cli.settings import File, KeyValues, Name, check_output, check_positive, parse_words
from orbit_core.interfaces.errors import ConfigurationError
from orbit_deploy.bisection import KINDS, Bisection, Bisector, DelayedActor, Difference, changed_world, delay_steps
from orbit_deploy.cli.deploy import configured_task


@dataclass(frozen=True, kw_only=True)
class BisectSettings:
    """Find which difference between two simulations makes an agent fail, by bisection over sets of differences."""

    agent: Annotated[Positional[str], arg(metavar="{POLICY,expert}")]
    """Who acts: a kept policy, a policy's file or folder, or the task's expert."""
    difference: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="KIND=VALUE")] = ()
    """Difference of the simulation where it fails, such as contact_friction=0.3, gain=0.5, robot_mass=1.3,
    object_mass=2, armature=0.1, joint_friction=0.05, joint_damping=1, delay=0.04 or backend=bullet."""
    task: Name = None
    """Task; the policy's own if left out."""
    robot: Name = None
    """Robot of the catalogue in the place of the task's own."""
    action: Name = None
    """Action space in the place of the task's own."""
    set: KeyValues = ()
    """A field of the task, such as tolerance=0.03."""
    backend: Name = None
    """Physics backend where the agent succeeds; may be left out if only one is installed."""
    episodes: int = 40
    """Episodes for each set of differences."""
    num_envs: int = 20
    """Environments stepped together."""
    seed: int = 0
    """Seed of all runs."""
    json: File = None
    """Write the result here."""
    overwrite: bool = False
    """Replace a file of that name if it is there already."""


def main(words: Sequence[str]) -> None:
    """Search, and report."""
    settings = parse_words(BisectSettings, words, "orbit bisect")
    check_output(settings.json, ".json", settings.overwrite)
    check_positive("episodes", settings.episodes)
    check_positive("num_envs", settings.num_envs)
    check_actor(settings.agent)
    bisect(settings)


def bisect(settings: BisectSettings) -> Bisection:
    """Search for the deciding differences.

    Raises:
        ConfigurationError: no differences are given, or they do not decide.
    """
    differences = tuple(Difference.parse(text) for text in settings.difference)
    if not differences:
        raise ConfigurationError(f"name differences: --difference KIND=VALUE, of {', '.join(KINDS)}")
    out = console()
    found = Bisector(lambda chosen: _success(settings, chosen), out.print).run(differences)
    names = ", ".join(map(str, found.deciding))
    table = new_table("differences", "success rate", title=f"{settings.agent}: {names} decides")
    for tried, rate in found.tried.items():
        table.add_row(", ".join(map(str, tried)) or "none", f"{100.0 * rate:.1f} %")
    out.print(table)
    if found.threshold is not None:
        out.print(f"it fails from {found.deciding[0].kind}={found.threshold:g} on")
    write_json(settings.json, _document(found))
    return found


def _document(found: Bisection) -> dict[str, Any]:
    return {
        "deciding": [str(each) for each in found.deciding],
        "threshold": found.threshold,
        "tried": [
            {"differences": [str(each) for each in tried], "success_rate": rate} for tried, rate in found.tried.items()
        ],
    }


def _success(settings: BisectSettings, differences: tuple[Difference, ...]) -> float:
    """Return the success rate of the agent under some differences."""
    from orbit_core.envs.making import make
    from orbit_core.rollout.stepping import EpisodeCounter, roll_out

    world = changed_world(differences, settings.backend)
    environment = make(configured_task(settings), settings.num_envs, world=world, seed=settings.seed)
    try:
        with warnings.catch_warnings():
            # That gains and masses are not those of the training is the point.
            warnings.simplefilter("ignore")
            actor = make_actor(settings.agent, environment, settings.seed)
        if steps := delay_steps(differences, environment.step_dt):
            actor = DelayedActor(actor, environment, steps)
        counter = EpisodeCounter(settings.episodes, settings.num_envs, environment.device)
        # Every set of differences meets the same episodes.
        environment.reset(settings.seed)
        roll_out(environment, actor, (counter,), lambda: counter.complete)
        return counter.episodes().success_rate.value
    finally:
        environment.close()
