"""Base of control laws for compliant motion of the hand: goal, gains, and dynamics of the hand's frame.

Khatib, A Unified Approach for Motion and Force Control of Robot Manipulators: The Operational Space Formulation, IEEE
Journal on Robotics and Automation 3(1), 1987. With the Jacobian J of a frame, ``x' = J v`` and ``x'' = J a + J' v``;
``Lambda = (J M^-1 J^T)^-1`` is the inertia that the frame shows. Joint accelerations

``a = M^-1 J^T Lambda (x''* - J' v - J a0) + a0``

give the frame the acceleration x''*, and what joints are left free by it the acceleration a0 (dynamically consistent
null space), which draws them home here.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol

import torch
from torch import Tensor

from orbit_core.actions.arm_dynamics import ArmDynamics, ArmState
from orbit_core.actions.base import CommandMode, LastTargets, MotionGenerator
from orbit_core.actions.differential_ik import PoseTermConfig
from orbit_core.actions.ik import COMPONENTS, PoseFollower
from orbit_core.dynamics.arguments import FINITE, check_numbers
from orbit_core.dynamics.kinematics import PointJacobian
from orbit_core.dynamics.linear import solve_spd
from orbit_core.dynamics.rigid_body import workspace_positions
from orbit_core.dynamics.transforms import pose_error
from orbit_core.interfaces import ConfigurationError, JointTarget, Object, Robot, World
from orbit_core.interfaces.layout import joint_limits
from orbit_core.scene import Entity, RobotSpec, Scene
from orbit_motion.fusion import Fused
from orbit_motion.gains import CommandedGains, GainCommand, GainRange

# Motion generators whose law runs before every physics step, like the law of a torque-controlled robot.
# A command sets the law's aims; in between the law follows the measured state. It requests accelerations, which are
# clamped to what the joints' position and velocity limits allow, and become efforts by the equation of motion:
#
# ``efforts = M(q) a + bias(q, v)``, clipped to the effort limits (computed torque; Siciliano et al., Robotics:
# Modelling, Planning and Control, 2009, section 8.5.2).
#
# Dry friction of the description is compensated (:meth:`ArmDynamics.against_friction`).

# 1/s: a joint near a position limit approaches it at most at this rate times the remaining distance.
_LIMIT_RATE = 10.0
# Physics steps within which a joint that is too fast brakes to its velocity limit.
_BRAKING_STEPS = 2.0


class Servo(MotionGenerator):
    """Motion generator that computes efforts for some joints of a robot before every physics step.

    The drives of the joints have no gains (:attr:`~orbit_core.actions.ActionTerm.unwanted_gains`).

    Raises:
        ConfigurationError: a joint has no effort limit above zero.
    """

    dynamics: ArmDynamics
    """Equation of motion of the joints."""
    physics_dt: float
    """Seconds of a physics step."""
    law: Fused
    """Efforts from the robot's state and the aims."""

    def __init__(self, name: str, robot: Robot, joints: Sequence[int], command_size: int) -> None:
        super().__init__(name, robot, joints, command_size, ())
        efforts, speeds = (joint_limits(robot.spec, what)[self.joints] for what in ("effort_limit", "velocity_limit"))
        for joint, effort in zip(self.joints, efforts, strict=True):
            if not effort > 0.0:
                raise ConfigurationError(
                    f"joint '{robot.joint_names[joint]}' of '{robot.name}' has effort limit {effort:g}, so action term "
                    f"'{name}' cannot move it by efforts: choose a position space, or raise the limit"
                )
        self._strongest, self._fastest = (
            torch.as_tensor(limits, dtype=torch.float32, device=self.device) for limits in (efforts, speeds)
        )

    @abstractmethod
    def aim(self, command: Tensor) -> None:
        """Set the aims from a command (N, command_size)."""

    @abstractmethod
    def aims(self) -> dict[str, Tensor]:
        """Return the aims by name: all tensors (N, ...) that the law depends on, except the robot's state."""

    @abstractmethod
    def accelerations(self, state: ArmState, aims: Mapping[str, Tensor]) -> Tensor:
        """Compute the accelerations (N, k) in rad/s^2 or m/s^2 that the joints should have now.

        The result depends on the arguments and on constants only, so that it can become one kernel
        (:class:`orbit_motion.fusion.Fused`).
        """

    def check_stable(self) -> None:
        """Refuse gains with which steps of ``physics_dt`` diverge.

        Raises:
            ConfigurationError: a gain is too high; the message names a stable one.
        """

    def enter(self, world: World, step_dt: float) -> None:
        self.physics_dt = world.physics_dt
        self.dynamics = ArmDynamics(self.robot, self.joints, world.physics_dt, world.scene.gravity)
        self.check_stable()
        self.law = Fused(self._efforts)
        # The law clamps its efforts, and commands are checked as they come, so that no physics step checks them again.
        self._write = self.robot.target_writer(JointTarget.EFFORT, self.joints, checked=False)
        world.add_servo(self.turn)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        # A clamp passes NaN on: what is no number must not reach the law.
        check_numbers(inputs["command"], FINITE, f"command of '{self.name}' for robot '{self.robot.name}'")
        self.aim(inputs["command"])
        return {}

    def turn(self) -> None:
        """Set the efforts for the next physics step; the world calls it."""
        (efforts,) = self.law(**self.dynamics.measured(), **self.aims())
        self._write(efforts)

    def _efforts(self, poses: Tensor, positions: Tensor, velocities: Tensor, **aims: Tensor) -> tuple[Tensor]:
        """Compute the efforts (N, k) from the robot's state and the aims."""
        state = self.dynamics.state_of(poses, positions, velocities)
        wanted = self._within_limits(state, self.accelerations(state, aims))
        efforts = self.dynamics.against_friction(state, wanted, state.efforts(wanted))
        return (torch.clamp(efforts, -self._strongest, self._strongest),)

    def _within_limits(self, state: ArmState, accelerations: Tensor) -> Tensor:
        # Velocity limits shrink towards a position limit, so that the joint stops there instead of hitting it.
        highest = torch.minimum(self._fastest, _LIMIT_RATE * (self.upper_limits - state.positions))
        lowest = torch.maximum(-self._fastest, _LIMIT_RATE * (self.lower_limits - state.positions))
        time = _BRAKING_STEPS * self.physics_dt
        return torch.clamp(accelerations, (lowest - state.velocities) / time, (highest - state.velocities) / time)


