"""A simulated robot in place of a real one: any backend's world, with delays, friction, noise of measurement."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from msgspec import structs

from orbit_core.interfaces import ConfigurationError, JointTarget, UnknownNameError
from orbit_core.scene import ActuatorNetwork, CameraSpec, ImplicitPd, RobotSpec, Scene
from orbit_core.world import simulate
from orbit_deploy.description import RobotDescription
from orbit_deploy.eyes import SimulatedEyes
from orbit_deploy.follower import JointTargets
from orbit_deploy.hardware import Measurement, RobotHardware
from orbit_deploy.messages import Arrangement
from orbit_deploy.pictures import Picture, PictureKind


@dataclass(frozen=True, kw_only=True)
class Imperfections:
    """Ways in which a simulated robot differs from its model."""

    delay: float = 0.0
    """Seconds between a target and its effect in the drives."""
    friction: float = 0.0
    """Coulomb friction of each driven joint beyond the model's, as a share of its effort limit."""
    position_noise: float = 0.0
    """Standard deviation of measured positions, rad or m."""
    velocity_noise: float = 0.0
    """Standard deviation of measured velocities, rad/s or m/s."""
    object_noise: float = 0.0
    """Standard deviation of measured positions of objects, m."""
    actuator_network: Path | None = None
    """File of 'orbit train-actuator' that computes the efforts of the joints whose drives follow positions, such as a
    series-elastic actuator's, in place of these drives; None keeps them. The robot's rate must be the network's."""
    seed: int = 0
    """Seed of the noise."""

    def __post_init__(self) -> None:
        for name in ("delay", "friction", "position_noise", "velocity_noise", "object_noise"):
            if not 0.0 <= getattr(self, name) < 10.0:
                raise ConfigurationError(
                    f"{name} of the simulated robot must be from 0 to 10, not {getattr(self, name)}"
                )


