"""An arm of three joints next to a cube, its simulated computer, and servers of it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from orbit_assets.objects import box
from orbit_core.backends import default_backend
from orbit_core.scene import (
    Articulation,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    Pose,
    RobotSpec,
    Scene,
)
from orbit_deploy.computer import ComputerSettings, RobotComputer
from orbit_deploy.description import RobotDescription
from orbit_deploy.follower import FollowerSettings, PathKind
from orbit_deploy.local import LocalLink
from orbit_deploy.messages import Mode
from orbit_deploy.simulated import Imperfections, SimulatedHardware
from orbit_zmq.server import ZmqServer

PERIOD = 0.02
HOME = [0.0, 0.0, 0.0]


def arm() -> RobotSpec:
    """Three hinges one after another, each with a link of 0.3 m."""
    inertia = np.eye(3) * 0.02
    links = [Link("base"), *(Link(f"link{i}", 1.0, (0.15, 0.0, 0.0), inertia) for i in range(3))]
    joints = [
        Joint(
            f"joint{i}",
            JointType.REVOLUTE,
            links[i].name,
            f"link{i}",
            parent_pose=Pose((0.3 if i else 0.0, 0.0, 0.0 if i else 0.5)),
            lower_limit=-1.5,
            upper_limit=1.5,
            effort_limit=50.0,
            velocity_limit=2.0,
        )
        for i in range(3)
    ]
    drive = ImplicitPd(joints=(".*",), stiffness=400.0, damping=40.0)
    return RobotSpec(
        name="arm",
        articulation=Articulation("three_joints", tuple(links), tuple(joints)),
        fixed_base=True,
        actuators=(drive,),
        gravity_compensation=True,
    )


def scene() -> Scene:
    cube = box("cube", size=(0.1, 0.1, 0.1), mass=0.5, pose=Pose((1.5, 0.0, 0.05)))
    return Scene(robots=(arm(),), objects=(cube,), physics_dt=0.005)


def description() -> RobotDescription:
    return RobotDescription.of(arm())


def hardware(imperfections: Imperfections | None = None, direct: bool = False) -> SimulatedHardware:
    return SimulatedHardware(scene(), default_backend(), 1000.0, imperfections, direct=direct)


@contextmanager
def lockstep(
    imperfections: Imperfections | None = None,
    settings: ComputerSettings | None = None,
    path: PathKind = PathKind.QUINTIC,
) -> Iterator[LocalLink]:
    """Session with a simulated arm whose time passes while the client waits."""
    link = LocalLink(hardware(imperfections, path is PathKind.DIRECT), PERIOD, FollowerSettings(), settings, path)
    yield link
    link.close()


@contextmanager
def served(keys: Path | None = None) -> Iterator[tuple[RobotComputer, str]]:
    """A computer whose loop runs in a thread behind ZeroMQ, and its address."""
    # A shared machine may hold up the client of a test for long.
    computer = RobotComputer(hardware(), FollowerSettings(watchdog=0.2), ComputerSettings(state_rate=200.0))
    server = ZmqServer(computer, "zmq://127.0.0.1:0", keys)
    thread = threading.Thread(target=computer.run, daemon=True)
    thread.start()
    try:
        yield computer, server.address
    finally:
        computer.end()
        thread.join(5.0)
        server.close()
        computer.hardware.close()


def rests(computer: RobotComputer) -> bool:
    """Return True if a robot holds still, with or without a fault."""
    return computer.follower.limiter.at_rest and computer.follower.mode in (Mode.HOLDING, Mode.FAULT)


def eventually(condition: Callable[[], bool], seconds: float = 5.0) -> bool:
    """Return whether a condition becomes true in time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.01)
    return False