def check_rate(name: str, load: float, what: str) -> None:
    """Refuse ``load``, the largest ``h^2 k + 2 h d`` over the inertia, where steps of h seconds diverge.

    See :mod:`orbit_core.actuators.stability`.

    Raises:
        ConfigurationError: ``load`` is four or more.
    """
    # A spring and damper whose force is explicit diverges under semi-implicit Euler from h^2 k / m + 2 h d / m = 4.
    if load >= 4.0:
        raise ConfigurationError(
            f"action term '{name}': {what} is unstable, because its efforts use the state at the beginning of "
            f"each physics step: take at most {4.0 / load:.2g} times it, or a shorter physics_dt"
        )


# Copy of a world at one moment, for plans that take longer than a step while the world moves on -----------------------


class PlacedObject(Protocol):
    """Interface of an object that planning reads, shaped like :class:`orbit_core.interfaces.Object`."""

    @property
    def spec(self) -> Entity:
        """Specification that the entity was made from."""
        ...

    @property
    def root_pose(self) -> Tensor:
        """Pose (N, 7) in the environment's frame."""
        ...

    @property
    def link_poses(self) -> Tensor:
        """Poses (N, links, 7) in the environment's frame."""
        ...


class PlacedRobot(Protocol):
    """Interface of a robot that planning reads."""

    name: str
    """Name in the scene."""
    joint_names: tuple[str, ...]
    """Names of the movable joints."""
    link_names: tuple[str, ...]
    """Names of the links."""

    @property
    def spec(self) -> RobotSpec:
        """Specification that the entity was made from."""
        ...

    @property
    def root_pose(self) -> Tensor:
        """Pose (N, 7) in the environment's frame."""
        ...

    @property
    def joint_positions(self) -> Tensor:
        """Joint positions (N, joints) in rad or m."""
        ...

    @property
    def home_positions(self) -> Tensor:
        """Joint positions (joints,) at reset."""
        ...

    @property
    def position_limits(self) -> Tensor:
        """Lower and upper limits (joints, 2)."""
        ...


class PlacedWorld(Protocol):
    """Interface of a world that planning reads."""

    scene: Scene
    """Scene that robots and objects are from."""
    num_envs: int
    """Number N of environments."""
    device: torch.device
    """Device of all tensors."""

    @property
    def objects(self) -> Mapping[str, PlacedObject]:
        """Objects by name."""
        ...


@dataclass(eq=False)
class StillObject:
    """A :class:`PlacedObject` in one environment."""

    spec: Entity
    """Description in the scene."""
    root_pose: Tensor
    """(1, 7) in the environment's frame."""
    link_poses: Tensor
    """(1, L, 7) in the environment's frame."""


