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
        self._writers = [
            (port.name, robot.target_writer(JointTarget(port.name), generator.joints)) for port in self.inputs
        ]

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        for name, write in self._writers:
            write(inputs[name])
        return {}
