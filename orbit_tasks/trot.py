"""An open-loop trot for quadrupeds: diagonal feet swing together, placed after the commanded velocity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import quat_rotate_inverse
from orbit_core.interfaces import ConfigurationError, Node, Port
from orbit_core.motion import JointPosition
from orbit_core.tasks import common

if TYPE_CHECKING:
    from orbit_core.world import SimulatedWorld
    from orbit_tasks.velocity_flat import VelocityFlat


@dataclass(frozen=True)
class Gait:
    """Period (s), height of the swing (m), and the feedback on velocity of Raibert's foot placement (s).

    Raibert, Legged Robots That Balance, MIT Press 1986: a foot lands half a stance ahead of the hip, plus a gain times
    the error of the velocity.
    """

    period: float = 0.5
    swing_height: float = 0.1
    velocity_gain: float = 0.05


class TrotGenerator(Node):
    """Gives the action whose joint targets put each foot where the gait wants it, in the trunk's frame."""

    def __init__(self, world: SimulatedWorld, task: VelocityFlat, gait: Gait | None = None) -> None:
        self.name = "policy"
        generator = task.generators[0]
        if not isinstance(generator, JointPosition):
            raise ConfigurationError(
                f"the trot generator gives joint positions: action '{task.action}' does not take them"
            )
        self._generator = generator
        self.outputs = (Port("action", (self._generator.command_size,)),)
        self._task = task
        self._gait = gait or Gait()
        self._robot = common.robot_of(world)
        self._feet = self._robot.spec.feet
        if len(self._feet) != 4:
            raise ConfigurationError(f"a trot needs a robot with four feet; '{task.robot}' has {len(self._feet)}")
        self._tree = KinematicTree(self._robot.spec.articulation, world.device)
        root = torch.tensor([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], device=world.device)
        self._root = root.expand(world.num_envs, 7)
        self._positions = self._robot.home_positions.repeat(world.num_envs, 1)
        poses = self._tree.forward(self._root[:1], self._positions[:1])
        self._stance = torch.cat([self._tree.frame_pose(poses, foot)[:, None, :3] for foot in self._feet], dim=1)
        # Feet on opposite corners of the trunk swing together.
        self._offset = 0.5 * (self._stance[0, :, 0] * self._stance[0, :, 1] > 0).float()

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._positions[slice(None) if env_ids is None else env_ids] = self._robot.home_positions

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        self.reset((self._task.episode_step == 0).nonzero().squeeze(-1))
        wanted = self._foot_targets()
        # One Newton step a turn follows a path that moves by millimetres a turn.
        poses = self._tree.forward(self._root, self._positions)
        for index, foot in enumerate(self._feet):
            jacobian = self._tree.jacobian(poses, foot)[:, :3]
            error = wanted[:, index] - self._tree.frame_pose(poses, foot)[:, :3]
            self._positions += (torch.linalg.pinv(jacobian) @ error[..., None]).squeeze(-1)
        return {"action": self._generator.encode_positions(self._positions[:, self._generator.joints])}

    def _foot_targets(self) -> Tensor:
        """(N, 4, 3) in the trunk's frame."""
        gait, command = self._gait, self._task.command
        time = self._task.episode_step * (self._task.physics_dt * self._task.decimation)
        phase = torch.remainder(time[:, None] / gait.period + self._offset, 1.0)
        swinging = phase < 0.5
        progress = torch.remainder(2.0 * phase, 1.0)
        velocity = self._ground_velocity(command)
        half_stride = 0.25 * gait.period * velocity
        # A foot in stance moves back under the trunk at the commanded velocity; one in swing returns ahead.
        along = torch.where(swinging, -torch.cos(torch.pi * progress), 1.0 - 2.0 * progress)
        error = velocity - self._ground_velocity(self._measured())
        offset = along[..., None] * half_stride - (gait.velocity_gain * swinging * progress)[..., None] * error
        height = gait.swing_height * swinging * torch.sin(torch.pi * progress)
        return self._stance + torch.cat((offset, height[..., None]), dim=2)

    def _ground_velocity(self, motion: Tensor) -> Tensor:
        """(N, 4, 2) of the trunk's points above the feet, for planar motion (N, 3)."""
        x, y = self._stance[..., 0], self._stance[..., 1]
        turn = torch.stack((-y, x), dim=2) * motion[:, None, 2:]
        return motion[:, None, :2] + turn

    def _measured(self) -> Tensor:
        pose, velocity = self._robot.root_pose, self._robot.root_velocity
        linear = quat_rotate_inverse(pose[:, 3:], velocity[:, :3])
        return torch.cat((linear[:, :2], velocity[:, 5:]), dim=1)
