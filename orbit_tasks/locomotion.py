"""Commands are velocities of a walking robot's trunk; a learned policy moves the legs at its own rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import Tensor

from orbit_assets.catalogue import robot, robot_names
from orbit_core.actions import ActionTerm, MotionGenerator, preset_terms
from orbit_core.actions.base import JointTarget
from orbit_core.actions.embodiment import leg_joints
from orbit_core.actions.mobile_base import ROUNDING
from orbit_core.dynamics.indexing import write_rows
from orbit_core.dynamics.transforms import pose_error, quat_rotate_inverse
from orbit_core.interfaces import ConfigurationError, Robot, World
from orbit_core.scene import RobotSpec
from orbit_learn.policy import Policy, load_policy
from orbit_learn.pretrained import policy_path
from orbit_tasks.walking import COMMAND, JOINT_READINGS, LAST_ACTION, READINGS, carries_arm

# 1/s: the velocity that an expert asks for, over the displacement that is left.
_PURSUIT_RATE = 1.0


@dataclass(frozen=True, kw_only=True)
class LocomotionConfig(ActionTerm):
    """A command is a velocity of a walking robot's trunk, (forward, left, turn) in its own axes; a policy walks at it.

    The policy is one learned by a walking task, Velocity-Flat as a rule, for a robot with the same joints: it sees the
    robot and the velocity, and gives the commands of the action space that it was learned with. It is asked at the rate
    that it was learned at, independent of the task's.

    ``joints`` are those that the policy moves, and sees, unless it was learned to see all. None takes all; of a robot
    on more than two feet that carries an arm, those of its legs.
    """

    name: ClassVar[str] = "locomotion"
    above_zero: ClassVar[tuple[str, ...]] = ("max_forward", "max_sideways", "max_yaw_rate")

    policy: str = "velocity_flat"
    """Name of a kept policy ('orbit list policies'), or path of a policy's file or folder."""
    max_forward: float = 1.0
    """m/s of one unit of command, as far as the policy learned to go; so are the next two."""
    max_sideways: float = 0.5
    """m/s"""
    max_yaw_rate: float = 1.0
    """rad/s"""

    @property
    def limits(self) -> tuple[float, float, float]:
        """Velocity of a command of 1: m/s forward, m/s to the left, rad/s."""
        return (self.max_forward, self.max_sideways, self.max_yaw_rate)

    def default_joints(self, spec: RobotSpec) -> Sequence[str]:
        return leg_joints(spec) if carries_arm(spec) else super().default_joints(spec)

    def components(self, spec: RobotSpec, name: str) -> tuple[str, ...]:
        return ("forward", "left", "turn")

    def build(self, name: str, robot: Robot) -> Locomotion:
        return Locomotion(name, robot, self)


