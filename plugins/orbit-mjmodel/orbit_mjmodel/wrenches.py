"""Sensors in the model that measure the wrenches of joints."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import mujoco

from orbit_core.interfaces import SceneLayout
from orbit_mjmodel.addresses import body_name


def add_wrench_sensors(spec: mujoco.MjSpec, layout: SceneLayout) -> None:
    """For each of the layout's wrench links a force, then a torque sensor at its frame: rows (W, 6) of sensor data."""
    for number, link in enumerate(layout.wrench_links):
        site = f"wrench{number}"
        spec.body(body_name(link)).add_site(name=site)
        for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
            spec.add_sensor(name=f"{site}.{kind.name}", type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site)