class SimulatedHardware(RobotHardware):
    """One robot of a scene in a physics engine, stepped once a cycle.

    Objects of the scene are tracked, as a motion-capture system would. Cameras of the scene take pictures, drawn by
    another process; its other sensors are left out.

    Args:
        scene: with one robot.
        backend: name of the physics backend.
        rate: of the robot's loop, Hz, which is that of the physics.
        imperfections: of the robot.
        settings: of the backend, by field name.
        direct: whether clients may send targets without limits of acceleration and jerk.

    Raises:
        ConfigurationError: the scene has no robot or several.
        OrbitError: the backend lacks what the scene needs.
    """

    def __init__(
        self,
        scene: Scene,
        backend: str,
        rate: float = 1000.0,
        imperfections: Imperfections | None = None,
        settings: dict[str, object] | None = None,
        direct: bool = False,
    ) -> None:
        if len(scene.robots) != 1:
            raise ConfigurationError(f"a robot's computer serves one robot, and the scene has {len(scene.robots)}")
        self.imperfections = imperfections or Imperfections()
        # Sensors cost time in each cycle and are computed by the client from joints and objects.
        simulated = replace(scene, sensors=(), physics_dt=1.0 / rate)
        if self.imperfections.actuator_network is not None:
            # Clients see the drives of the description, which the network imitates with what lies behind them.
            robot = _with_network(scene.robots[0], self.imperfections.actuator_network)
            simulated = replace(simulated, robots=(robot,))
        self._world = simulate(simulated, 1, backend, settings=settings)
        self._robot = self._world.robots[scene.robots[0].name]
        # A robot that walks or drives is tracked too, in place of an estimator of its base.
        things = (self._robot, *self._world.objects.values())
        self._objects = {thing.name: thing for thing in things if not thing.spec.fixed_base}
        seen = tuple(spec for spec in scene.sensors if isinstance(spec, CameraSpec))
        # Explicit actuators need no pictures: the process draws the robot as the scene has it.
        drawn = replace(scene, sensors=(), physics_dt=1.0 / rate)
        self._eyes = SimulatedEyes(seen, drawn, self._world, backend, settings, rate)
        self._now: Callable[[], int] | None = None
        self.description = structs.replace(
            RobotDescription.of(scene.robots[0], rate),
            objects=[*self._objects],
            cameras=self._eyes.cameras,
            arranges=True,
            direct=direct,
            simulated=backend,
        )
        """Robot of the scene, with the tracked objects."""
        self._random = np.random.default_rng(self.imperfections.seed)
        self._waiting: deque[JointTargets] = deque()
        self._delay = round(self.imperfections.delay * rate)
        # The follower's targets are finite: looking again at each cycle would take 60 us.
        joints = range(len(self.description.joints))
        self._writers = [self._robot.target_writer(each, joints, checked=False) for each in JointTarget]
        self._add_friction()

    def read(self) -> Measurement:
        noise, random = self.imperfections, self._random
        numbers = (self._robot.joint_positions, self._robot.joint_velocities, self._robot.joint_efforts)
        positions, velocities, efforts = (tensor[0].cpu().numpy().astype(np.float64) for tensor in numbers)
        if noise.position_noise:
            positions = positions + random.normal(0.0, noise.position_noise, positions.shape)
        if noise.velocity_noise:
            velocities = velocities + random.normal(0.0, noise.velocity_noise, velocities.shape)
        objects = [self._tracked(thing.root_pose, thing.root_velocity) for thing in self._objects.values()]
        return Measurement(positions, velocities, efforts, objects)

    def drive(self, targets: JointTargets) -> None:
        self._waiting.append(targets)
        # Until then the drives hold the targets that they have.
        if len(self._waiting) > self._delay:
            due = self._waiting.popleft()
            for writer, values in zip(self._writers, (due.positions, due.velocities, due.efforts), strict=True):
                writer(_row(values))
        self._world.step(1)
        if self._now is not None:
            self._eyes.offer(self._now())

    def watch(self, sink: Callable[[Picture], None], now: Callable[[], int]) -> None:
        if self.description.cameras:
            self._eyes.start(sink)
            self._now = now

    def look(self, camera: str, kind: PictureKind, stamp: int) -> Picture:
        return self._eyes.look(camera, kind, stamp)

    def arrange(self, arrangement: Arrangement) -> Measurement:
        if arrangement.reset:
            self._world.reset()
        if arrangement.positions is not None:
            self._robot.set_joint_state(_row(np.array(arrangement.positions)))
            # Written positions leave velocities as they are.
            self._robot.set_joint_state(velocities=torch.zeros(1, len(self.description.joints)))
        if arrangement.object:
            if arrangement.object not in self.description.objects:
                raise UnknownNameError(
                    "object", arrangement.object, self.description.objects, "the simulated robot's scene"
                )
            if arrangement.pose is not None:
                thing = self._objects[arrangement.object]
                thing.set_root_pose(_row(np.array(arrangement.pose)))
                thing.set_root_velocity(torch.zeros(1, 6))
        # Delayed targets of the motion before would pull the robot back.
        self._waiting.clear()
        return self.read()

    def close(self) -> None:
        self._eyes.close()
        self._world.close()

    def _tracked(self, pose: torch.Tensor, velocity: torch.Tensor) -> list[float]:
        numbers = [*pose[0].tolist(), *velocity[0].tolist()]
        if self.imperfections.object_noise:
            numbers[:3] = (
                np.array(numbers[:3]) + self._random.normal(0.0, self.imperfections.object_noise, 3)
            ).tolist()
        return numbers

    def _add_friction(self) -> None:
        if not self.imperfections.friction:
            return
        limits = self.description.limits.effort
        # Joints without a limit have no share of it, and mimics no drive.
        driven = [i for i in range(len(limits)) if np.isfinite(limits[i]) and self._robot.joints[i].mimic is None]
        own = np.array([self._robot.joints[i].friction for i in driven])
        self._robot.set_joint_parameters(
            friction=_row(own + self.imperfections.friction * limits[driven]), joints=driven
        )


def _with_network(spec: RobotSpec, file: Path) -> RobotSpec:
    """Return a robot whose drives of positions are an actuator network.

    Raises:
        ConfigurationError: it has no such drives.
    """
    drives = [isinstance(group, ImplicitPd) and group.stiffness > 0.0 for group in spec.actuators]
    if not any(drives):
        raise ConfigurationError(f"no drive of '{spec.articulation.name}' follows positions, as the network does")
    groups = (
        ActuatorNetwork(
            joints=group.joints,
            file=str(file),
            effort_limit=group.effort_limit,
            velocity_limit=group.velocity_limit,
            armature=group.armature,
            friction=group.friction,
        )
        if drive
        else group
        for group, drive in zip(spec.actuators, drives, strict=True)
    )
    return replace(spec, actuators=tuple(groups))


def _row(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.asarray(values, np.float32))[None]