class Locomotion(MotionGenerator):
    """Three commands, :class:`LocomotionConfig`.

    Raises:
        OrbitError: there is no such policy.
        ConfigurationError: it sees what a robot alone does not show, or was learned for a robot of other joints.
    """

    def __init__(self, name: str, robot: Robot, config: LocomotionConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        super().__init__(name, robot, joints, 3, (JointTarget.POSITION,))
        self._policy = load_policy(policy_path(config.policy), self.device)
        self._check_seen(self._policy, config.policy)
        self._sizes = {part.name: part.size for part in self._policy.description.observation_parts}
        self._lower = self._legs(self._policy)
        self._limits = torch.tensor(config.limits, device=self.device)
        self.clamped = torch.zeros(self.num_envs, dtype=torch.int64, device=self.device)
        """(N,) commands since the reset that asked for more than the limits, and were kept to them."""
        self._velocity = torch.zeros(self.num_envs, 3, device=self.device)
        self._legs_command = torch.zeros(self.num_envs, self._lower.command_size, device=self.device)
        self._check_sizes(self._policy, config.policy)
        self._check_joints(self._policy.description.robot, config.policy)
        self._waited = torch.zeros(self.num_envs, dtype=torch.int64, device=self.device)
        self._every, self._each, self._since = 1, 0, 0

    def enter(self, world: World, step_dt: float) -> None:
        """Raises ConfigurationError where the policy's rate and the task's are no multiples of each other."""
        period = self._policy.description.step_dt
        steps, commands = period / world.physics_dt, period / step_dt
        slower, faster = round(commands), round(1.0 / commands)
        if min(abs(steps - round(steps)), 1.0) > 1e-6 or min(abs(commands - slower), abs(1 / commands - faster)) > 1e-6:
            raise ConfigurationError(
                f"action term '{self.name}': its policy acts every {period:g} s, the task every {step_dt:g} s in "
                f"physics steps of {world.physics_dt:g} s: make one period a multiple of the other"
            )
        self._every = max(slower, 1)
        if faster > 1:
            # The policy acts several times within a control step: a servo asks it between physics steps.
            self._each = round(steps)
            world.add_servo(self._turn)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        command = inputs["command"]
        # More than rounding beyond one: callers that compute their commands reach the limit by a last bit too much.
        self.clamped += command.abs().amax(1) > 1.0 + ROUNDING
        self._velocity.copy_(command.clamp(-1.0, 1.0) * self._limits)
        # A command begins a period, and the first turn is taken at once below.
        self._since = 0
        if self._every == 1:
            self._legs_command.copy_(self._asked())
        else:
            # Counted for each environment, because a reset begins a new period there only.
            due = (self._waited % self._every == 0).unsqueeze(1)
            self._legs_command.copy_(torch.where(due, self._asked(), self._legs_command))
            self._waited.add_(1)
        return self._lower.compute({"command": self._legs_command})

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        """The command (N, 3) that walks the trunk towards a pose (N, 7), of which height and tilt do not count."""
        root = self.robot.root_pose
        error = pose_error(root, pose)
        along = quat_rotate_inverse(root[:, 3:], error[:, :3])[:, :2]
        return (_PURSUIT_RATE * torch.cat((along, error[:, 5:]), 1) / self._limits).clamp(-1.0, 1.0)

    def reset(self, env_ids: Tensor | None = None) -> None:
        write_rows(self._legs_command, 0.0, env_ids)
        write_rows(self._waited, 0, env_ids)
        write_rows(self.clamped, 0, env_ids)
        self._lower.reset(env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        own = {"velocity": self._velocity, "legs_command": self._legs_command}
        return own | {"waited": self._waited, "clamped": self.clamped}

    @property
    def base_limits(self) -> Tensor:
        return self._limits

    def _turn(self) -> None:
        """Before each physics step: query the policy again where its period is over within a control step."""
        if self._since and self._since % self._each == 0:
            self._legs_command.copy_(self._asked())
            targets = self._lower.compute({"command": self._legs_command})
            self.robot.set_position_targets(targets[JointTarget.POSITION], self.joints)
        self._since += 1

    def _asked(self) -> Tensor:
        """(N, A) the policy's action now."""
        with torch.no_grad():
            parts = {part.name: self._seen(part.name) for part in self._policy.description.observation_parts}
            together = self._policy.description.concatenated
            return self._policy.module(torch.cat([*parts.values()], 1) if together else parts).clamp(-1.0, 1.0)

    def _seen(self, part: str) -> Tensor:
        own = {COMMAND: self._velocity, LAST_ACTION: self._legs_command}
        if part in own:
            return own[part]
        seen = READINGS[part](self.robot)
        # A policy that was learned with this robot sees the arm that its legs carry.
        return seen[:, self._columns] if part in JOINT_READINGS and seen.shape[1] != self._sizes[part] else seen

    def _legs(self, policy: Policy) -> MotionGenerator:
        """The generator that the policy was learned with."""
        action = policy.description.action
        term = preset_terms(self.robot.spec, action).get(action)
        if term is None or len(policy.description.action_parts) != 1:
            raise ConfigurationError(f"action term '{self.name}': its policy's action is '{action}', not of legs alone")
        lower = replace(term, joints=tuple(self.robot.joint_names[joint] for joint in self.joints))
        return lower.build(f"{self.name}_legs", self.robot)

    def _check_seen(self, policy: Policy, source: str) -> None:
        for part in policy.description.observation_parts:
            if part.name not in {COMMAND, LAST_ACTION, *READINGS}:
                raise ConfigurationError(
                    f"action term '{self.name}': policy '{source}' of task {policy.description.task} sees "
                    f"'{part.name}', which a robot alone does not show: choose a policy of Velocity-Flat"
                )

    def _check_joints(self, learned: str, source: str) -> None:
        """Refuse the policy of a robot that has none of these joints; nothing is known of one that is not installed."""
        # The file names a robot of a package that is not here; joint counts are checked all the same.
        if learned not in robot_names():
            return
        known, own = robot(learned).articulation.joint_names, [self.robot.joint_names[joint] for joint in self.joints]
        if not set(own) & set(known):
            raise ConfigurationError(
                f"action term '{self.name}': policy '{source}' was learned with robot '{learned}', which has no joint "
                f"'{own[0]}' as '{self.robot.spec.articulation.name}' has: choose a policy of this robot's legs"
            )

    def _check_sizes(self, policy: Policy, source: str) -> None:
        sizes = {COMMAND: 3, LAST_ACTION: self._lower.command_size}
        for part in policy.description.observation_parts:
            size = sizes.get(part.name) or self._seen(part.name).shape[1]
            if size != part.size:
                raise ConfigurationError(
                    f"action term '{self.name}': policy '{source}' was learned with robot "
                    f"'{policy.description.robot}', of which '{part.name}' has {part.size} components; of "
                    f"'{self.robot.name}' it has {size}: learn one for this robot"
                )
