"""Cloth, rope and solids of MuJoCo's own, in all environments at once: read, written, held, damped and measured."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from mujoco.batch import Batch
from torch import Tensor

from orbit_core.interfaces import MAX_DISTANCE, MAX_SPEED, UnsupportedCapabilityError
from orbit_core.plugin_kit.rotations import cross, rotate, rotate_inverse
from orbit_core.plugin_kit.rows import HostRows, block
from orbit_core.scene import Cloth, Rope
from orbit_mjmodel.addresses import Addresses
from orbit_mjmodel.chains import chain_positions, chain_velocities, tips
from orbit_mjmodel.matter import MatterAddresses, axial_inertia, piece_lengths
from orbit_mujoco.measurements import MatterMeter
from orbit_mujoco.parameters import Parameters
from orbit_mujoco.state import FloatArray, State


class NativeMatter:
    """The deformables of a batch; with none it does nothing."""

    def __init__(
        self,
        batch: Batch,
        addresses: Addresses,
        matter: Sequence[MatterAddresses],
        parameters: Parameters,
        state: State,
    ) -> None:
        self._batch, self._addresses, self._matter = batch, addresses, matter
        self._model: mujoco.MjModel = batch.model
        self._parameters, self._state = parameters, state
        self._step: float = batch.model.opt.timestep
        # That of a solid is of its material, and is in its flex.
        self._drags = [one.grid is None and (one.spec.damping > 0.0 or isinstance(one.spec, Rope)) for one in matter]
        self.damped = any(self._drags)
        """Whether :meth:`damp` has anything to do before each physics step."""
        self.bends = any(not isinstance(one.spec, Rope) for one in matter)
        """True if MuJoCo warns, at the rounding of its solver, of cloth and solids that are stiff."""
        self._qpos, self._qvel = batch.bind("qpos"), batch.bind("qvel")
        self._xpos, self._xquat, self._xipos = batch.bind("xpos"), batch.bind("xquat"), batch.bind("xipos")
        self._cvel, self._subtree_com = batch.bind("cvel"), batch.bind("subtree_com")
        self._qfrc, self._xfrc = batch.bind("qfrc_applied"), batch.bind("xfrc_applied")
        self._active = batch.bind("eq_active")
        self._rest = [one.spec.pose.transform(one.spec.rest_positions) for one in matter]
        self._lengths = [piece_lengths(one.spec) if isinstance(one.spec, Rope) else np.zeros(0) for one in matter]
        if matter:
            self._places, self._holders = parameters.field("eq_data"), parameters.field("eq_obj2id")

    # State -----------------------------------------------------------------------------------------------------------

    def positions(self, deformable: int) -> Tensor:
        """(N, P, 3) m."""
        return torch.from_numpy(self._positions(deformable).astype(np.float32))

    def _positions(self, deformable: int) -> FloatArray:
        one = self._matter[deformable]
        if not isinstance(one.spec, Rope):
            moved = self._qpos[:, one.positions].reshape(self._batch.nsim, -1, 3)
            return self._rest[deformable] + (moved if one.grid is None else one.grid.weights @ moved)
        self._state.derive()
        starts, frames = self._xpos[:, one.bodies], self._xquat[:, one.bodies]
        end = tips(starts[:, -1], frames[:, -1], self._lengths[deformable][-1])
        return np.concatenate((starts, end[:, None]), axis=1)

    def velocities(self, deformable: int) -> Tensor:
        """(N, P, 3) m/s."""
        one = self._matter[deformable]
        if not isinstance(one.spec, Rope):
            found = self._qvel[:, one.velocities].reshape(self._batch.nsim, -1, 3)
            found = found if one.grid is None else one.grid.weights @ found
        else:
            self._state.derive()
            starts, last = self._xpos[:, one.bodies], self._positions(deformable)[:, -1:]
            first, spins = self._velocities_at(one, starts), self._cvel[:, one.bodies, :3]
            end = first[:, -1:] + cross(spins[:, -1:], last - starts[:, -1:])
            found = np.concatenate((first, end), axis=1)
        return torch.from_numpy(found.astype(np.float32))

    def _velocities_at(self, one: MatterAddresses, points: FloatArray) -> FloatArray:
        """(N, P - 1, 3) of a point on each piece of a rope; ``cvel`` is that at the rope's centre of mass."""
        spatial, middle = self._cvel[:, one.bodies], self._subtree_com[:, one.bodies.start, None]
        return spatial[..., 3:] + cross(spatial[..., :3], points - middle)

    def write(self, deformable: int, positions: FloatArray, velocities: FloatArray, rows: HostRows) -> None:
        """Set (n, P, 3) positions and velocities: ropes keep their lengths, solids take what their grid can."""
        one = self._matter[deformable]
        if not isinstance(one.spec, Rope):
            moved = positions - self._rest[deformable]
            if one.grid is not None:
                moved, velocities = one.grid.fit @ moved, one.grid.fit @ velocities
            self._qpos[rows, one.positions] = moved.reshape(len(positions), -1)
            self._qvel[rows, one.velocities] = velocities.reshape(len(velocities), -1)
        else:
            # A chain cannot stretch, so that only the directions of what was asked for can be taken.
            coordinates = chain_positions(positions)
            self._qpos[rows, one.positions] = coordinates
            self._qvel[rows, one.velocities] = chain_velocities(positions, velocities, coordinates)
        self._state.mark_written(rows)

    def diverged(self) -> tuple[list[int], list[str]]:
        """Environments with a deformable beyond the bounds of divergence, and the names of those deformables."""
        wrong, names = np.zeros(self._batch.nsim, dtype=bool), []
        for one in self._matter:
            far = ~(np.abs(self._qpos[:, one.positions]) <= MAX_DISTANCE).all(1)
            beyond = far | ~(np.abs(self._qvel[:, one.velocities]) <= MAX_SPEED).all(1)
            names += [one.spec.name] if beyond.any() else []
            wrong |= beyond
        return np.flatnonzero(wrong).tolist(), names

    # Still air -------------------------------------------------------------------------------------------------------

    def damp(self) -> None:
        """Before a physics step: the drag that slows everything by its deformable's rate, as exactly as a force can.

        What stops the spin of a rope's pieces about their own axes goes with it: round pieces would roll.
        """
        self._state.derive()
        for one, drags in zip(self._matter, self._drags, strict=True):
            if not drags:
                continue
            # The force that slows exactly by exp(-rate h) over an explicit step; rate itself would overshoot at large
            # steps.
            rate = -np.expm1(-one.spec.damping * self._step) / self._step
            masses = self._parameters.masses[..., one.bodies]
            if isinstance(one.spec, Cloth):
                self._qfrc[:, one.velocities] = -rate * np.repeat(masses, 3, -1) * self._qvel[:, one.velocities]
            elif isinstance(one.spec, Rope):
                speeds = self._velocities_at(one, self._xipos[:, one.bodies])
                self._xfrc[:, one.bodies, :3] = -rate * masses[..., None] * speeds
                axes = rotate(self._xquat[:, one.bodies], np.array((1.0, 0.0, 0.0)))
                spins = (axes * self._cvel[:, one.bodies, :3]).sum(-1)
                stopping = -axial_inertia(one.spec, masses) * spins / self._step
                self._xfrc[:, one.bodies, 3:] = stopping[..., None] * axes

    # What is held ----------------------------------------------------------------------------------------------------

    def anchor(self, deformable: int, particles: npt.NDArray[np.int64], link: int | None, rows: HostRows) -> None:
        """Hold particles (k,) where they are to a link, or to the world if None."""
        columns = self._matter[deformable].anchors.start + particles
        index = block(rows, columns)
        self._holders[index] = 0 if link is None else self._addresses.bodies[link]
        self._active[index] = 1.0
        self.hold(rows)
        self._state.mark_written(rows)

    def release(self, deformable: int, particles: npt.NDArray[np.int64], rows: HostRows) -> None:
        """Let particles (k,) go."""
        self._active[block(rows, self._matter[deformable].anchors.start + particles)] = 0.0

    def held(self, rows: HostRows) -> FloatArray:
        """Mask of the active constraints, restored after a reset."""
        return self._active[rows].copy() if self._matter else np.zeros(0)

    def hold_again(self, held: FloatArray, rows: HostRows) -> None:
        """After a reset: what was held is held where the reset has put it."""
        if self._matter:
            for one in self._matter:
                self._active[rows, one.anchors] = held[:, one.anchors]
            self.hold(rows)

    def hold(self, rows: HostRows) -> None:
        """Hold the particles of active constraints at their current positions."""
        if not any(self._active[rows, one.anchors].any() for one in self._matter):
            return
        self._state.derive()
        for deformable, one in enumerate(self._matter):
            # Of a solid the node is held that carries the vertex: constraints hold bodies.
            carried = self._positions(deformable) if one.grid is None else self._carriers(one)
            points = carried[rows]
            holders = self._holders[rows, one.anchors]
            numbers = np.arange(self._batch.nsim)[rows, None]
            places, frames = self._xpos[numbers, holders], self._xquat[numbers, holders]
            self._places[rows, one.anchors, 3:6] = rotate_inverse(frames, points - places)

    def _carriers(self, one: MatterAddresses) -> FloatArray:
        """(N, P, 3) m of the nodes that carry a solid's vertices."""
        assert one.grid is not None
        return self._xpos[:, one.bodies.start + one.grid.nearest()]

    def measure(self, meter: MatterMeter) -> None:
        """After a step: have the forces on links taken."""
        if self._matter:
            meter.read(self._holders)

    # Parameters ------------------------------------------------------------------------------------------------------

    def set_parameter(self, deformable: int, name: str, values: FloatArray, rows: HostRows) -> None:
        """Set (n,) of one of :data:`orbit_core.interfaces.matter.PARAMETERS`.

        Raises:
            UnsupportedCapabilityError: the axial stiffness of a rope, whose pieces are stiff.
        """
        one, parameters = self._matter[deformable], self._parameters
        rope = isinstance(one.spec, Rope)
        if name == "density":
            parameters.scale_masses(one.bodies, values, rows)
        elif name == "friction":
            if rope:
                parameters.field("geom_friction")[(*block(rows, one.own_geoms(self._model)), 0)] = values[:, None]
            else:
                parameters.field("flex_friction")[rows, one.flex(self._model), 0] = values
        elif rope and name == "stiffness":
            raise UnsupportedCapabilityError(
                f"MuJoCo's own ropes do not stretch, so '{one.spec.name}' has no axial stiffness to set: "
                "choose a matter solver"
            )
        elif rope:
            # The first piece hangs on its free joint, which has no spring.
            joints = self._model.body_jntadr[one.bodies][1:]
            parameters.scale("jnt_stiffness", joints, values, rows)
            parameters.scale("dof_damping", np.arange(one.velocities.start + 6, one.velocities.stop), values, rows)
        else:
            parameters.scale(*self._elasticity(deformable, name), values, rows)

    def _elasticity(self, deformable: int, name: str) -> tuple[str, npt.NDArray[np.int64]]:
        """The field of a cloth's membrane or bending stiffness or of a solid's, and where in it they are."""
        field, starts, size = {
            "stiffness": ("flex_stiffness", self._model.flex_stiffnessadr, self._model.nflexstiffness),
            "bending": ("flex_bending", self._model.flex_bendingadr, self._model.nflexbending),
        }[name]
        flex = self._matter[deformable].flex(self._model)
        later = [start for start in starts[flex + 1 :] if start >= 0]
        return field, np.arange(starts[flex], later[0] if later else size) if starts[flex] >= 0 else np.arange(0)
