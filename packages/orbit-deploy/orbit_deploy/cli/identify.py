"""``orbit identify``: a robot's friction, damping, armature, delay and payload from a log of its motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from orbit_core.cli.output import console, new_table
from orbit_core.cli.settings import Name, check_output, check_positive, parse_words
from orbit_core.interfaces.errors import ConfigurationError
from orbit_deploy.cli.countdown import check_countdown, count_down

if TYPE_CHECKING:
    from orbit_core.scene import RobotSpec
    from orbit_deploy.identification import Identification


@dataclass(frozen=True, kw_only=True)
class IdentifySettings:
    """Fit parameters of a robot to a log of its motion on one engine, and write the fitted robot. With --excite the
    robot makes the motion first."""

    log: Annotated[Positional[Path], arg(metavar="LOG")]
    """MCAP or CSV file of a motion without contacts, or a recording of ROS; the new MCAP file with --excite."""
    robot: Name = None
    """Robot of the catalogue, or a file of one that was fitted before."""
    backend: Name = None
    """Physics backend; may be left out if only one is installed."""
    fit: tuple[str, ...] = ("friction", "damping", "armature", "delay")
    """What is fitted: friction, damping and armature of each joint that moved; delay, payload and gain of the robot."""
    payload_link: Name = None
    """Link that carries the payload; the end effector's if left out."""
    excite: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Move the robot at this address along sines within its limits, such as zmq://127.0.0.1:5555: all joints that
    follow positions, around their home. Leave it room: nothing here knows of obstacles."""
    reach: float = 0.4
    """Greatest distance of a joint from the middle of the motion of --excite, rad."""
    keys: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Folder of keys, for a robot on another machine."""
    countdown: float = 3.0
    """Seconds before the robot moves."""
    dead_man: bool = False
    """Let the robot move only while the space bar is held."""
    begin: float = 0.0
    """Start in the log, s."""
    seconds: float | None = None
    """Length that is used, s; to the end of the log if left out. Of the motion with --excite, 10 s if left out."""
    dt: float | None = None
    """Seconds of a physics step; the robot's own cycle if left out."""
    worlds: int = 24
    """Candidates that are simulated at once."""
    generations: int = 0
    """Generations of a search by CMA-ES over the whole range, for a robot that is far from its description; 0 refines
    the robot as it is."""
    derivatives: Name = None
    """Physics backend that computes the derivatives, for one that simulates candidates one after another."""
    seed: int = 0
    """Seed of the search, and of the motion of --excite."""
    output: Annotated[Path, arg(metavar="FILE")] = Path("fitted.json")
    """File of the fitted robot, whose name is accepted wherever a robot's is."""
    overwrite: bool = False
    """Replace files of those names that are there already."""


def main(words: Sequence[str]) -> None:
    """Fit, and write the file."""
    settings = parse_words(IdentifySettings, words, "orbit identify")
    check_output(settings.output, ".json", settings.overwrite)
    if settings.excite is not None:
        check_output(settings.log, ".mcap", settings.overwrite)
        check_countdown(settings.countdown)
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
    from orbit_deploy.identification import LONGEST_DELAY, IdentificationSettings, identify
    from orbit_deploy.log_replay import LogReplay, ParameterNames, fitted_joints, payload_link_of, quantities_of
    from orbit_deploy.motion_log import read_log

    torch.set_num_threads(1)
    assert settings.robot is not None, "the caller has looked"
    out = console()
    spec, backend = robot(settings.robot), settings.backend or default_backend()
    # Before the robot moves: words that are wrong must not cost a motion.
    quantities, scalars = quantities_of(settings.fit)
    link = settings.payload_link or payload_link_of(spec)
    if settings.excite is not None:
        _excite(settings, spec)
    log = read_log(settings.log)
    if settings.excite is None:
        log = log.selected(settings.begin, settings.seconds)
    # Only logs of our own computer say what they were made with.
    if log.description is not None:
        for line in check_robot(RobotDescription.of(spec), log.description, str(settings.log)):
            out.print(f"warning: {line}", soft_wrap=True)
    names = ParameterNames(fitted_joints(spec, log), quantities, scalars)
    search = IdentificationSettings(worlds=settings.worlds, generations=settings.generations, seed=settings.seed)
    out.print(f"{log.duration:g} s of {len(names.joints)} joints on {backend}: {len(names.all)} parameters")
    with ExitStack() as stack:
        replay, slopes = (
            stack.enter_context(closing(LogReplay(log, spec, name, names, link, settings.dt, LONGEST_DELAY)))
            for name in (backend, settings.derivatives or backend)
        )
        found = identify(replay, settings.robot, backend, search, out.print, slopes)
    found.fitted.write(settings.output)
    _report(settings, backend, found)
    values = dict(zip(found.names, found.values.tolist(), strict=True))
    return {"values": values, "before": found.before, "after": found.after}


def _excite(settings: IdentifySettings, spec: RobotSpec) -> None:
    """Have the robot at an address move for identification, and write its log."""
    from orbit_deploy.dead_man import DeadManKey
    from orbit_deploy.description import RobotDescription, check_robot
    from orbit_deploy.excitation import PERIOD, Excitation, ExcitationSettings, excite
    from orbit_deploy.link import connect
    from orbit_deploy.log import RobotLog

    assert settings.excite is not None, "the caller has looked"
    seconds = 10.0 if settings.seconds is None else settings.seconds
    motion = ExcitationSettings(seconds=seconds, reach=settings.reach, seed=settings.seed)
    with ExitStack() as stack:
        link = stack.enter_context(closing(connect(settings.excite, PERIOD, settings.keys)))
        # Another robot must not move, even if it could.
        check_robot(RobotDescription.of(spec), link.description, settings.excite)
        excitation = Excitation(link.description, motion)
        key = stack.enter_context(closing(DeadManKey())) if settings.dead_man else None
        log = stack.enter_context(closing(RobotLog(settings.log, link.description)))
        count_down(settings.countdown)
        if key is not None:
            console().print("hold the space bar")
            key.wait()
        excite(link, excitation, log, (lambda: None) if key is None else key.check)
    console().print(f"the motion of {seconds:g} s is in {settings.log}", soft_wrap=True)


def _report(settings: IdentifySettings, backend: str, found: Identification) -> None:
    out = console()
    table = new_table("parameter", "value", "standard deviation", title=f"{settings.robot} on {backend}")
    unknown: list[str] = []
    for name, value, deviation in zip(found.names, found.values, found.deviations, strict=True):
        if math.isfinite(deviation):
            table.add_row(name, f"{value:.5g}", f"{deviation:.2g}")
        else:
            unknown.append(name)
    out.print(table)
    if unknown:
        out.print(
            f"not determined by this log, and kept as described: {', '.join(unknown)}; 'orbit identify --excite' moves "
            "the robot so that more is",
            soft_wrap=True,
        )
    out.print(
        f"simulated minus recorded positions: {found.before:.3g} before, {found.after:.3g} rad or m (rms) after; "
        f"the robot is in {settings.output}",
        soft_wrap=True,
    )
