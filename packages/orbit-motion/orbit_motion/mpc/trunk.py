"""A trunk that goes to its goal over standing feet, or feet that step by a contact sequence, as a plan ahead says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from orbit_core.actions.base import JointTarget
from orbit_core.actions.embodiment import driven_joints
from orbit_core.actions.modes import CommandMode
from orbit_core.actions.pose_command import displaced
from orbit_core.dynamics.transforms import pose_error, quat_rotate_inverse, quat_yaw
from orbit_core.interfaces import ConfigurationError, Robot, World
from orbit_core.scene import RobotSpec
from orbit_motion.mpc.model import libraries
from orbit_motion.mpc.plan import Array, Plan
from orbit_motion.mpc.predictive import Predictive
from orbit_motion.mpc.trunk_problem import TrunkProblem, TrunkSettings


@dataclass(frozen=True, kw_only=True)
class TrunkMpcConfig(TrunkSettings):
    """A command is a pose of the trunk, which the legs bring it to as a plan says: model-predictive control.

    Zero is where the trunk was when the episode began, level; axes are those of its heading then. At every turn of
    ``rate`` crocoddyl's solver BoxFDDP minimises, over the efforts of ``nodes`` steps, the squares of the trunk's
    distance from the goal, of the joints' from home, of velocities and of efforts, with the dynamics of the whole body
    and its contacts (Budhiraja, Carpentier, Mastalli and Mansard, Differential Dynamic Programming for Multi-Phase
    Rigid Contact Dynamics, Humanoids 2018). Standing feet do not move, and their forces stay in the friction cone by a
    cost; feet in the air are lifted, and come down where they are below the trunk at home. Joints are told positions,
    velocities and efforts. One environment, flat ground.
    """

    name: ClassVar[str] = "trunk_mpc"

    def default_joints(self, spec: RobotSpec) -> Sequence[str]:
        return [spec.articulation.joint_names[joint] for joint in driven_joints(spec)]

    def frame_of(self, robot: Robot) -> str:
        return self.frame or robot.spec.base_link or robot.link_names[0]

    def build(self, name: str, robot: Robot) -> TrunkMpc:
        return TrunkMpc(name, robot, self)


class TrunkMpc(Predictive):
    """Six commands, :class:`TrunkMpcConfig`."""

    config: TrunkMpcConfig
    targets: ClassVar[tuple[JointTarget, ...]] = (JointTarget.POSITION, JointTarget.VELOCITY, JointTarget.EFFORT)

    def __init__(self, name: str, robot: Robot, config: TrunkMpcConfig) -> None:
        spec = robot.spec
        if spec.fixed_base or not spec.feet:
            raise ConfigurationError(
                f"action term '{name}' moves a trunk on feet, and robot '{spec.name}' has "
                f"{'a fixed base' if spec.fixed_base else 'no feet'}: choose hand_mpc for an arm"
            )
        if config.mode is not CommandMode.ABSOLUTE:
            raise ConfigurationError(f"action term '{name}': the trunk's commands are absolute")
        super().__init__(name, robot, config.joint_indices(spec, name), config)
        config.gait.check(name, len(spec.feet))
        self.frame = config.frame_of(robot)
        robot.frame_pose(self.frame)  # which refuses an unknown one
        self._scale = torch.tensor([config.position_scale] * 3 + [config.rotation_scale] * 3, device=self.device)
        self._fastest = torch.tensor([config.speed] * 3 + [config.turn_speed] * 3, device=self.device) / config.rate
        self._drawn = torch.zeros(1, 6, device=self.device)
        self._origin: Tensor | None = None
        libraries()

    def enter(self, world: World, step_dt: float) -> None:
        super().enter(world, step_dt)
        self._problem = TrunkProblem(
            self.robot, self.joints, self.frame, self.limits, self.config, tuple(world.scene.gravity)
        )

    def goal(self, command: Tensor) -> Array:
        ahead = (command * self._scale - self._drawn) / self._fastest
        # Position and rotation arrive together: all of them at the speed of the slowest.
        self._drawn = self._drawn + self._fastest * ahead / ahead.abs().max().clamp_min(1.0)
        return displaced(self._began(), self._turned(self._drawn))[0].double().cpu().numpy()

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        origin = self._began()
        parts = pose_error(origin, pose).unflatten(1, (2, 3))
        local = quat_rotate_inverse(origin[:, None, 3:].expand(-1, 2, 4), parts).flatten(1)
        return (local / self._scale).clamp(-1.0, 1.0)

    def measured(self) -> Array:
        """(13 + 2 k,) pose and velocity of the root, then positions and velocities."""
        robot = self.robot
        parts = (robot.root_pose[0], robot.root_velocity[0], self.positions[0], self.velocities[0])
        return np.concatenate([part.double().cpu().numpy() for part in parts])

    def solve(self, state: Array, goal: Array, time: float) -> Plan:
        return self._problem.solve(state, goal, time)

    def reset(self, env_ids: Tensor | None = None) -> None:
        super().reset(env_ids)
        self._origin = None
        self._drawn = torch.zeros_like(self._drawn)

    def _began(self) -> Tensor:
        """(1, 7) the trunk's pose when the episode began, level."""
        if self._origin is None:
            pose = self.robot.frame_pose(self.frame)
            self._origin = torch.cat((pose[:, :3], quat_yaw(pose[:, 3:])), 1)
        return self._origin

    def _turned(self, local: Tensor) -> Tensor:
        """Return a displacement (1, 6) in the origin's axes, in the world's."""
        inverse = self._began()[:, None, 3:] * torch.tensor([1.0, -1.0, -1.0, -1.0], device=self.device)
        return quat_rotate_inverse(inverse.expand(-1, 2, 4), local.unflatten(1, (2, 3))).flatten(1)
