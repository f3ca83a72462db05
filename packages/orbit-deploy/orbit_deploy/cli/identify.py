"""``orbit identify``: a robot's friction, damping, armature, delay and payload from a log of its motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from orbit_core.cli.output import console, new_table
from orbit_core.cli.settings import Name, check_output, check_positive, parse_words
from orbit_core.interfaces.errors import ConfigurationError


@dataclass(frozen=True, kw_only=True)
class IdentifySettings:
    """Fit parameters of a robot to a log of 'orbit robot --log' on one engine, and write the fitted robot."""

    log: Annotated[Positional[Path], arg(metavar="LOG")]
    """MCAP or CSV file of a motion without contacts, or a recording of ROS."""
    robot: Name = None
    """Robot of the catalogue, or a file of one that was fitted before."""
    backend: Name = None
    """Physics backend; may be left out if only one is installed."""
    fit: tuple[str, ...] = ("friction", "damping", "armature", "delay")
    """What is fitted: friction, damping and armature of each joint that moved; delay, payload and gain of the robot."""
    payload_link: Name = None
    """Link that carries the payload; the end effector's if left out."""
    begin: float = 0.0
    """Start in the log, s."""
    seconds: float | None = None
    """Length that is used, s; to the end of the log if left out."""
    dt: float | None = None
    """Seconds of a physics step; the robot's own cycle if left out."""
    worlds: int = 24
    """Candidates that are simulated at once."""
    generations: int = 25
    """Generations of the search by CMA-ES; 0 refines the robot as it is."""
    seed: int = 0
    """Seed of the search."""
    output: Annotated[Path, arg(metavar="FILE")] = Path("fitted.json")
    """File of the fitted robot, whose name is accepted wherever a robot's is."""
    overwrite: bool = False
    """Replace the file if it is there already."""


def main(words: Sequence[str]) -> None:
    """Fit, and write the file."""
    settings = parse_words(IdentifySettings, words, "orbit identify")
    check_output(settings.output, ".json", settings.overwrite)
    check_positive("worlds", settings.worlds)
    if settings.robot is None:
        raise ConfigurationError("name the robot: orbit identify robot.mcap --robot franka_panda")
    run(settings)


def run(settings: IdentifySettings) -> dict[str, Any]:
    """Fit, write the file, and return the numbers by name.

    Raises:
        OrbitError: the log is none, is of another robot, or the backend cannot simulate it.
    """
    import torch

    from orbit_assets.catalogue import robot
    from orbit_core.backends import default_backend
    from orbit_deploy.description import RobotDescription, check_robot
    from orbit_deploy.identification import IdentificationSettings, identify
    from orbit_deploy.log_replay import LogReplay, ParameterNames, fitted_joints, payload_link_of, quantities_of
    from orbit_deploy.motion_log import read_log

    torch.set_num_threads(1)
    assert settings.robot is not None, "the caller has looked"
    out = console()
    spec, backend = robot(settings.robot), settings.backend or default_backend()
    log = read_log(settings.log).selected(settings.begin, settings.seconds)
    # Only logs of our own computer say what they were made with.
    if log.description is not None:
        for line in check_robot(RobotDescription.of(spec), log.description, str(settings.log)):
            out.print(f"warning: {line}", soft_wrap=True)
    quantities, scalars = quantities_of(settings.fit)
    names = ParameterNames(fitted_joints(spec, log), quantities, scalars)
    link = settings.payload_link or payload_link_of(spec)
    replay = LogReplay(log, spec, backend, names, link, settings.dt)
    search = IdentificationSettings(worlds=settings.worlds, generations=settings.generations, seed=settings.seed)
    out.print(f"{log.duration:g} s of {len(names.joints)} joints on {backend}: {len(names.all)} parameters")
    try:
        found = identify(replay, settings.robot, backend, search, out.print)
    finally:
        replay.close()
    found.fitted.write(settings.output)
    table = new_table("parameter", "value", "standard deviation", title=f"{settings.robot} on {backend}")
    for name, value, deviation in zip(found.names, found.values, found.deviations, strict=True):
        table.add_row(name, f"{value:.5g}", f"{deviation:.2g}" if deviation < 1e6 else "not determined by the log")
    out.print(table)
    out.print(
        f"simulated minus recorded positions: {found.before:.3g} before, {found.after:.3g} rad or m (rms) after; "
        f"the robot is in {settings.output}",
        soft_wrap=True,
    )
    values = dict(zip(found.names, found.values.tolist(), strict=True))
    return {"values": values, "before": found.before, "after": found.after}
