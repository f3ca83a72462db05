"""Timed measurements over what an engine provides: rates, delays and noise, rays, images and point clouds."""

from orbit_core.sensors.camera import CameraSensor, intrinsic_matrix, point_cloud, project
from orbit_core.sensors.camera_kinds import EventCamera, RayCamera
from orbit_core.sensors.contact import ContactSensor, ContactTimer
from orbit_core.sensors.factory import create_sensor, sensor_types
from orbit_core.sensors.proprioception import ForceTorqueSensor, FrameSensor, ImuSensor, JointSensor
from orbit_core.sensors.rays import RayCaster, grid_pattern, lidar_pattern
from orbit_core.sensors.sound import SoundSensor
from orbit_core.sensors.tactile import TactileSensor
from orbit_core.sensors.timed import SensorContext, TimedSensor

__all__ = [
    "CameraSensor", "ContactSensor", "ContactTimer", "EventCamera", "ForceTorqueSensor", "FrameSensor", "ImuSensor",
    "JointSensor", "RayCamera", "RayCaster", "SensorContext", "SoundSensor", "TactileSensor", "TimedSensor",
    "create_sensor",
    "grid_pattern", "intrinsic_matrix", "lidar_pattern", "point_cloud", "project", "sensor_types",
]  # fmt: skip