@dataclass(eq=False)
class StillRobot:
    """A :class:`PlacedRobot` in one environment."""

    name: str
    """Name in the scene."""
    joint_names: tuple[str, ...]
    """Names of the movable joints."""
    link_names: tuple[str, ...]
    """Names of the links."""
    spec: RobotSpec
    """Description in the scene."""
    root_pose: Tensor
    """(1, 7) in the environment's frame."""
    joint_positions: Tensor
    """(1, J) rad or m."""
    home_positions: Tensor
    """(J,) rad or m."""
    position_limits: Tensor
    """(J, 2) rad or m."""


@dataclass(eq=False)
class StillWorld:
    """A :class:`PlacedWorld` of one environment, and one of its robots."""

    scene: Scene
    """Scene that robot and objects are from."""
    num_envs: int
    """1."""
    device: torch.device
    """Device of all tensors."""
    objects: Mapping[str, PlacedObject]
    """Objects by name."""
    robot: StillRobot
    """Robot that is planned for."""

    @staticmethod
    def of(world: World, robot: Robot, env: int = 0) -> StillWorld:
        """Return a copy of one environment as it now is, which any thread may read."""
        objects = {name: _still_object(thing, env) for name, thing in world.objects.items()}
        copied = StillRobot(
            robot.name,
            robot.joint_names,
            robot.link_names,
            robot.spec,
            *(part[env : env + 1].clone() for part in (robot.root_pose, robot.joint_positions)),
            *(part.clone() for part in (robot.home_positions, robot.position_limits)),
        )
        return StillWorld(world.scene, 1, world.device, objects, copied)


def _still_object(thing: Object, env: int) -> StillObject:
    poses = (part[env : env + 1].clone() for part in (thing.root_pose, thing.link_poses))
    return StillObject(thing.spec, *poses)


# Added to the inverse inertia (1/kg and 1/(kg m^2)), so that efforts stay bounded in singular poses.
_REGULAR = 1e-4


@dataclass(frozen=True, kw_only=True)
class CompliantConfig(PoseTermConfig):
    """A command is a pose of the hand, or its change, and, if asked for, six stiffnesses and six damping ratios."""

    unwanted_gains: ClassVar[tuple[str, ...]] = ("stiffness", "damping")
    none_below_zero: ClassVar[tuple[str, ...]] = (
        "stiffness", "rotational_stiffness", "damping_ratio", "posture_stiffness",
    )  # fmt: skip

    mode: CommandMode = CommandMode.INTEGRATED
    position_lead: float = 0.1
    rotation_lead: float = 0.5
    stiffness: float = 150.0
    """Stiffness of the hand's position."""
    rotational_stiffness: float = 150.0
    """Stiffness of the hand's rotation."""
    damping_ratio: float = 1.0
    """1 is critical: the hand comes to its goal without overshoot."""
    gains: GainCommand = GainCommand.FIXED
    """Gains that the command sets, besides the pose."""
    stiffness_factor: GainRange = GainRange(low=0.1, high=4.0)
    """Factor of the stiffnesses, from the command's -1 to its 1."""
    ratio_range: GainRange = GainRange(low=0.5, high=2.0)
    """Damping ratio, from the command's -1 to its 1."""
    posture_stiffness: float = 10.0
    """1/s^2: draws joints home, critically damped, where that does not move the hand."""

    def components(self, spec: RobotSpec, name: str) -> tuple[str, ...]:
        return (*COMPONENTS, *CommandedGains.components(self.gains, COMPONENTS))


@dataclass(frozen=True, eq=False)
class HandState:
    """The frame's motion: measured pose (N, 7), velocity (N, 6), and its response to efforts."""

    pose: Tensor
    """(N, 7) in the environment's frame."""
    velocity: Tensor
    """(N, 6) m/s and rad/s, world axes."""
    jacobian: Tensor
    """Jacobian of the frame, (N, 6, k)."""
    response: Tensor
    """``M^-1 J^T``, (N, k, 6): joint accelerations per unit of wrench at the frame."""
    inverse_inertia: Tensor
    """``J M^-1 J^T``, (N, 6, 6), regularised."""
    drift: Tensor
    """``J' v``, (N, 6)."""
    links: Tensor
    """Poses of all links, (N, L, 7)."""

    def wrench(self, acceleration: Tensor) -> Tensor:
        """Return the wrench (N, 6) that accelerates the frame by (N, 6), as if at rest."""
        return solve_spd(self.inverse_inertia, acceleration.unsqueeze(-1)).squeeze(-1)

    def joint_accelerations(self, wrench: Tensor) -> Tensor:
        """Return the joint accelerations (N, k) that a wrench (N, 6) causes."""
        return torch.bmm(self.response, wrench.unsqueeze(-1)).squeeze(-1)


