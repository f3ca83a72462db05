"""``orbit robot``: a robot's computer in a separate process, with a simulated or a real robot behind a bridge."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from orbit_core.cli.output import console
from orbit_core.cli.settings import File, KeyValues, Name, check_output, parse_words
from orbit_core.interfaces.errors import ConfigurationError
from orbit_deploy.messages import Fault

if TYPE_CHECKING:
    from orbit_deploy.hardware import RobotHardware

Folder = Annotated[Path | None, arg(metavar="FOLDER")]


@dataclass(frozen=True, kw_only=True)
class RobotSettings:
    """Serve a robot to 'orbit deploy' as a robot's computer does: a loop in real time behind a bridge. The robot is a
    simulated one, or a real one with --hardware."""

    robot: Annotated[Positional[str | None], arg(metavar="ROBOT")] = None
    """Robot of the catalogue ('orbit list robots') or file of a fitted one; or name a task with --task."""
    task: Name = None
    """Task whose scene, with its robot and objects, is simulated; the objects are tracked."""
    hardware: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Address of the real robot that is driven instead of a simulated one, such as franka://172.16.0.2."""
    backend: Name = None
    """Physics backend; may be left out if only one is installed."""
    bridge: Name = "zmq"
    """Bridge that clients connect by."""
    host: str = "127.0.0.1"
    """Address to listen at; beyond this machine with --keys only."""
    port: int = 5555
    """Port to listen at; 0 for any that is free."""
    keys: Folder = None
    """Folder of keys."""
    make_keys: Folder = None
    """Make keys in this new folder, and end."""
    realtime: bool = False
    """Run with real-time priority and locked memory, where the system allows it."""
    rate: float = 1000.0
    """Rate of the robot's loop, Hz."""
    direct: bool = False
    """Permit targets without limits of acceleration and jerk ('orbit deploy --path direct')."""
    delay: float = 0.0
    """Seconds between a target and its effect in the drives; of a fitted robot its own if left out."""
    friction: float = 0.0
    """Friction of each driven joint beyond the model's, as a share of its effort limit."""
    noise: float = 0.0
    """Standard deviation of measured joint positions, rad or m."""
    actuator_network: File = None
    """File of 'orbit train-actuator' that computes the joints' efforts in place of the drives, at its own --rate."""
    loss: float = 0.0
    """Share of commands and states that are lost, in [0, 1)."""
    drift: float = 0.0
    """Relative error of the robot's clock, such as 5e-5."""
    log: File = None
    """Write commands, states and faults to this MCAP file."""
    set: KeyValues = ()
    """A field of the task, such as tolerance=0.03."""
    seconds: float | None = None
    """End after this time; at Ctrl-C if left out."""
    overwrite: bool = False
    """Replace the log if it is there already."""


def main(words: Sequence[str]) -> None:
    """Serve until Ctrl-C, SIGTERM or the end of the time; the robot ends at rest."""
    settings = parse_words(RobotSettings, words, "orbit robot")
    check_output(settings.log, ".mcap", settings.overwrite)
    if not 0.0 <= settings.loss < 1.0:
        raise ConfigurationError(f"loss is a share in [0, 1), not {settings.loss}")
    if not 10.0 <= settings.rate <= 10_000.0:
        raise ConfigurationError(f"rate must be from 10 to 10,000 Hz, not {settings.rate}")
    if settings.make_keys is not None:
        from orbit_deploy.link import bridge

        make = getattr(bridge(settings.bridge or "zmq"), "make_keys", None)
        if make is None:
            raise ConfigurationError(f"bridge '{settings.bridge}' has no keys")
        make(settings.make_keys)
        console().print(f"keys are in {settings.make_keys}: copy robot.key to clients, client.key to the robot")
        return
    if (settings.robot is None) == (settings.task is None):
        raise ConfigurationError("name a robot, or a task with --task: orbit robot franka_panda")
    if settings.hardware is not None:
        _check_real(settings)
    _serve(settings)


