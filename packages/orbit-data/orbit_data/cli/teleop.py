"""``orbit teleop``: a person drives a task's robot, and records demonstrations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from orbit_core.cli.making import check_actor, make_actor, make_environment
from orbit_core.cli.output import console
from orbit_core.cli.settings import (
    EnvironmentSettings,
    check_port,
    check_steps,
    make_folder,
    parse_settings,
)
from orbit_core.interfaces.errors import ConfigurationError
from orbit_data.cli.record import check_recording, show_left_out

if TYPE_CHECKING:
    from orbit_data.teleoperation.device import Device
    from orbit_data.teleoperation.driver import Driver
    from orbit_data.teleoperation.session import Session


@dataclass(frozen=True, kw_only=True)
class TeleopSettings(EnvironmentSettings):
    """Drive a task's robot yourself, see it in the browser, and record demonstrations."""

    input_device: Annotated[str, arg(name="device", metavar="{browser,keyboard,gamepad,spacemouse,leader}")] = "browser"
    """Device that you move."""
    device: Annotated[str, arg(name="torch-device", metavar="NAME")] = "cpu"
    """Torch device that holds all state, such as 'cpu' or 'cuda:0'."""
    output: Annotated[Path, arg(metavar="PATH")] = Path("out/teleoperation.hdf5")
    """The dataset, as 'orbit record' writes it: *.hdf5, or a folder of LeRobot's; nothing is written before the first
    episode is saved."""
    instruction: Annotated[str | None, arg(metavar="TEXT")] = None
    """What the episodes show, in words; the task's own if left out."""
    policy: Annotated[str | None, arg(metavar="POLICY")] = None
    """A policy that acts until you move the device, and again a second after you let go (HG-DAgger): only your steps
    are marked to be learned from ('orbit train TASK --library imitation --dataset ...')."""
    resume: bool = False
    """Add to the dataset of that name."""
    overwrite: bool = False
    """Replace an existing dataset of that name once an episode is saved and the session ends."""
    seconds: float = 60.0
    """Length of an episode, instead of the task's own."""
    linear_speed: float = 0.25
    """Speed of the hand in m/s at a device's full deflection."""
    angular_speed: float = 1.0
    """Angular speed of the hand in rad/s at a device's full deflection."""
    leader_port: int = 8090
    """Port at 127.0.0.1 where a leader arm connects; 0 takes a free one."""
    views: bool = True
    """Show pictures next to the scene: from the hand, and from the robot's right."""
    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 lets other computers, such as a phone, connect."""
    port: int = 8080
    """Port of the page."""
    max_steps: Annotated[int | None, arg(metavar="INT")] = None
    """Stop after that many steps; run until interrupted if left out."""


def main(words: Sequence[str]) -> None:
    """Let a person drive until interrupted, or for ``max_steps``; then gather the kept episodes."""
    teleop(parse_settings(TeleopSettings, words, "orbit teleop"))


def teleop(settings: TeleopSettings) -> None:
    """Drive and record as the settings say.

    Raises:
        OrbitError: of many kinds; each names the setting.
    """
    from orbit_core.envs.task import instruction_of
    from orbit_data.recording import RecordingFile
    from orbit_data.teleoperation.device import Speeds
    from orbit_data.teleoperation.devices import check_device, open_device
    from orbit_data.teleoperation.driver import Driver
    from orbit_data.teleoperation.session import Session

    check_device(settings.input_device)
    for name in ("seconds", "linear_speed", "angular_speed"):
        if not 0.0 < getattr(settings, name) < math.inf:
            raise ConfigurationError(f"{name} must be above zero and finite, not {getattr(settings, name):g}")
    check_port("port", settings.port)
    check_port("leader_port", settings.leader_port)
    check_steps(settings.max_steps)
    if settings.policy is not None:
        check_actor(settings.policy)
    make_folder(settings.output)
    check_recording(settings.output, settings.overwrite or settings.resume)
    file = RecordingFile(settings.output)
    file.check_begun(settings.resume, settings.overwrite)
    fields = {**settings.fields, "episode_length": settings.seconds}
    environment = make_environment(replace(settings, fields=fields), 1)
    try:
        driver = Driver(environment)
        speeds = Speeds(settings.linear_speed, settings.angular_speed)
        device = open_device(settings.input_device, speeds, driver, settings.leader_port)
        try:
            if settings.overwrite:
                file.begin_anew()
            instruction = instruction_of(environment.task, settings.task or "", settings.instruction)
            session = Session(
                environment,
                driver,
                device,
                settings.input_device,
                file,
                settings.task or "",
                settings.seed,
                instruction,
                None if settings.policy is None else partial(make_actor, settings.policy, environment, settings.seed),
            )
            try:
                _show(settings, session, device, driver)
            finally:
                kept = session.close()
                outcome = f"{kept} episodes are in {settings.output}" if kept else "no episode was saved"
                console().print(outcome, soft_wrap=True)
                show_left_out(file)
        finally:
            device.close()
            file.release()
    finally:
        environment.close()


def _show(settings: TeleopSettings, session: Session, device: Device, driver: Driver) -> None:
    from orbit_data.teleoperation.leader import Leader
    from orbit_data.teleoperation.session import Views
    from orbit_viewer.viewer import Viewer

    attach, pages = getattr(device, "attach", None), getattr(device, "pages", ())
    title = f"ORBIT {settings.task} by {settings.input_device}"
    views = Views(session.world, driver)
    with (
        closing(views),
        Viewer(
            session,
            session,
            settings.host,
            settings.port,
            title,
            lambda _: session.information(),
            tool=attach,
            pages=pages,
            views=views.pictures if settings.views else None,
        ) as viewer,
    ):
        print(f"drive and watch at {viewer.url}", flush=True)
        for url in viewer.page_urls:
            print(f"a gamepad on the screen, for a phone as well, at {url}", flush=True)
        if isinstance(device, Leader):
            print(f"a leader connects to 127.0.0.1:{device.port}, and sends {device.greeting} first", flush=True)
        viewer.run(settings.max_steps)
