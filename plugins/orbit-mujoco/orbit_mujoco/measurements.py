"""Sensors in the model that measure contact forces, and how to read them and those of joint wrenches."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt
import torch

from orbit_core.interfaces import TERRAIN, ContactQuery, SceneLayout
from orbit_mjmodel.addresses import body_name

_NET_FORCE = (2, 3, 1)
"""Data (bit 1: force), reduction (3: net force, world axes), slots."""
_Target = tuple[mujoco.mjtObj, str]


def add_contact_sensors(spec: mujoco.MjSpec, layout: SceneLayout) -> None:
    """One sensor per query and thing that the query filters by, in order; each gives the force that the link exerts."""
    for number, query in enumerate(layout.contact_queries):
        for part, target in enumerate(_targets(query, layout)):
            sensor = spec.add_sensor(
                name=f"contact{number}.{part}",
                type=mujoco.mjtSensor.mjSENS_CONTACT,
                objtype=mujoco.mjtObj.mjOBJ_BODY,
                objname=body_name(query.link),
            )
            sensor.intprm[:3] = _NET_FORCE
            if target:
                sensor.reftype, sensor.refname = target


def contact_sensor_starts(layout: SceneLayout) -> npt.NDArray[np.int64]:
    """(K + 1,) number of the first sensor of each query, then the number of all."""
    return np.cumsum([0, *(len(_targets(query, layout)) for query in layout.contact_queries)])


def _targets(query: ContactQuery, layout: SceneLayout) -> list[_Target | None]:
    """Targets of a filter: nothing, the world, whole entities (subtrees) if all their links are asked, or links."""
    if query.others is None:
        return [None]
    targets: list[_Target | None] = []
    rest = set(query.others)
    if TERRAIN in rest:
        rest.remove(TERRAIN)
        targets.append((mujoco.mjtObj.mjOBJ_BODY, "world"))
    for entity in layout.entities:
        links = set(range(entity.links.start, entity.links.stop))
        if links <= rest:
            rest -= links
            targets.append((mujoco.mjtObj.mjOBJ_XBODY, body_name(entity.root_link)))
    targets += [(mujoco.mjtObj.mjOBJ_BODY, body_name(link)) for link in sorted(rest)]
    return targets


class ContactMeter:
    """Averages the contact sensors over the physics steps of a control step."""

    def __init__(self, layout: SceneLayout, sensordata: npt.NDArray[np.float64]) -> None:
        starts = contact_sensor_starts(layout)
        self.queries, sensors = len(layout.contact_queries), int(starts[-1])
        self._starts = starts[:-1]
        self._sensordata = sensordata[:, : 3 * sensors]
        self._sum = np.zeros((len(sensordata), sensors, 3))
        self._flat_sum = self._sum.reshape(len(sensordata), 3 * sensors)
        self.forces = torch.zeros(len(sensordata), self.queries, 3)
        """(N, K, 3) newtons on each query's link."""
        self._forces = self.forces.numpy()

    def clear(self) -> None:
        """Begin a control step."""
        self._flat_sum.fill(0.0)

    def add(self) -> None:
        """Take one physics step's forces in."""
        self._flat_sum += self._sensordata

    def average(self, steps: int) -> None:
        """End a control step; the sensors give what the link exerts, and the opposite is asked."""
        total = self._sum if len(self._starts) == self._sum.shape[1] else np.add.reduceat(self._sum, self._starts, 1)
        np.multiply(total, -1.0 / steps, out=self._forces, casting="same_kind")


class WrenchMeter:
    """Holds the joint wrenches of the last physics step."""

    def __init__(self, layout: SceneLayout, sensordata: npt.NDArray[np.float64]) -> None:
        links = len(layout.wrench_links)
        self._sensordata = sensordata[:, sensordata.shape[1] - 6 * links :]
        self.wrenches = torch.zeros(len(sensordata), links, 6)
        """(N, W, 6) force and torque from the parent, in the link's axes."""
        self._flat = self.wrenches.numpy().reshape(len(sensordata), 6 * links)

    def read(self) -> None:
        if self._flat.shape[1]:
            np.copyto(self._flat, self._sensordata, casting="same_kind")
