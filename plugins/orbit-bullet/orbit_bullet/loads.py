"""Forces that act on links at each step: gravity where the world's does not, and external wrenches.

Bullet knows one gravity per world and no compensation. A world's gravity is the scene's, or none where most links are
compensated; each link bears the difference as a force at its centre of mass.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbit_bullet.stage import Stage

FloatArray = npt.NDArray[np.float64]


class Loads:
    """Gravity (K, 3), masses (K, L) and wrenches (K, L, 6) of a client's environments."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        layout = stage.layout
        count, links = stage.count, len(layout.links)
        scene_gravity = np.array(layout.scene.gravity, dtype=np.float64)
        self.gravity = np.tile(scene_gravity, (count, 1))
        """(K, 3) m/s^2."""
        self.nominal_masses = np.array([link.mass for link in layout.links], dtype=np.float64)
        """(L,) kg, of the scene."""
        self.masses = np.tile(self.nominal_masses, (count, 1)).reshape(count, links)
        """(K, L) kg, as they are randomised."""
        self.wrenches = np.zeros((count, links, 6))
        """(K, L, 6) N and N m that users have set."""
        held = {entity.root_link for entity in layout.entities if entity.spec.fixed_base}
        self._free = np.array([number not in held for number in range(links)], dtype=float)
        compensated = [layout.entities[entity].spec.gravity_compensation for entity in layout.entity_of_link]
        self._heavy = 1.0 - np.array(compensated, dtype=float)
        # Each link that differs from the world costs a call at each step, so that the world takes what most links have.
        most_compensated = (self._free * self._heavy).sum() < (self._free * (1 - self._heavy)).sum()
        self._world_gravity = np.zeros(3) if most_compensated else scene_gravity
        stage.client.setGravity(*self._world_gravity.tolist())
        self._places = [(entity.index, index) for entity in layout.entities for index in stage.links[entity.index]]
        self.derive()

    def derive(self) -> None:
        """Recompute the loads, which depend on gravity, masses and wrenches."""
        self.bearing = self._heavy[:, None] * self.gravity[:, None] * self.masses[..., None] + self.wrenches[..., :3]
        """(K, L, 3) gravity that is not compensated, and applied forces."""
        difference = self._heavy[:, None] * self.gravity[:, None] - self._world_gravity
        forces = difference * (self._free * self.masses)[..., None] + self.wrenches[..., :3]
        self._active = []
        for slot, link in np.argwhere(np.abs(forces).sum(-1) + np.abs(self.wrenches[..., 3:]).sum(-1) > 0):
            entity, index = self._places[link]
            force, torque = forces[slot, link].tolist(), self.wrenches[slot, link, 3:].tolist()
            body = self._stage.bodies[slot][entity]
            self._active.append((body, index, force if any(force) else None, torque if any(torque) else None))

    def apply(self) -> None:
        """Before each step."""
        client = self._stage.client
        frame = client.WORLD_FRAME
        for body, link, force, torque in self._active:
            if force is not None:
                # Bullet has the base's centre of mass in another call than a link's.
                if link < 0:
                    center = client.getBasePositionAndOrientation(body)[0]
                else:
                    center = client.getLinkState(body, link, 0, 1)[0]
                client.applyExternalForce(body, link, force, center, frame)
            if torque is not None:
                client.applyExternalTorque(body, link, torque, frame)
