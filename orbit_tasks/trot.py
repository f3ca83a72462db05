"""An open-loop trot for quadrupeds: diagonal feet swing together, placed after the commanded velocity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import quat_rotate_inverse
from orbit_core.envs import Task
from orbit_core.interfaces import ConfigurationError, Node, Port, World
from orbit_core.mdp import common
from orbit_core.motion import JointPosition


@dataclass(frozen=True)
class Gait:
    """Timing and size of the steps."""

    period: float = 0.25
    """Seconds for a step of each foot."""
    stance: float = 0.5
    """Part of the period that a foot is on the ground."""
    swing_height: float = 0.06
    """Metres."""
    integral_gain: float = 1.0
    """1/s, of the velocity error: soft drives and slipping feet take part of each stride away."""


class TrotGenerator(Node):
    """Gives the action whose joint targets put each foot where the gait wants it, in the trunk's frame.

    Drives of a walking robot are soft: targets lie beyond the wanted positions by what the robot's weight, shared by
    the feet on the ground, deflects them. The gait keeps its balance, but falls short of fast commands: it is something
    to compare policies with, no expert.

    Args:
        world: of a quadruped.
        task: its actions are joint positions.
        command: (N, 3) forward and sideways velocity in m/s and yaw rate in rad/s, in the trunk's axes; read at each
            turn.
        gait: timing and size of the steps.

    Raises:
        ConfigurationError: the actions are others, or the robot has not four feet.
    """

    def __init__(self, world: World, task: Task, command: Tensor, gait: Gait | None = None) -> None:
        self.name = "policy"
        generator = task.generators[0]
        if not isinstance(generator, JointPosition):
            raise ConfigurationError(f"a trot gives joint positions: action '{task.action}' does not take them")
        self._generator = generator
        self.outputs = (Port("action", (generator.command_size,)),)
        self._task, self._command = task, command
        self._gait = gait or Gait()
        self._dt = task.physics_dt * task.decimation
        self._robot = common.robot_of(world)
        self._feet = self._robot.spec.feet
        if len(self._feet) != 4:
            raise ConfigurationError(f"a trot needs a robot with four feet; '{task.robot}' has {len(self._feet)}")
        articulation = self._robot.spec.articulation
        self._tree = KinematicTree(articulation, world.device)
        self._root = torch.tensor([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], device=world.device).expand(world.num_envs, 7)
        self._positions = self._robot.home_positions.repeat(world.num_envs, 1)
        self._correction = torch.zeros(world.num_envs, 3, device=world.device)
        poses = self._tree.forward(self._root[:1], self._positions[:1])
        self._neutral = torch.cat([self._tree.frame_pose(poses, foot)[:, None, :3] for foot in self._feet], dim=1)
        # Feet on opposite corners of the trunk step together.
        self._offset = 0.5 * (self._neutral[0, :, 0] * self._neutral[0, :, 1] > 0).float()
        stiffness = self._robot.spec.actuators[0].stiffness
        self._load_per_stiffness = -articulation.mass * world.scene.gravity[2] / stiffness

    def memory(self) -> Mapping[str, Tensor]:
        return {"positions": self._positions, "correction": self._correction}

    def reset(self, env_ids: Tensor | None = None) -> None:
        rows = slice(None) if env_ids is None else env_ids
        self._positions[rows] = self._robot.home_positions
        self._correction[rows] = 0.0

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        self.reset((self._task.episode_step == 0).nonzero().squeeze(-1))
        error = self._command - self._measured()
        self._correction.add_(error, alpha=self._gait.integral_gain * self._dt).clamp_(-1.0, 1.0)
        time = self._task.episode_step * self._dt
        phase = torch.remainder(time[:, None] / self._gait.period + self._offset, 1.0)
        standing = phase < self._gait.stance
        load = self._load_per_stiffness * standing / standing.sum(1, keepdim=True).clamp_min(1)
        wanted = self._foot_positions(phase, standing)
        # One Newton step a turn follows a path that moves by millimetres a turn.
        poses = self._tree.forward(self._root, self._positions)
        deflection = torch.zeros_like(self._positions)
        for index, foot in enumerate(self._feet):
            jacobian = self._tree.jacobian(poses, foot)[:, :3]
            error = wanted[:, index] - self._tree.frame_pose(poses, foot)[:, :3]
            self._positions += (torch.linalg.pinv(jacobian) @ error[..., None]).squeeze(-1)
            deflection -= jacobian[:, 2] * load[:, index, None]
        targets = self._positions + deflection
        return {"action": self._generator.encode_positions(targets[:, self._generator.joints])}

    def _foot_positions(self, phase: Tensor, standing: Tensor) -> Tensor:
        """(N, 4, 3) in the trunk's frame."""
        gait = self._gait
        progress = torch.where(standing, phase / gait.stance, (phase - gait.stance) / (1.0 - gait.stance))
        velocity = self._ground_velocity(self._command + self._correction)
        half_stride = 0.5 * gait.stance * gait.period * velocity
        # On the ground a foot moves back under the trunk at the commanded velocity; in the air it returns ahead.
        along = torch.where(standing, 1.0 - 2.0 * progress, -torch.cos(torch.pi * progress))
        height = torch.where(standing, 0.0, gait.swing_height * torch.sin(torch.pi * progress))
        return self._neutral + torch.cat((along[..., None] * half_stride, height[..., None]), dim=2)

    def _ground_velocity(self, motion: Tensor) -> Tensor:
        """(N, 4, 2) of the trunk's points above the feet, for planar motion (N, 3)."""
        x, y = self._neutral[..., 0], self._neutral[..., 1]
        turn = torch.stack((-y, x), dim=2) * motion[:, None, 2:]
        return motion[:, None, :2] + turn

    def _measured(self) -> Tensor:
        pose, velocity = self._robot.root_pose, self._robot.root_velocity
        linear = quat_rotate_inverse(pose[:, 3:], velocity[:, :3])
        return torch.cat((linear[:, :2], velocity[:, 5:]), dim=1)
