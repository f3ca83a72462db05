"""Sensors are made from their specifications. Packages add theirs through the entry-point group ``orbit.sensors``.

An entry point is named as the specification's class, and its value is the sensor's class::

    [project.entry-points."orbit.sensors"]
    RadarSpec = "my_package.radar:RadarSensor"
"""

from __future__ import annotations

from functools import cache

from orbit_core.interfaces import ConfigurationError
from orbit_core.registry import Registry
from orbit_core.scene import (
    CameraSpec,
    ContactSensorSpec,
    EventCameraSpec,
    ForceTorqueSpec,
    FrameSensorSpec,
    ImuSpec,
    JointSensorSpec,
    RayCameraSpec,
    RayCasterSpec,
    SensorSpec,
    TactileSpec,
)
from orbit_core.sensors.camera import CameraSensor
from orbit_core.sensors.camera_kinds import EventCamera, RayCamera
from orbit_core.sensors.contact import ContactSensor
from orbit_core.sensors.proprioception import ForceTorqueSensor, FrameSensor, ImuSensor, JointSensor
from orbit_core.sensors.rays import RayCaster
from orbit_core.sensors.tactile import TactileSensor
from orbit_core.sensors.timed import SensorContext, TimedSensor

GROUP = "orbit.sensors"
# Types and not names, so that a renamed class cannot be forgotten here.
_OWN: dict[type[SensorSpec], type[TimedSensor]] = {
    JointSensorSpec: JointSensor,
    FrameSensorSpec: FrameSensor,
    ContactSensorSpec: ContactSensor,
    TactileSpec: TactileSensor,
    ImuSpec: ImuSensor,
    ForceTorqueSpec: ForceTorqueSensor,
    RayCasterSpec: RayCaster,
    CameraSpec: CameraSensor,
    RayCameraSpec: RayCamera,
    EventCameraSpec: EventCamera,
}


@cache
def sensor_types() -> Registry[type[TimedSensor]]:
    """Return the classes of sensors, by the name of the class that specifies them.

    A program without a package adds its own: ``sensor_types().add("RadarSpec", RadarSensor)``.
    """
    registry = Registry[type[TimedSensor]]("sensor specification", GROUP)
    for spec, sensor in _OWN.items():
        registry.add(spec.__name__, sensor)
    return registry


def create_sensor(spec: SensorSpec, context: SensorContext) -> TimedSensor:
    """Create the sensor that ``spec`` describes.

    A specification that derives from another has the sensor of that one, unless it has its own.

    Raises:
        ConfigurationError: its rate, delay or pattern cannot be, or the package that brings the sensor is broken.
        UnknownNameError: nothing measures a specification of that type, or it names what the scene lacks.
    """
    # The nearest base that has a sensor wins, as method resolution does.
    kinds = [kind.__name__ for kind in type(spec).__mro__ if issubclass(kind, SensorSpec)]
    registry = sensor_types()
    known = registry.names
    name = next((kind for kind in kinds if kind in known), kinds[0])
    sensor = registry.get(name)
    if not (isinstance(sensor, type) and issubclass(sensor, TimedSensor)):
        raise ConfigurationError(
            f"{registry.origin(name)} of group {GROUP} names {sensor!r}, which is no subclass of "
            "orbit_core.sensors.TimedSensor: fix or uninstall it"
        )
    return sensor(spec, context)
