"""From a sensor's specification to the sensor."""

from __future__ import annotations

from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import (
    CameraSpec,
    ContactSensorSpec,
    ForceTorqueSpec,
    FrameSensorSpec,
    ImuSpec,
    JointSensorSpec,
    RayCasterSpec,
    SensorSpec,
)
from orbit_core.sensors.camera import CameraSensor
from orbit_core.sensors.contact import ContactSensor
from orbit_core.sensors.context import SensorContext
from orbit_core.sensors.force_torque import ForceTorqueSensor
from orbit_core.sensors.frame import FrameSensor
from orbit_core.sensors.imu import ImuSensor
from orbit_core.sensors.joint import JointSensor
from orbit_core.sensors.rays import RayCaster
from orbit_core.sensors.timed import TimedSensor


def create_sensor(spec: SensorSpec, context: SensorContext) -> TimedSensor:
    """The sensor that ``spec`` describes.

    Raises:
        ConfigurationError: its rate, delay or pattern cannot be, or nothing measures a specification of that type.
        UnknownNameError: it names what the scene lacks.
    """
    match spec:
        case JointSensorSpec():
            return JointSensor(spec, context)
        case FrameSensorSpec():
            return FrameSensor(spec, context)
        case ContactSensorSpec():
            return ContactSensor(spec, context)
        case ImuSpec():
            return ImuSensor(spec, context)
        case ForceTorqueSpec():
            return ForceTorqueSensor(spec, context)
        case RayCasterSpec():
            return RayCaster(spec, context)
        case CameraSpec():
            return CameraSensor(spec, context)
    raise ConfigurationError(f"nothing measures what sensor '{spec.name}' specifies: {type(spec).__name__}")
