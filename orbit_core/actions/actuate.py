"""The end of an agent's graph: joint targets go to the robot's actuators."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from orbit_core.actions.base import JointTarget, MotionGenerator
from orbit_core.interfaces import Node, Robot


class Actuate(Node):
    """Writes a motion generator's outputs to its joints."""

    def __init__(self, robot: Robot, generator: MotionGenerator) -> None:
        self.name = f"actuate_{generator.name}"
        self.inputs = generator.outputs
        self.robot = robot
        self._joints = generator.joints
        setters = {
            JointTarget.POSITION.value: robot.set_position_targets,
            JointTarget.VELOCITY.value: robot.set_velocity_targets,
            JointTarget.EFFORT.value: robot.set_effort_targets,
        }
        self._setters = [(port.name, setters[port.name]) for port in self.inputs]

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        for name, write in self._setters:
            write(inputs[name], self._joints)
        return {}