def _serve(settings: RobotSettings) -> None:
    from orbit_deploy.realtime import prioritized

    # Before anything makes a thread: threads inherit the priority.
    with prioritized() if settings.realtime else nullcontext([]) as missing:
        _run(settings, missing)


def _run(settings: RobotSettings, missing: Sequence[str]) -> None:
    import threading

    import torch

    from orbit_deploy.clocks import RobotClock
    from orbit_deploy.computer import ComputerSettings, RobotComputer
    from orbit_deploy.link import bridge
    from orbit_deploy.log import RobotLog

    torch.set_num_threads(1)
    out = console()
    for sentence in missing:
        out.print(f"warning: {sentence}", soft_wrap=True)
    carrier = bridge(settings.bridge or "zmq")
    hardware = _hardware(settings)
    try:
        log = None if settings.log is None else RobotLog(settings.log, hardware.description)
        clock = RobotClock(drift=settings.drift)
        computer = RobotComputer(hardware, None, ComputerSettings(loss=settings.loss), clock, log)
        faults: list[Fault] = []
        computer.on_fault.append(faults.append)
        computer.watch()
        server = carrier.serve(computer, f"{settings.bridge}://{settings.host}:{settings.port}", settings.keys)
        timer = threading.Timer(settings.seconds or 0.0, computer.end)
        # A command that ends before does not wait for it.
        timer.daemon = True
        try:
            out.print(f"serving {hardware.description.model} at {server.address} (Ctrl-C ends)", soft_wrap=True)
            if settings.seconds is not None:
                timer.start()
            # Ctrl-C raises in the loop; it is run again to bring the robot to rest.
            computer.run()
        except KeyboardInterrupt:
            computer.end()
            computer.run()
            raise
        finally:
            timer.cancel()
            server.close()
            for fault in faults[-10:]:
                out.print(f"fault ({fault.code}): {fault.text}", soft_wrap=True)
            out.print(f"loop: {computer.loop.times}", soft_wrap=True)
    finally:
        hardware.close()


def _check_real(settings: RobotSettings) -> None:
    given = {"--task": settings.task, "--backend": settings.backend, "--delay": settings.delay,
             "--friction": settings.friction, "--noise": settings.noise}  # fmt: skip
    if words := [word for word, value in given.items() if value]:
        raise ConfigurationError(f"{', '.join(words)} is for simulated robots: leave it out with --hardware")


def _hardware(settings: RobotSettings) -> RobotHardware:
    from msgspec import structs

    from orbit_assets.catalogue import robot
    from orbit_assets.fitted import read_fitted
    from orbit_core.backends import default_backend
    from orbit_core.configuration import assignments
    from orbit_core.envs.configuration import configure
    from orbit_core.envs.observation_layout import with_sensors_of_terms
    from orbit_core.envs.registry import task_entry
    from orbit_core.scene import Scene
    from orbit_deploy.description import RobotDescription
    from orbit_deploy.hardware import open_hardware
    from orbit_deploy.simulated import Imperfections, SimulatedHardware

    if settings.hardware is not None:
        assert settings.robot is not None  # checked by main
        described = RobotDescription.of(robot(settings.robot), settings.rate)
        return open_hardware(settings.hardware, structs.replace(described, direct=settings.direct))
    if settings.task is not None:
        entry = task_entry(settings.task)
        task = configure(entry.task_type(), assignments(settings.set, f"task {entry.name}"))
        # Cameras that observations need are the robot's.
        scene = with_sensors_of_terms(task.scene(), task)
    else:
        assert settings.robot is not None  # checked by main
        scene = Scene(robots=(replace(robot(settings.robot), name="robot"),))
    delay = settings.delay
    if settings.robot is not None and settings.robot.endswith(".json") and not delay:
        delay = read_fitted(Path(settings.robot)).delay
    imperfections = Imperfections(
        delay=delay,
        friction=settings.friction,
        position_noise=settings.noise,
        actuator_network=settings.actuator_network,
    )
    return SimulatedHardware(
        scene, settings.backend or default_backend(), settings.rate, imperfections, direct=settings.direct
    )
