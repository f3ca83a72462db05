"""Admittance control: an arm that is driven by positions yields to forces as a mass on springs would."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.actions.base import CommandMode, JointTarget
from orbit_core.actions.differential_ik import PoseTermConfig, bounded_targets
from orbit_core.actions.ik import PoseFollower, damped_least_squares, displaced
from orbit_core.dynamics.indexing import write_rows
from orbit_core.dynamics.kinematics import link_ancestry
from orbit_core.dynamics.transforms import pose_error, quat_rotate
from orbit_core.interfaces import ConfigurationError, Robot, World
from orbit_core.interfaces.layout import joint_limits
from orbit_core.scene import ContactSensorSpec, ForceTorqueSpec
from orbit_core.sensors import ContactSensor, ForceTorqueSensor

# Measured wrench that a hand exerts on its surroundings, from the scene's sensors -------------------------------------


class ForceReading:
    """Reader of a sensor as the wrench (N, 6) that the hand exerts: force, then torque about the origin of its frame.

    A contact sensor gives the force alone, of all its links together. A force-torque sensor gives both, less the weight
    of what it carries where the robot's controller does not cancel that; what its load's acceleration takes is left in.

    Args:
        world: with the sensor.
        name: of the sensor.
        robot: that the frame is of.
        frame: a link or frame.
        term: name of the action term, for messages.

    Raises:
        UnknownNameError: there is no such sensor.
        ConfigurationError: it is of another kind, or of another robot.
    """

    def __init__(self, world: World, name: str, robot: Robot, frame: str, term: str) -> None:
        self._sensor = world.sensors[name]
        self._robot, self._frame = robot, frame
        spec = self._sensor.spec
        if not isinstance(spec, ContactSensorSpec | ForceTorqueSpec):
            raise ConfigurationError(
                f"action term '{term}' reads forces from sensor '{name}', a {type(spec).__name__}: name a contact "
                "sensor or a force-torque sensor"
            )
        if spec.entity != robot.name:
            raise ConfigurationError(
                f"action term '{term}' of robot '{robot.name}' reads forces from sensor '{name}', which is on "
                f"'{spec.entity}': name one of the robot's own"
            )
        self.has_torque = isinstance(spec, ForceTorqueSpec)
        """True if torques are measured."""
        if isinstance(spec, ForceTorqueSpec):
            self._link = robot.link_names.index(spec.link)
            self._prepare_weight(world)

    def _prepare_weight(self, world: World) -> None:
        articulation, device = self._robot.spec.articulation, world.device
        # The sensor also feels the weight of all links beyond it.
        carried = [int(link) for link in link_ancestry(articulation)[:, self._link].nonzero()[0]]
        weightless = self._robot.spec.gravity_compensation
        gravity = torch.tensor([0.0, 0.0, 0.0] if weightless else world.scene.gravity, device=device)
        self._carried = torch.tensor(carried, dtype=torch.int64, device=device)
        self._centers = torch.tensor([articulation.links[i].center_of_mass for i in carried], device=device)
        masses = torch.tensor([[articulation.links[i].mass] for i in carried], device=device)
        self._weights = masses * gravity

    def read(self) -> Tensor:
        """Read the wrench (N, 6) in N and N m, world axes."""
        sensor = self._sensor
        if isinstance(sensor, ContactSensor):
            # A contact sensor reports the force on its links; the hand exerts the opposite.
            force = -sensor.forces.sum(1)
            return torch.cat((force, torch.zeros_like(force)), 1)
        assert isinstance(sensor, ForceTorqueSensor)
        poses = self._robot.link_poses
        point = self._robot.frame_pose(self._frame)[:, :3]
        link = poses[:, self._link]
        force, torque = (quat_rotate(link[:, 3:], part) for part in sensor.wrench.split(3, 1))
        # The torque is moved from the sensor's link to the frame's origin.
        torque = torque + torch.linalg.cross(link[:, :3] - point, force)
        carried = poses.index_select(1, self._carried)
        arms = carried[..., :3] + quat_rotate(carried[..., 3:], self._centers) - point.unsqueeze(1)
        weights = self._weights.expand_as(arms)
        return torch.cat((force + weights.sum(1), torque + torch.linalg.cross(arms, weights).sum(1)), 1)


# Rate (1/s) at which targets go beyond the wanted positions, until the drives hold the joints there.
_SAG_RATE = 4.0


@dataclass(frozen=True, kw_only=True)
class AdmittanceConfig(PoseTermConfig):
    """A command is a pose of the hand, or its change, from which measured forces displace the hand.

    The displacement u is that of a mass on springs, ``m u'' + 2 zeta sqrt(k m) u' + k u = f``, f the wrench that the
    hand feels, in world axes, integrated once a command with velocities at the end of the step. Joints follow by
    inverse kinematics and their drives, whose own yielding an integral takes out (Hogan, 1985; Siciliano et al.,
    Robotics, 2009, section 9.2.2). With k = 0 and ``damping`` given the hand can be led by hand.
    """

    name: ClassVar[str] = "admittance"
    above_zero: ClassVar[tuple[str, ...]] = (
        *PoseTermConfig.above_zero, "mass", "inertia", "damping", "max_joint_step",
    )  # fmt: skip
    none_below_zero: ClassVar[tuple[str, ...]] = ("stiffness", "rotational_stiffness", "inverse_damping")
    unbounded: ClassVar[tuple[str, ...]] = (*PoseTermConfig.unbounded, "max_joint_step")

    sensor: str | None = None
    """A contact or force-torque sensor of the scene; it must be named."""
    mode: CommandMode = CommandMode.INTEGRATED
    mass: float = 4.0
    """kg"""
    inertia: float = 0.4
    """kg m^2"""
    stiffness: float = 400.0
    """N/m"""
    rotational_stiffness: float = 30.0
    """N m/rad"""
    damping: tuple[float, float] | None = None
    """N s/m and N m s/rad; None damps critically."""
    inverse_damping: float = 0.05
    """See :func:`orbit_core.actions.ik.joint_delta`."""
    max_joint_step: float = 0.3
    """rad or m by which targets may run ahead of measured positions."""

    def build(self, name: str, robot: Robot) -> Admittance:
        return Admittance(name, robot, self)


class Admittance(PoseFollower):
    """Six commands, :class:`AdmittanceConfig`. Targets are clipped to the joints' limits."""

    def __init__(self, name: str, robot: Robot, config: AdmittanceConfig) -> None:
        super().__init__(
            name, robot, config.joint_indices(robot.spec, name), 6, (JointTarget.POSITION, JointTarget.VELOCITY)
        )
        self.config = config
        """Settings, as the action term gives them."""
        self.frame = config.frame_of(robot)
        self._pose = config.pose_command(robot)
        if config.mode is CommandMode.RELATIVE:
            raise ConfigurationError(
                f"action term '{name}': forces displace the measured pose, from which relative commands count: take "
                "integrated or absolute ones"
            )
        self._mass = self._six(config.mass, config.inertia)
        self._stiffness = self._six(config.stiffness, config.rotational_stiffness)
        # Critical damping of a mass m on a spring k is 2 sqrt(k m).
        critical = 2.0 * (self._stiffness * self._mass).sqrt()
        self._damping = critical if config.damping is None else self._six(*config.damping)
        if not bool((self._damping > 0.0).all()):
            raise ConfigurationError(
                f"action term '{name}': nothing damps a motion without stiffness: give damping, or stiffness above zero"
            )
        speeds = joint_limits(robot.spec, "velocity_limit")[self.joints]
        self._fastest = torch.as_tensor(speeds, dtype=torch.float32, device=self.device)
        self._offset, self._rate = torch.zeros(2, self.num_envs, 6, device=self.device).unbind()
        self._sag = torch.zeros(self.num_envs, len(self.joints), device=self.device)

    def enter(self, world: World, step_dt: float) -> None:
        if self.config.sensor is None:
            raise ConfigurationError(
                f"action term '{self.name}' needs forces: name a contact or force-torque sensor of the scene"
            )
        self._reading = ForceReading(world, self.config.sensor, self.robot, self.frame, self.name)
        self._dt = step_dt
        # Stability of the semi-implicit step in ``compute``: it diverges beyond this stiffness.
        if bool((step_dt**2 * self._stiffness >= 4.0 * self._mass + 2.0 * step_dt * self._damping).any()):
            raise ConfigurationError(
                f"action term '{self.name}': such a stiffness on such a mass is unstable in steps of {step_dt:g} s: "
                "take more mass, less stiffness or more commands a second"
            )

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        reference = self._pose.target(inputs["command"])
        # The sensor measures the force on the hand; the law needs the one that the hand exerts.
        felt = -self._reading.read()
        # The damper acts with the velocity at the end of the step, which bounds every damping.
        rate = self._rate + self._dt / self._mass * (felt - self._stiffness * self._offset)
        self._rate.copy_(rate / (1.0 + self._dt * self._damping / self._mass))
        self._offset.add_(self._dt * self._rate)
        error = pose_error(self.robot.frame_pose(self.frame), displaced(reference, self._offset))
        jacobian = self.robot.jacobian(self.frame, self.joints)
        delta = damped_least_squares(jacobian, error, self.config.inverse_damping)
        # Without velocity targets the drives' dampers would hold the joints back.
        velocities = damped_least_squares(jacobian, self._rate, self.config.inverse_damping)
        most = self.config.max_joint_step
        self._sag.copy_(torch.clamp(self._sag + _SAG_RATE * self._dt * delta, -most, most))
        targets = bounded_targets(self, delta + self._sag, most)
        return {
            JointTarget.POSITION: targets,
            JointTarget.VELOCITY: torch.clamp(velocities, -self._fastest, self._fastest),
        }

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return self._pose.encode(pose)

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._pose.reset(env_ids)
        write_rows(self._offset, 0.0, env_ids)
        write_rows(self._rate, 0.0, env_ids)
        write_rows(self._sag, 0.0, env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        return {**self._pose.memory(), "offset": self._offset, "rate": self._rate, "sag": self._sag}

    def _six(self, linear: float, angular: float) -> Tensor:
        return torch.tensor([linear] * 3 + [angular] * 3, device=self.device)
