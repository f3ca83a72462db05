"""Several environments in one Bullet world: stepped, read and written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_bullet.actuation import Actuation
from orbit_bullet.buffers import Buffers
from orbit_bullet.config import BulletConfig
from orbit_bullet.contacts import ContactMeter
from orbit_bullet.deformables import Deformables
from orbit_bullet.gyroscopic import Gyroscopes
from orbit_bullet.library import Client, refusals, silence
from orbit_bullet.loads import Loads
from orbit_bullet.rays import cast_rays
from orbit_bullet.readback import read_model
from orbit_bullet.readings import Readings
from orbit_bullet.stage import SceneFiles, Stage
from orbit_bullet.surfaces import Surfaces
from orbit_bullet.wrenches import WrenchMeter
from orbit_core.interfaces import (
    BuiltModel,
    ConfigurationError,
    SceneLayout,
    SimulationError,
    UnsupportedCapabilityError,
)
from orbit_core.plugin_kit.rotations import compose, cross

FloatArray = npt.NDArray[np.float64]
# Share of the way beyond a joint's limit that a step removes; the joint keeps the speed of it. Bullet has one number
# for limits and for the openings of loops, so that scenes with loops use theirs.
_STOP_ERP = 0.1
Rows = npt.NDArray[np.int64]


@dataclass(frozen=True)
class SavedSimulation:
    """A world's own snapshot and what stands outside it."""

    state: int
    """Bullet's number of the saved state."""
    generation: int
    """Generation of the wheels that the world had."""
    arrays: tuple[npt.NDArray[Any], ...]
    """Copies of what Bullet does not save: gains, loads and wheels."""


