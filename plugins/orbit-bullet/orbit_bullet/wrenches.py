"""Wrenches that joints transmit, from the balance of momentum of all links beyond them.

Bullet's own joint sensors leave out what constraints do. The parent's wrench is the rate of change of the momentum of
the links beyond the joint over the last step, less gravity, applied wrenches, and the forces of contacts and of joints
that close loops on them.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbit_bullet.loads import Loads
from orbit_bullet.stage import Stage
from orbit_core.interfaces import SceneLayout
from orbit_core.plugin_kit.rotations import cross, rotate

FloatArray = npt.NDArray[np.floating]


class WrenchMeter:
    """The wrenches of the layout's wrench links, for a client's environments."""

    def __init__(self, stage: Stage, loads: Loads, out: npt.NDArray[np.float32]) -> None:
        layout = stage.layout
        self.active = bool(layout.wrench_links)
        """False without wrench links: joint reactions are then not read."""
        self._stage = stage
        self._loads = loads
        self._out = out
        self._links = [_beyond(layout, link) for link in layout.wrench_links]
        free_roots = {entity.root_link for entity in layout.entities if not entity.spec.fixed_base}
        self._held = [link not in free_roots for link in layout.wrench_links]
        # Per kilogram, because masses differ between environments and inertias are scaled with them.
        self._unit_inertias = np.array([link.inertia / max(link.mass, 1e-12) for link in layout.links])

    def begin(self, raw: FloatArray, poses: FloatArray) -> None:
        """Before the last step: the state that it starts from."""
        self._before = self._momenta(raw, poses)
        self._centers_before, self._poses_before = raw[..., :3].copy(), poses.astype(np.float64)

    def end(self, raw: FloatArray, poses: FloatArray) -> None:
        """After the last step."""
        after = self._momenta(raw, poses)
        rates = [
            (new - old) / self._stage.layout.scene.physics_dt for new, old in zip(after, self._before, strict=True)
        ]
        # A rate over a step is the mean of the wrench over it, which is that of the step's middle to second order.
        centers, poses = 0.5 * (raw[..., :3] + self._centers_before), self._halfway(poses)
        outer = self._contacts()
        self._add_loops(outer, poses)
        for column, (link, beyond) in enumerate(zip(self._stage.layout.wrench_links, self._links, strict=True)):
            if not self._held[column]:
                continue
            origins = poses[:, link, None, :3] + self._stage.origins[:, None]
            arms = centers[:, beyond] - origins
            forces = rates[0][:, beyond] - self._loads.bearing[:, beyond]
            force = forces.sum(1) - outer[:, beyond, :3].sum(1)
            torques = rates[1][:, beyond] + cross(arms, forces) - self._loads.wrenches[:, beyond, 3:]
            # Moments of contacts and loops are about the world's origin.
            moments = outer[:, beyond, 3:] - cross(origins, outer[:, beyond, :3])
            torque = torques.sum(1) - moments.sum(1)
            inverse = poses[:, link, 3:] * np.array([1.0, -1.0, -1.0, -1.0])
            self._out[:, column, :3] = rotate(inverse, force)
            self._out[:, column, 3:] = rotate(inverse, torque)

    def _halfway(self, after: FloatArray) -> FloatArray:
        """(K, L, 7) poses in the middle of the last step, over which a wrench is the mean."""
        before = self._poses_before
        # Quaternions of opposite signs are one rotation, and their mean would be none.
        same = np.copysign(1.0, (after[..., 3:] * before[..., 3:]).sum(-1, keepdims=True))
        quaternions = after[..., 3:] + same * before[..., 3:]
        quaternions /= np.linalg.norm(quaternions, axis=-1, keepdims=True)
        return np.concatenate((0.5 * (after[..., :3] + before[..., :3]), quaternions), -1)

    def _momenta(self, raw: FloatArray, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Linear momentum, and angular momentum about the centre of mass (K, L, 3)."""
        masses = self._loads.masses[..., None]
        quaternions = poses[..., 3:].astype(np.float64)
        inverse = quaternions * np.array([1.0, -1.0, -1.0, -1.0])
        spins = rotate(inverse, raw[..., 10:])
        angular = rotate(quaternions, np.einsum("lij,klj->kli", self._unit_inertias, spins))
        return masses * raw[..., 7:10], masses * angular

    def _add_loops(self, total: FloatArray, poses: FloatArray) -> None:
        """Add the forces of joints that close loops, as of contacts (K, L, 6), to those on each link."""
        stage = self._stage
        for loop in stage.loops:
            force = np.array(stage.client.getConstraintState(loop.constraint))
            pose = poses[loop.slot, loop.first]
            point = stage.origins[loop.slot] + pose[:3] + rotate(pose[3:], loop.point)
            wrench = np.concatenate((force, np.cross(point, force)))
            total[loop.slot, loop.second] += wrench
            total[loop.slot, loop.first] -= wrench

    def _contacts(self) -> FloatArray:
        """Contact forces on each link, and their moments about the world's origin (K, L, 6)."""
        stage = self._stage
        total = np.zeros((stage.count, len(stage.layout.links), 6))
        for point in stage.client.getContactPoints():
            force = point[9] * np.array(point[7]) + point[10] * np.array(point[11]) + point[12] * np.array(point[13])
            if not force.any():
                continue
            wrench = np.concatenate((force, np.cross(point[5], force)))
            for body, link, sign in ((point[1], point[3], 1.0), (point[2], point[4], -1.0)):
                slot, number = stage.places.get((body, link), (0, -1))
                if number >= 0:
                    total[slot, number] += sign * wrench
        return total


def _beyond(layout: SceneLayout, link: int) -> list[int]:
    """The link and all that hang on it."""
    entity = layout.entities[int(layout.entity_of_link[link])]
    names = entity.spec.articulation.link_names
    found = {names[link - entity.links.start]}
    for joint in entity.spec.articulation.joints:  # in the order of their children, parents first
        if joint.parent in found:
            found.add(joint.child)
    return [entity.links.start + offset for offset, name in enumerate(names) if name in found]