class Compliant(PoseFollower, Servo):
    """Six commands, or more for gains, :class:`CompliantConfig`."""

    def __init__(self, name: str, robot: Robot, config: CompliantConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        super().__init__(name, robot, joints, len(config.components(robot.spec, name)))
        self.frame = config.frame_of(robot)
        self.gains = CommandedGains(
            config.gains, [config.stiffness] * 3 + [config.rotational_stiffness] * 3, config.damping_ratio,
            config.stiffness_factor, config.ratio_range, self.num_envs, self.device,
        )  # fmt: skip
        """Stiffnesses and damping ratios, fixed or commanded."""
        self._pose = config.pose_command(robot)
        self._goal = LastTargets(self.num_envs, (7,), self.device)
        self._home = robot.home_positions[joints]
        self._posture = config.posture_stiffness
        self._jacobian = PointJacobian(robot.spec.articulation, link_of(robot, self.frame), joints, self.device)
        self._regular = _REGULAR * torch.eye(6, device=self.device)

    @abstractmethod
    def hand_accelerations(self, hand: HandState, free: Tensor, aims: Mapping[str, Tensor]) -> Tensor:
        """Return joint accelerations (N, k); ``free`` (N, k) are those of the null space, which leave the hand in
        place.
        """

    def workspace_mobility(self) -> Tensor:
        """Compute ``J M^-1 J^T`` of the frame (P, 6, 6), float64, in P postures all over the workspace."""
        positions = torch.as_tensor(workspace_positions(self.robot.spec.articulation), device=self.device).float()
        model = self.dynamics.model
        root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]], device=self.device)
        poses = model.kinematics.forward(root.repeat(len(positions), 1), positions)
        jacobian = model.kinematics.jacobian(poses, self.frame)[:, :, self.joints].double()
        mass = model.mass_matrix(poses)[:, self.joints][:, :, self.joints].double()
        return jacobian @ torch.linalg.solve(mass, jacobian.mT)

    def check_posture(self) -> None:
        """Reject a posture's stiffness with which physics steps diverge."""
        step, stiffness = self.physics_dt, self._posture
        # Load of a critically damped spring: (step w)^2 + 2 zeta step w, with w^2 = stiffness, doubled for its damper.
        load = step**2 * stiffness + 4.0 * step * stiffness**0.5
        check_rate(self.name, load, f"a posture_stiffness of {stiffness:g}")

    def aim(self, command: Tensor) -> None:
        self._goal.keep(self._pose.target(command[:, :6]))
        self.gains.take(command[:, 6:])

    def aims(self) -> dict[str, Tensor]:
        return {**self._goal.parts(), **self.gains.varying()}

    def accelerations(self, state: ArmState, aims: Mapping[str, Tensor]) -> Tensor:
        # Critically damped towards home: the damping is 2 sqrt(stiffness).
        free = self._posture * (self._home - state.positions) - 2.0 * self._posture**0.5 * state.velocities
        return self.hand_accelerations(self.hand_state(state), free, aims)

    def hand_state(self, state: ArmState) -> HandState:
        """Return the hand's state for an arm's state."""
        pose = self.dynamics.model.kinematics.frame_pose(state.poses, self.frame)
        jacobian = self._jacobian(state.poses, pose[:, :3])
        response = solve_spd(state.mass, jacobian.mT)
        inverse = torch.bmm(jacobian, response) + self._regular
        velocity = torch.bmm(jacobian, state.velocities.unsqueeze(-1)).squeeze(-1)
        drift = self.dynamics.drift(state, self.frame)
        return HandState(pose, velocity, jacobian, response, inverse, drift, state.poses)

    def error(self, hand: HandState, aims: Mapping[str, Tensor]) -> Tensor:
        """Return the error (N, 6) from the measured pose to the goal."""
        return pose_error(hand.pose, LastTargets.read_of(aims, hand.pose))

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return torch.cat((self._pose.encode(pose), self.gains.encode(self.num_envs)), 1)

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._pose.reset(env_ids)
        self._goal.reset(env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        pose = {f"pose_{key}": value for key, value in self._pose.memory().items()}
        return {**pose, **self._goal.memory(), **self.gains.memory()}


def link_of(robot: Robot, frame: str) -> int:
    """Return the index of the link that carries a link's own or a named frame."""
    return robot.link_names.index(robot.spec.articulation.frame(frame).link)


def without_free(hand: HandState, free: Tensor) -> Tensor:
    """Return the frame's acceleration (N, 6) without the task: ``J' v + J a0``."""
    return hand.drift + torch.bmm(hand.jacobian, free.unsqueeze(-1)).squeeze(-1)
