"""One arm with a parallel gripper, driven by a timed path, or by a pose that a person holds."""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.actions.actuate import Actuate
from orbit_core.actions.base import JointTarget
from orbit_core.actions.binary_gripper import BinaryGripperConfig
from orbit_core.actions.differential_ik import DifferentialIkConfig
from orbit_core.interfaces import ConfigurationError, Robot, World
from orbit_core.interfaces.layout import actuator_of_joint
from orbit_motion.planning import JointTrajectory, TrajectoryFollower


class ArmDriver:
    """Tells a robot's first arm and its gripper what to do, once a control step; without orders the arm holds still.

    Args:
        world: of one environment.
        robot: that moves.
        step_dt: s from one command to the next.

    Raises:
        ConfigurationError: there are several environments; or the robot has no arm with a gripper; or joints of its arm
            are not driven by positions.
    """

    def __init__(self, world: World, robot: Robot, step_dt: float) -> None:
        if world.num_envs != 1:
            raise ConfigurationError(f"a person drives one environment, not {world.num_envs}: use num_envs=1")
        self.robot = robot
        self._hand = DifferentialIkConfig(robot=robot.name).build("hand", robot)
        self._gripper = BinaryGripperConfig(robot=robot.name).build("gripper", robot)
        self.joints = self._hand.joints
        actuators = actuator_of_joint(robot.spec)
        for joint in self.joints:
            if not actuators[joint].stiffness > 0.0:
                raise ConfigurationError(
                    f"joint '{robot.joint_names[joint]}' of '{robot.name}' is not driven by positions: choose the "
                    "action space joint_position"
                )
        self._follower = TrajectoryFollower("follow", robot, self.joints, 1.0 / step_dt)
        self._actuate = Actuate(robot, self._hand), Actuate(robot, self._gripper)
        self.gripper_open = True
        """What the gripper is told."""
        self._goal: Tensor | None = None

    def follow(self, trajectory: JointTrajectory) -> None:
        """Begin a path; the arm holds its end."""
        self._goal = None
        self._follower.load({0: trajectory})

    @property
    def arrived(self) -> bool:
        """Whether the path's end was told."""
        return bool(self._follower.finished[0])

    def hold(self) -> None:
        """Stay where the arm is."""
        self._goal = None
        self._follower.reset()

    def steer(self, pose: Tensor) -> None:
        """Bring the hand towards a pose (7,) in the environment, by differential inverse kinematics."""
        self._goal = pose[None].to(self.robot.joint_positions)

    def advance(self) -> None:
        """Set the targets of the next control step."""
        if self._goal is None:
            targets = self._follower.compute({})
            self.robot.set_position_targets(targets[JointTarget.POSITION], self.joints)
            self.robot.set_velocity_targets(targets[JointTarget.VELOCITY], self.joints)
        else:
            command = self._hand.encode(self._goal, torch.tensor([self.gripper_open]))
            self._actuate[0].compute(self._hand.compute({"command": command}))
            self.robot.set_velocity_targets(torch.zeros_like(self._hand.positions), self.joints)
        opening = torch.full((1, 1), 1.0 if self.gripper_open else -1.0, device=self.robot.joint_positions.device)
        self._actuate[1].compute(self._gripper.compute({"command": opening}))
