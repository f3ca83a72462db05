"""Timed measurements over what an engine provides: rates, delays and noise, rays, images and point clouds."""

from orbit_core.sensors.boxes import BoundingBoxes2d, BoundingBoxes3d
from orbit_core.sensors.camera import CameraSensor
from orbit_core.sensors.contact import ContactSensor, ContactTimer
from orbit_core.sensors.context import SensorContext
from orbit_core.sensors.factory import create_sensor, sensor_types
from orbit_core.sensors.force_torque import ForceTorqueSensor
from orbit_core.sensors.frame import FrameSensor
from orbit_core.sensors.imu import ImuSensor
from orbit_core.sensors.joint import JointSensor
from orbit_core.sensors.patterns import grid_pattern, lidar_pattern
from orbit_core.sensors.points import intrinsic_matrix, point_cloud, project
from orbit_core.sensors.rays import RayCaster
from orbit_core.sensors.timed import TimedSensor

__all__ = [
    "BoundingBoxes2d", "BoundingBoxes3d", "CameraSensor", "ContactSensor", "ContactTimer", "ForceTorqueSensor",
    "FrameSensor", "ImuSensor", "JointSensor", "RayCaster", "SensorContext", "TimedSensor", "create_sensor",
    "grid_pattern", "intrinsic_matrix", "lidar_pattern", "point_cloud", "project", "sensor_types",
]  # fmt: skip
