"""``orbit twin``: a log of a robot, and the simulations that follow the same commands, with their differences."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from orbit_core.cli.output import console, new_table, write_json
from orbit_core.cli.settings import File, Name, check_output, parse_words
from orbit_core.interfaces.errors import ConfigurationError

if TYPE_CHECKING:
    from orbit_core.scene import RobotSpec
    from orbit_deploy.motion_log import MotionLog
    from orbit_deploy.twin import TwinResult


@dataclass(frozen=True, kw_only=True)
class TwinSettings:
    """Replay a robot's log in simulation on one or several engines, and show where they differ from the robot.

    'orbit deploy --twin BACKEND --view' does the same live."""

    log: Annotated[Positional[Path], arg(metavar="LOG")]
    """MCAP or CSV file of 'orbit robot --log', or a recording of ROS (rosbag)."""
    robot: Name = None
    """Robot of the catalogue, or a file of a fitted one ('orbit identify')."""
    backend: tuple[str, ...] = ()
    """Physics backends; the default one if left out."""
    begin: float = 0.0
    """Start in the log, s."""
    seconds: float | None = None
    """Length that is replayed, s; to the end of the log if left out."""
    dt: float | None = None
    """Seconds of a physics step; the robot's own cycle if left out."""
    view: bool = False
    """Show the robot, the simulation as a ghost, and plots of both in the browser; of the first backend."""
    host: str = "127.0.0.1"
    """Network address of the page."""
    port: int = 8080
    """Port of the page; if taken, the next free one."""
    speed: float = 1.0
    """Seconds of the log per second of the page."""
    json: File = None
    """Write the differences here."""
    csv: File = None
    """Write the log as CSV here, whatever it was read from."""
    overwrite: bool = False
    """Replace files of those names that are there already."""


def main(words: Sequence[str]) -> None:
    """Replay, report, and show."""
    settings = parse_words(TwinSettings, words, "orbit twin")
    check_output(settings.json, ".json", settings.overwrite)
    check_output(settings.csv, ".csv", settings.overwrite)
    if not 0.0 < settings.speed < 1e3:
        raise ConfigurationError(f"speed must be above 0 and below 1000, not {settings.speed}")
    if settings.robot is None:
        raise ConfigurationError("name the robot: orbit twin robot.mcap --robot franka_panda")
    run(settings)


def run(settings: TwinSettings) -> dict[str, dict[str, float]]:
    """Replay the log on each backend, and return the differences by backend.

    Raises:
        OrbitError: the log is none, is of another robot, or a backend cannot simulate it.
    """
    import torch

    from orbit_assets.catalogue import robot
    from orbit_assets.fitted import read_fitted
    from orbit_core.backends import default_backend
    from orbit_deploy.motion_log import read_log
    from orbit_deploy.twin import replay_twin, summary

    # Tensors of one robot are small: threads would cost more than they save.
    torch.set_num_threads(1)
    assert settings.robot is not None, "the caller has looked"
    spec = robot(settings.robot)
    # A robot's specification has no delay: it is in the file alone.
    delay = read_fitted(Path(settings.robot)).delay if settings.robot.endswith(".json") else 0.0
    log = read_log(settings.log).selected(settings.begin, settings.seconds)
    # A recording may hold more joints than the robot, and in another order.
    log = log.ordered(tuple(joint.name for joint in spec.articulation.movable_joints))
    if settings.csv is not None:
        log.write_csv(settings.csv)
    results = [replay_twin(log, spec, name, delay, settings.dt) for name in settings.backend or (default_backend(),)]
    write_json(settings.json, summary(results))
    _report(settings, log, results)
    if settings.view:
        _show(settings, spec, log, results[0])
    return summary(results)


def _report(settings: TwinSettings, log: MotionLog, results: list[TwinResult]) -> None:
    title = f"{settings.robot}: simulated minus recorded positions over {log.duration:.3g} s, rms in rad or m"
    table = new_table("joint", *(each.backend for each in results), title=title)
    for name in log.joints:
        table.add_row(name, *(f"{each.by_joint[name]:.3g}" for each in results))
    table.add_row("all", *(f"{each.rms:.3g}" for each in results))
    table.add_row("largest", *(f"{each.largest:.3g}" for each in results))
    console().print(table)


def _show(settings: TwinSettings, spec: RobotSpec, log: MotionLog, result: TwinResult) -> None:
    import numpy as np

    from orbit_deploy.twin import play
    from orbit_viewer.robot_page import RobotPage

    series = ("commanded", "measured", f"simulated by {result.backend}")
    with RobotPage(spec, series, host=settings.host, port=settings.port) as page:
        console().print(f"{page.url} (Ctrl-C ends)", soft_wrap=True)

        def show(when: float, row: int) -> None:
            values = (log.target[row], log.position[row], result.positions[row])
            text = f"{when:.1f} of {log.duration:.1f} s, {result.rms:.3g} rad or m (rms) apart"
            page.show(when, log.position[row], np.stack(values), result.positions[row], text)

        # Again and again, as a person looks at one joint after the other.
        try:
            while True:
                play(log, result, show, time.sleep, settings.speed)
        except KeyboardInterrupt:
            return
