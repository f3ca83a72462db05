"""Measured wrench that a hand exerts on its surroundings, from the scene's sensors."""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import link_ancestry
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.interfaces import ConfigurationError, Robot, World
from orbit_core.scene import ContactSensorSpec, ForceTorqueSpec
from orbit_core.sensors import ContactSensor, ForceTorqueSensor


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
