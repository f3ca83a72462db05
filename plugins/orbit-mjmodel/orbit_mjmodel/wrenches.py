"""Sensors in the model that measure the wrenches of joints."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import SceneLayout
from orbit_core.plugin_kit.rotations import cross
from orbit_mjmodel.addresses import body_name


def add_wrench_sensors(spec: mujoco.MjSpec, layout: SceneLayout) -> None:
    """Add a force and a torque sensor at the frame of each wrench link of the layout: rows (W, 6) of sensor data."""
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


class CompositeInertias:
    """Wrenches that accelerate the bodies beyond joints, from rates of the generalised velocities.

    A wrench is ``crb[b] sum(cdof_j a_j)`` over the degrees of freedom j that move body b, plus ``crb[b_j] cdof_j a_j``
    over those j of bodies b_j that hang on b; all about the centre of mass of the tree, in world axes.
    """

    def __init__(self, model: mujoco.MjModel, bodies: npt.NDArray[np.int64]) -> None:
        self.roots = model.body_rootid[bodies]
        """(W,) body whose centre of mass the wrenches refer to."""
        above = [set(_ancestors(model, int(body))) for body in range(model.nbody)]
        self.carrier = np.array(
            [[self._carrier(int(b), int(of), above) for of in model.dof_bodyid] for b in bodies], dtype=np.int64
        ).reshape(len(bodies), model.nv)
        """(W, nv) body whose composite inertia each degree of freedom accelerates, -1 for none."""
        pairs = sorted({(w, int(body)) for w, row in enumerate(self.carrier) for body in row if body >= 0})
        self._moved = np.array([self.carrier[w] == body for w, body in pairs], dtype=float).reshape(
            len(pairs), model.nv
        )
        self._accelerated = np.array([body for _, body in pairs], dtype=np.int64)
        self._summed = np.array([[w == column for w, _ in pairs] for column in range(len(bodies))], dtype=float)

    @staticmethod
    def _carrier(body: int, moved: int, above: list[set[int]]) -> int:
        if moved in above[body]:
            return body
        return moved if body in above[moved] else -1

    def wrenches(
        self, inertias: npt.NDArray[np.float64], motions: npt.NDArray[np.float64], rates: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """(N, W, 6) torques and forces from ``crb`` (N, bodies, 10), ``cdof`` (N, nv, 6) and rates (N, nv)."""
        moving = self._moved @ (motions * rates[..., None])
        return self._summed @ _times_inertia(inertias[:, self._accelerated], moving)


def _ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the body and all that it hangs on, but for the world."""
    found = []
    while body:
        found.append(body)
        body = model.body_parentid[body]
    return found


def _times_inertia(inertia: npt.NDArray[np.float64], motion: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Multiply motions (..., 6) by inertias (..., 10) as MuJoCo keeps them: moments, mass times offset, mass."""
    spin, speed = motion[..., :3], motion[..., 3:]
    turned = inertia[..., :3] * spin
    turned += inertia[..., (3, 3, 4)] * spin[..., (1, 0, 0)]
    turned += inertia[..., (4, 5, 5)] * spin[..., (2, 2, 1)]
    offset, mass = inertia[..., 6:9], inertia[..., 9:]
    return np.concatenate((turned + cross(offset, speed), mass * speed - cross(offset, spin)), -1)
