"""Sensors in the model that measure the wrenches of joints."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import SceneLayout
from orbit_mjmodel.addresses import body_name


def add_wrench_sensors(spec: mujoco.MjSpec, layout: SceneLayout) -> None:
    """For each of the layout's wrench links a force, then a torque sensor at its frame: rows (W, 6) of sensor data."""
    for number, link in enumerate(layout.wrench_links):
        site = f"wrench{number}"
        spec.body(body_name(link)).add_site(name=site)
        for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
            spec.add_sensor(name=f"{site}.{kind.name}", type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site)


def held_up_beyond(model: mujoco.MjModel, bodies: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """(W, B) 1 where a body is held up against gravity and is one of W bodies or hangs on it, else 0.

    What holds it up is a force on the body, which MuJoCo leaves out of the joints' wrenches: they are those of a body
    that hangs.
    """
    beyond = np.zeros((len(bodies), model.nbody))
    for body in range(model.nbody):
        above = body
        while above:
            beyond[bodies == above, body] = model.body_gravcomp[body]
            above = model.body_parentid[above]
    return beyond