class Simulation:
    """K environments; ``buffers`` and ``readings`` are their rows."""

    def __init__(
        self, layout: SceneLayout, files: SceneFiles, buffers: Buffers, readings: Readings, config: BulletConfig
    ) -> None:
        self.layout = layout
        """Numbers of the scene's links and joints."""
        self.buffers = buffers
        self.count = len(buffers.link_poses)
        """K, environments in one client."""
        self.client = Client()
        """Connection to Bullet."""
        with silence(), refusals("Bullet cannot build the scene", SimulationError):
            if layout.scene.deformables:
                # Before anything is added: it empties the world.
                self.client.resetSimulation(self.client.RESET_USE_DEFORMABLE_WORLD)
            self._set_options(config)
            self.stage = Stage(self.client, layout, files, self.count)
            """Bodies and links of all environments."""
            self.actuation = Actuation(self.stage, buffers)
            """Drives, by wheels where they have gains."""
            self.deformables = Deformables(self.stage, buffers) if layout.scene.deformables else None
            """Cloth and soft bodies; None where the scene has none."""
        self.loads = Loads(self.stage)
        """Gravity, masses and wrenches."""
        self._gyroscopes = Gyroscopes(self.client, self.stage.free_bodies(), layout.scene.physics_dt)
        self._surfaces = Surfaces(self.client, self.stage, layout, self.count)
        self._contacts = ContactMeter(self.client, layout.contact_queries, self.stage.places, buffers.contact_forces)
        self._readings = readings
        self._nominal_inertias = self._inertias()
        self._wrenches = WrenchMeter(self.stage, self.loads, buffers.joint_wrenches)
        self.reset(np.arange(self.count))

    def _set_options(self, config: BulletConfig) -> None:
        looped = any(entity.spec.articulation.loops for entity in self.layout.entities)
        self.client.setPhysicsEngineParameter(
            fixedTimeStep=self.layout.scene.physics_dt,
            numSolverIterations=config.solver_iterations,
            # All iterations: ended where impulses change by less than 1e-8 N s they save a third of the time, but a
            # wheel climbs out of a plane by 15 mm, and a level height field turns balls aside.
            solverResidualThreshold=0.0,
            # Islands are not merged into batches: environments would be solved together, and depend on each other.
            minimumSolverIslandSize=1,
            # Sorted, because results would otherwise depend on the order in which pairs began to overlap.
            deterministicOverlappingPairs=1,
            contactERP=config.contact_erp,
            erp=config.joint_erp if looped else _STOP_ERP,
            useSplitImpulse=0,  # it would leave joints that passed a limit by more than 40 mrad where they are
            restitutionVelocityThreshold=config.restitution_threshold,
            enableFileCaching=0,
            enableSAT=1,  # for bodies that have the features
        )

    # Time ------------------------------------------------------------------------------------------------------------

    def step(self, steps: int) -> list[int]:
        """Advance; the environments whose deformables flew apart come back.

        Joints and links are gathered, and the buffers of them left to :meth:`Readings.convert`.
        """
        contacts = self._contacts.active
        if contacts:
            self._contacts.clear()
        self.actuation.prepare()
        for number in range(steps):
            if self._wrenches.active and number == steps - 1:
                self._read(range(self.count))
                self._wrenches.begin(self._readings.bodies, self.buffers.link_poses)
            elif number:
                self._read_joints(range(self.count))
            if self.deformables and number == steps - 1:
                self.deformables.begin()
            self.actuation.apply(self._readings.positions, self._readings.velocities)
            self.loads.apply()
            self._gyroscopes.begin()
            self.client.stepSimulation()
            self._gyroscopes.end()
            if contacts:
                self._contacts.add()
        if contacts:
            self._contacts.average(steps)
        self._gather(range(self.count))
        np.copyto(self.buffers.joint_efforts, self.actuation.efforts(self._readings.velocities), casting="same_kind")
        if self._wrenches.active:
            self._readings.convert(self.buffers, slice(None), self.stage.offsets, self.stage.origins)
            self._wrenches.end(self._readings.bodies, self.buffers.link_poses)
        if not self.deformables:
            return []
        self.deformables.read()
        return [] if self.deformables.sound() else [0]

    # Reading ---------------------------------------------------------------------------------------------------------

    @property
    def joint_state(self) -> tuple[FloatArray, FloatArray]:
        """Positions and velocities (K, J) as the last step left them."""
        return self._readings.positions, self._readings.velocities

    def _read_joints(self, slots: range | Rows) -> None:
        client, stage = self.client, self.stage
        for slot in slots:
            for entity in self.layout.entities:
                if numbers := stage.joints[entity.index]:
                    states = client.getJointStates(stage.bodies[slot][entity.index], numbers)
                    self._readings.positions[slot, entity.joints] = [state[0] for state in states]
                    self._readings.velocities[slot, entity.joints] = [state[1] for state in states]

    def _read(self, slots: range | Rows) -> None:
        """Fill the buffers of joints and links."""
        self._gather(slots)
        rows = slice(None) if isinstance(slots, range) else slots
        self._readings.convert(self.buffers, rows, self.stage.offsets, self.stage.origins)

    def _gather(self, slots: range | Rows) -> None:
        self._read_joints(slots)
        for slot in slots:
            for entity in self.layout.entities:
                self._read_links(slot, entity.index)

    def _read_links(self, slot: int, number: int) -> None:
        client, entity = self.client, self.layout.entities[number]
        body = self.stage.bodies[slot][number]
        values: list[float] = []
        indices = self.stage.links[number]
        start = entity.links.start
        if not entity.spec.fixed_base:
            position, orientation = client.getBasePositionAndOrientation(body)
            linear, angular = client.getBaseVelocity(body)
            values += (*position, *orientation, *linear, *angular)
        else:  # the root stands still where it was put
            start += 1
        indices = indices[1:]
        if indices:
            for state in client.getLinkStates(body, indices, 1, 1):
                values += (*state[0], *state[1], *state[6], *state[7])
        if values:
            self._readings.bodies[slot, start : entity.links.stop] = np.array(values).reshape(-1, 13)

    # Writing ---------------------------------------------------------------------------------------------------------

    def write_joints(
        self, rows: Rows, joints: Rows, positions: FloatArray | None, velocities: FloatArray | None
    ) -> None:
        """State (n, k) of joints (k,)."""
        if positions is not None:
            self._readings.positions[np.ix_(rows, joints)] = positions
        if velocities is not None:
            self._readings.velocities[np.ix_(rows, joints)] = velocities
        touched = [e for e in self.layout.entities if ((joints >= e.joints.start) & (joints < e.joints.stop)).any()]
        for slot in rows:
            for entity in touched:
                self._put_joints(slot, entity.index)
        self._read(rows)

    def _put_joints(self, slot: int, number: int) -> None:
        readings, joints = self._readings, self.layout.entities[number].joints
        positions, velocities = readings.positions[slot, joints], readings.velocities[slot, joints]
        numbers = self.stage.joints[number]
        if numbers:
            self.client.resetJointStatesMultiDof(
                self.stage.bodies[slot][number], numbers, positions[:, None].tolist(), velocities[:, None].tolist()
            )

    def write_root(self, rows: Rows, number: int, pose: FloatArray | None, velocity: FloatArray | None) -> None:
        """Pose (n, 7) in each environment's frame and velocity (n, 6) of the root link's origin."""
        link = self.layout.entities[number].root_link
        poses = np.array(self.buffers.link_poses[rows, link] if pose is None else pose, dtype=np.float64)
        moving = self.buffers.link_velocities[rows, link] if velocity is None else velocity
        self._put_root(rows, number, poses, np.array(moving, dtype=np.float64))
        self._read(rows)

    def _put_root(self, rows: Rows, number: int, pose: FloatArray, velocity: FloatArray) -> None:
        entity, client = self.layout.entities[number], self.client
        origin, quaternion = pose[:, :3] + self.stage.origins[rows], _normalized(pose[:, 3:])
        inertial = self.stage.root_inertials[number]
        center, axes = compose(origin, quaternion, inertial)
        if entity.spec.fixed_base:
            still = np.concatenate((origin, quaternion[:, [1, 2, 3, 0]], np.zeros((len(rows), 6))), -1)
            self._readings.bodies[rows, entity.root_link] = still
        # Bullet has velocities of centres of mass, and the contract those of origins.
        linear = velocity[:, :3] + cross(velocity[:, 3:], center - origin)
        for index, slot in enumerate(rows):
            body = self.stage.bodies[slot][number]
            x, y, z, w = axes[index, [1, 2, 3, 0]].tolist()
            client.resetBasePositionAndOrientation(body, center[index].tolist(), (x, y, z, w))
            if not entity.spec.fixed_base:
                client.resetBaseVelocity(body, linear[index].tolist(), velocity[index, 3:].tolist())

    def reset(self, rows: Rows) -> None:
        """The scene's initial state."""
        for entity in self.layout.entities:
            pose = np.array([*entity.spec.pose.position, *entity.spec.pose.orientation], dtype=np.float64)
            self._put_root(rows, entity.index, np.tile(pose, (len(rows), 1)), np.zeros((len(rows), 6)))
        self._readings.positions[rows] = self.layout.joint_parameters.home
        self._readings.velocities[rows] = 0.0
        for slot in rows:
            for entity in self.layout.entities:
                self._put_joints(slot, entity.index)
        if self.loads.wrenches[rows].any():
            self.loads.wrenches[rows] = 0.0
            self.loads.derive()
        for name in ("joint_efforts", "contact_forces", "joint_wrenches"):
            getattr(self.buffers, name)[rows] = 0.0
        if self.deformables:
            with silence():
                self.deformables.reset()
        self._read(rows)

    # Deformables, of worlds with one environment ---------------------------------------------------------------------

    def write_particles(self, rows: Rows, deformable: int, positions: FloatArray, velocities: FloatArray) -> None:
        """(1, P, 3) positions and velocities."""
        assert self.deformables is not None
        with silence():
            self.deformables.write(deformable, positions[0], velocities[0])

    def anchor_particles(self, rows: Rows, deformable: int, particles: Rows, link: int | None) -> None:
        """Hold particles to a link, or to the world."""
        assert self.deformables is not None
        entity, index = -1, -1
        if link is not None:
            entity = int(self.layout.entity_of_link[link])
            index = self.stage.links[entity][link - self.layout.entities[entity].links.start]
        self.deformables.anchor(deformable, particles, entity, index)

    def release_particles(self, rows: Rows, deformable: int, particles: Rows) -> None:
        """Let particles go that are held."""
        assert self.deformables is not None
        self.deformables.release(deformable, particles)

    def cast_rays(
        self, rows: Rows, origins: FloatArray, directions: FloatArray, reach: float, past: range
    ) -> tuple[npt.NDArray[Any], ...]:
        """Distances (n, R), normals (n, R, 3) and links (n, R), none of which is one of ``past``."""
        return cast_rays(self.stage, rows, origins, directions, reach, past)

    # Parameters per environment --------------------------------------------------------------------------------------

    def _inertias(self) -> FloatArray:
        """Principal moments (L, 3) as Bullet has them."""
        found = []
        for entity in self.layout.entities:
            for index in self.stage.links[entity.index]:
                found.append(self.client.getDynamicsInfo(self.stage.bodies[0][entity.index], index)[2])
        return np.array(found).reshape(-1, 3)

    def set_wrenches(self, rows: Rows, links: Rows, wrenches: FloatArray) -> None:
        """(n, k, 6) of links (k,)."""
        self.loads.wrenches[np.ix_(rows, links)] = wrenches
        self.loads.derive()

    def set_masses(self, rows: Rows, links: Rows, masses: FloatArray) -> None:
        """(n, k) of links (k,)."""
        self.loads.masses[np.ix_(rows, links)] = masses
        self._apply_masses(rows, links)

    def _apply_masses(self, rows: Rows, links: Rows) -> None:
        for link in links:
            number = int(self.layout.entity_of_link[link])
            index = self.stage.links[number][link - self.layout.entities[number].links.start]
            if index < 0 and self.layout.entities[number].spec.fixed_base:
                continue  # it does not move
            for slot in rows:
                mass = float(self.loads.masses[slot, link])
                moments = self._nominal_inertias[link] * (mass / self.loads.nominal_masses[link])
                self.client.changeDynamics(
                    self.stage.bodies[slot][number], index, mass=mass, localInertiaDiagonal=moments.tolist()
                )
        self._gyroscopes.refresh()
        self.loads.derive()

    def set_gravity(self, rows: Rows, gravity: FloatArray) -> None:
        """(n, 3)"""
        self.loads.gravity[rows] = gravity
        self.loads.derive()

    def set_gains(self, rows: Rows, joints: Rows, stiffness: FloatArray, damping: FloatArray) -> None:
        """(n, k) of joints (k,)."""
        with silence():
            self.actuation.set_gains(rows, joints, stiffness, damping)

    def set_friction(self, rows: Rows, links: Rows, coefficients: FloatArray) -> None:
        """Set friction (n, k) of links (k,); TERRAIN selects all terrain shapes."""
        self._surfaces.set_friction(rows, links, coefficients)

    # Snapshots and the rest ------------------------------------------------------------------------------------------

    @property
    def _arrays(self) -> tuple[npt.NDArray[Any], ...]:
        buffers, loads, bodies = self.buffers, self.loads, self._readings.bodies
        return (
            buffers.joint_efforts, buffers.contact_forces, buffers.joint_wrenches, bodies, self._surfaces.friction,
            loads.gravity, loads.masses, loads.wrenches, self.actuation.stiffness, self.actuation.damping,
        )  # fmt: skip

    def save(self) -> SavedSimulation:
        """Everything that the continuation depends on, but for the commands.

        Raises:
            UnsupportedCapabilityError: the scene has deformables.
        """
        if self.deformables:
            raise UnsupportedCapabilityError("Bullet cannot restore the velocities of particles: no snapshots of them")
        return SavedSimulation(
            self.client.saveState(), self.actuation.generation, tuple(array.copy() for array in self._arrays)
        )

    def load(self, saved: SavedSimulation) -> None:
        """Return to a saved state.

        Raises:
            ConfigurationError: a joint has been given its first gains since.
        """
        if saved.generation != self.actuation.generation:
            raise ConfigurationError(
                "Bullet cannot return to a snapshot from before a joint without a drive was given gains: give it an "
                "ImplicitPd actuator in the scene"
            )
        before = [array.copy() for array in self._arrays]
        for own, kept in zip(self._arrays, saved.arrays, strict=True):
            own[...] = kept
        everything = np.arange(self.count)
        changed = [not np.array_equal(old, new) for old, new in zip(before, self._arrays, strict=True)]
        if changed[4]:
            # The indices are those of `_arrays`: 4 friction, 6 masses, 8 and 9 gains.
            self._surfaces.apply_friction(everything)
        if changed[6]:
            self._apply_masses(everything, np.flatnonzero((before[6] != self.loads.masses).any(axis=0)))
        # Only what differs is sent, because each wheel and gear costs a call.
        if changed[8] or changed[9]:
            joints = np.arange(len(self.layout.joints))
            self.set_gains(everything, joints, self.actuation.stiffness.copy(), self.actuation.damping.copy())
        self.loads.derive()
        self.client.restoreState(saved.state)
        self._read(range(self.count))

    def built_model(self) -> BuiltModel:
        """The model that Bullet holds of the first environment."""
        return read_model(self.stage, self.actuation)

    def forget(self, saved: SavedSimulation) -> None:
        """Free a snapshot that nobody holds any more."""
        self.client.removeState(saved.state)

    def close(self) -> None:
        """Free the world."""
        self.client.close()


def _normalized(quaternions: FloatArray) -> FloatArray:
    return quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)
