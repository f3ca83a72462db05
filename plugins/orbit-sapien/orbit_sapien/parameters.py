"""Physical parameters that differ between environments, and forces that act until set again."""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch

from orbit_core.interfaces import TERRAIN, SceneLayout, UnsupportedCapabilityError
from orbit_sapien.model import BuiltWorld
from orbit_sapien.native import NativePose, physx
from orbit_sapien.state import State

FloatArray = npt.NDArray[np.floating]
_NAMES = ("masses", "centers", "static", "dynamic", "gravity", "wrenches")


class Parameters:
    """Sets and remembers what was randomised. Nothing is kept for environments beyond the arrays themselves."""

    def __init__(self, layout: SceneLayout, world: BuiltWorld, state: State) -> None:
        self._layout, self._world, self._state = layout, world, state
        num_envs, links = len(world.environments), len(layout.links)
        self._nominal_masses = np.array([link.mass for link in layout.links])
        self.masses = np.tile(self._nominal_masses, (num_envs, 1))
        """(N, L) kg."""
        self.centers = np.tile(
            np.array([link.center_of_mass for link in layout.links]).reshape(-1, 3), (num_envs, 1, 1)
        )
        """(N, L, 3) m, centres of mass in the links' frames."""
        self.static = np.tile(world.rule.asked("static"), (num_envs, 1))
        """(N, G) coefficients of static friction of each group."""
        self.dynamic = np.tile(world.rule.asked("dynamic"), (num_envs, 1))
        """(N, G) coefficients of dynamic friction."""
        self.gravity = np.tile(np.asarray(layout.scene.gravity, np.float64), (num_envs, 1))
        """(N, 3) m/s^2."""
        self.wrenches = np.zeros((num_envs, links, 6), np.float32)
        """(N, L, 6) N and N m that users have set."""
        self.bodies = [[body for entity in e.entities for body in entity.bodies] for e in world.environments]
        """Per environment and link."""
        movable = [not isinstance(body, physx.PhysxRigidStaticComponent) for body in self.bodies[0]]
        self._movable = np.array(movable, dtype=bool)
        heavy = [not layout.entities[e].spec.gravity_compensation for e in layout.entity_of_link]
        self._heavy = np.flatnonzero(self._movable & np.array(heavy, dtype=bool))
        self._inertias = [
            np.asarray(body.inertia) if moves else None for body, moves in zip(self.bodies[0], movable, strict=True)
        ]
        self._rotations = [
            body.cmass_local_pose.q if moves else None for body, moves in zip(self.bodies[0], movable, strict=True)
        ]
        self._find_pushed()

    # Setting ---------------------------------------------------------------------------------------------------------

    def set_masses(self, links: npt.NDArray[np.int64], masses: FloatArray, rows: list[int]) -> None:
        self.masses[np.ix_(np.asarray(rows, np.int64), links)] = masses
        self._apply_inertial(links, rows)

    def set_centers_of_mass(self, links: npt.NDArray[np.int64], centers: FloatArray, rows: list[int]) -> None:
        velocities = self._state.root_velocities.float()
        self.centers[np.ix_(np.asarray(rows, np.int64), links)] = centers
        self._apply_inertial(links, rows)
        for entity in self._layout.entities:
            if entity.root_link in links and not entity.spec.fixed_base:
                center = torch.from_numpy(self.centers[rows, entity.root_link])
                self._state.root_centers[rows, entity.index] = center
                self._state.write_root(entity.index, None, velocities[rows, entity.index], rows)

    def set_friction(self, links: npt.NDArray[np.int64], coefficients: FloatArray, rows: list[int]) -> None:
        if self._world.shared_ground and TERRAIN in links:
            raise UnsupportedCapabilityError(
                f"the ground is shared by {self._world.per_system} environments, so it has one friction: set "
                f"shared_ground_above={self._world.per_system} to give each its own"
            )
        groups = self._world.rule.groups
        for column, link in enumerate(links):
            for group in [number for number, group in enumerate(groups) if group.link == link]:
                self.static[rows, group] = self.dynamic[rows, group] = coefficients[:, column]
        self._apply_friction(rows)

    def set_gravity(self, gravity: FloatArray, rows: list[int]) -> None:
        self.gravity[rows] = gravity
        self._find_pushed()

    def set_wrenches(self, links: npt.NDArray[np.int64], wrenches: FloatArray, rows: list[int]) -> None:
        self.wrenches[np.ix_(np.asarray(rows, np.int64), links)] = wrenches
        self._find_pushed()

    def clear_wrenches(self, rows: list[int]) -> None:
        if self.pushed:
            self.wrenches[rows] = 0.0
            self._find_pushed()

    # Acting ----------------------------------------------------------------------------------------------------------

    def push(self) -> None:
        """Apply wrenches, and gravity where it is not the scene's, for one physics step."""
        for body, force, torque in self.pushed:
            body.add_force_torque(force, torque, "force")

    def _find_pushed(self) -> None:
        total = self.wrenches.astype(np.float64)
        extra = self.gravity - np.asarray(self._layout.scene.gravity)
        total[:, self._heavy, :3] += extra[:, None] * self.masses[:, self._heavy, None]
        acting = total.any(-1) & self._movable
        values = total.astype(np.float32)
        self.pushed = [
            (self.bodies[row][link], values[row, link, :3], values[row, link, 3:])
            for row, link in zip(*(index.tolist() for index in np.nonzero(acting)), strict=True)
        ]

    # Snapshots -------------------------------------------------------------------------------------------------------

    def save(self) -> dict[str, npt.NDArray]:
        return {name: getattr(self, name).copy() for name in _NAMES}

    def load(self, saved: dict[str, npt.NDArray]) -> None:
        """Return to saved values, writing those that differ."""
        inertial = (saved["masses"] != self.masses) | (saved["centers"] != self.centers).any(-1)
        rubbing = ((saved["static"] != self.static) | (saved["dynamic"] != self.dynamic)).any(-1)
        for name in _NAMES:
            getattr(self, name)[...] = saved[name]
        for row in np.flatnonzero(inertial.any(-1)).tolist():
            self._apply_inertial(np.flatnonzero(inertial[row]), [row])
        self._apply_friction(np.flatnonzero(rubbing).tolist())
        roots = [entity.root_link for entity in self._layout.entities]
        self._state.root_centers[...] = torch.from_numpy(self.centers[:, roots])
        self._find_pushed()

    # Writing to PhysX ------------------------------------------------------------------------------------------------

    def _apply_inertial(self, links: npt.NDArray[np.int64], rows: list[int]) -> None:
        for row in rows:
            for link in links[self._movable[links]].tolist():
                body, inertia = self.bodies[row][link], self._inertias[link]
                assert inertia is not None
                nominal = self._nominal_masses[link]
                mass = float(self.masses[row, link])
                if nominal > 0:
                    body.mass, body.inertia = mass, (inertia * mass / nominal).astype(np.float32)
                body.cmass_local_pose = NativePose(self.centers[row, link].astype(np.float32), self._rotations[link])
        self._find_pushed()

    def _apply_friction(self, rows: list[int]) -> None:
        rule = self._world.rule
        static, dynamic = rule.given(self.static), rule.given(self.dynamic)
        restitution, radii = rule.given(rule.asked("restitution")), rule.patch_radii(self.dynamic)
        for row in rows:
            values = zip(static[row], dynamic[row], restitution, strict=True)
            materials = [physx.PhysxMaterial(*map(float, group)) for group in values]
            for shapes in self._world.environments[row].shapes.values():
                for group, shape in shapes:
                    shape.set_physical_material(materials[group])
                    shape.set_min_patch_radius(float(radii[row, group]))
