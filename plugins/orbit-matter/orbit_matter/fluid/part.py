"""The liquids of some environments of a world: their memory as kernels take it, and the launches of one substep."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false
# Warp's arrays and structs carry their types at run time.

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from torch import Tensor

from orbit_matter import contact, rows
from orbit_matter import kernels as particles
from orbit_matter.block import BLOCK
from orbit_matter.fluid import fluids, kernels, mixing, pairs, search
from orbit_matter.fluid.fluids import FluidModel


class FluidPart:
    """Liquids of environments in a row.

    Args:
        memory: state of these environments by name, of liquids and of all matter.
        model: of every environment.
        felt: what links of these environments feel from all matter.
        maps: :class:`~orbit_matter.fluid.maps.Maps` of hollow shapes.
    """

    def __init__(self, memory: Mapping[str, Tensor], model: FluidModel, felt: Any, maps: Any) -> None:
        self._model, self._maps = model, maps
        self._n, self._p = memory["fluid_s"].shape
        self._fluid = self._make_fluid(memory)
        is_cpu = self._fluid.x.device.is_cpu
        self._lanes = 1 if is_cpu else self._p
        """Threads for each environment of kernels that a GPU launches for each particle."""
        self._blocks = (self._n, 1 if is_cpu else BLOCK)
        """Threads of kernels of which a block takes an environment; a CPU's blocks have one thread."""
        self._is_wide = not is_cpu
        """True to launch as for a GPU: search for all particles at a time, and find walls by a thread for each."""
        self._particles = self._make_particles()
        self._felt = self._make_felt(felt)

    @property
    def _skin(self) -> float:
        """Metres by which neighbours are searched further than the kernel reaches."""
        return (fluids.SKIN if wp.get_device().is_cpu else fluids.SKIN_OF_GPU) * self._model.spacing

    def _make_fluid(self, memory: Mapping[str, Tensor]) -> Any:
        made, model, shape = kernels.Fluid(), self._model, (self._n, self._p)
        made.x, made.v = wp.from_torch(memory["fluid_x"], wp.vec3), wp.from_torch(memory["fluid_v"], wp.vec3)
        made.s, made.parameters = wp.from_torch(memory["fluid_s"]), wp.from_torch(memory["parameters"])
        made.packed = wp.from_torch(memory["fluid_packed"])
        far = (pairs.FAR, pairs.FAR, pairs.FAR, 0.0)
        made.place = wp.full((self._n, self._p + 1), far, dtype=wp.vec4)
        made.motion, made.pushed = wp.zeros_like(made.place), wp.zeros_like(made.place)
        made.rate = wp.zeros(shape, dtype=float)
        made.rest_density, made.viscosity = wp.array(model.densities), wp.array(model.viscosities)
        made.owner = wp.array(model.owners, dtype=int)
        walls = (*shape, fluids.WALLS)
        made.plane, made.filled = wp.from_torch(memory["fluid_plane"], wp.vec4), wp.from_torch(memory["fluid_filled"])
        made.drift, made.stayed = wp.from_torch(memory["fluid_drift"]), fluids.STAYED * model.spacing
        made.held, made.eased = wp.from_torch(memory["fluid_held"]), fluids.EASED
        made.left = wp.from_torch(memory["fluid_left"], wp.transform)
        made.way, made.turn = wp.zeros(made.left.shape, dtype=wp.vec3), wp.zeros(made.left.shape, dtype=wp.quat)
        made.due, made.dues = wp.zeros(shape, dtype=int), wp.zeros(self._n, dtype=int)
        made.given, made.pull = (wp.from_torch(memory[f"fluid_{name}"], wp.vec3) for name in ("given", "pull"))
        made.shape, made.walls = wp.from_torch(memory["fluid_shape"]), wp.from_torch(memory["fluid_walls"])
        made.facing = wp.zeros(walls, dtype=int)
        made.searched = wp.from_torch(memory["fluid_searched"], wp.vec3)
        made.shielded = wp.from_torch(memory["fluid_shielded"], wp.vec4)
        made.carried = wp.from_torch(memory["fluid_carried"], wp.vec3)
        made.passed = (fluids.PASSED if made.x.device.is_cpu else fluids.PASSED_OF_GPU) * model.spacing
        made.stale, made.guarded = wp.zeros(self._n, dtype=int), wp.zeros(shape, dtype=int)
        made.neighbours = self._make_lists()
        lanes = int(pairs.LANES)
        made.columns = wp.full((self._n, 3, math.ceil(self._p / lanes) * lanes), pairs.FAR, dtype=float)
        made.moved = wp.zeros(shape, dtype=int)
        made.nearby = wp.zeros((self._n, 1, self._p), dtype=int)
        made.count, made.following = wp.zeros(shape, dtype=int), wp.zeros(shape, dtype=int)
        made.head = wp.zeros((self._n, 1 << (2 * self._p - 1).bit_length()), dtype=int)
        made.spacing, made.length, made.sound = model.spacing, model.length, model.sound
        made.ratio = fluids.SMOOTHING
        made.volume = model.spacing**3
        made.slope, made.peak = fluids.kernel_of(model.spacing)
        made.maps = self._maps
        made.renewal = 1.0 / fluids.RENEWED
        made.rough = model.roughness
        made.smooth = fluids.SMOOTHNESS * model.length * model.sound
        made.cell = 2.0 * model.length + self._skin
        return made

    def _make_lists(self) -> Any:
        """Return (N, P, K) zeros: on a GPU the first neighbours of all particles side by side, then the second ones."""
        if wp.get_device().is_cpu:
            return wp.zeros((self._n, self._p, fluids.NEIGHBOURS), dtype=int)
        return wp.zeros((self._n, fluids.NEIGHBOURS, self._p), dtype=int).transpose((0, 2, 1))

    def _make_particles(self) -> Any:
        """Return the particles as the kernels that find shapes near them take them."""
        made = particles.Particles()
        made.x, made.v = self._fluid.x, self._fluid.v
        made.exempt = wp.full((self._n, self._p), int(particles.FREE), dtype=int)
        made.radius = wp.full(self._p, 2.0 * self._model.length, dtype=float)
        made.owner, made.parameters = self._fluid.owner, self._fluid.parameters
        return made

    def _make_felt(self, felt: Any) -> Any:
        made = contact.Felt()
        made.forces, made.torques, made.friction, made.holds = felt.forces, felt.torques, felt.friction, felt.holds
        made.near = wp.full((self._n, self._p, int(contact.NEAREST)), -1, dtype=int)
        return made

    def shapes_inside(self, links: Any, shapes: Any) -> np.ndarray:
        """Return the (n, P) shape that each particle is inside of; -1 for none."""
        found = wp.zeros((self._n, self._p), dtype=int)
        wp.launch(kernels.find_inside, (self._n, self._p), inputs=[self._fluid, links, shapes, found])
        return found.numpy()

    def launch_near(self, links: Any, shapes: Any, physics_dt: float) -> None:
        """Find the shapes that particles may meet in a physics step."""
        inputs = [self._particles, links, shapes, self._felt, physics_dt]
        if self._is_wide:
            wp.launch(contact.find_near, (self._n, self._p), inputs=inputs)
        else:
            wp.launch(rows.find_near, self._n, inputs=inputs)

    def launch_push(self, links: Any, shapes: Any, gravity: Any, h: float, share: float, first: bool) -> None:
        """Begin a substep, a ``share`` of a physics step, against links at its end: find what presses, and on what.

        On a GPU walls are found again for all particles in the ``first`` substep of a physics step.
        """
        f = self._fluid
        f.stale.zero_()
        # Two that come from half of the skin each are just within the kernel's reach.
        most = 0.5 * self._skin
        if self._is_wide:
            wp.launch(kernels.carry, self._blocks, inputs=[f], block_dim=BLOCK)
        else:
            wp.launch(kernels.carry_on, self._n, inputs=[f, h])
        wp.launch(kernels.leave, f.left.shape, inputs=[f, links])
        if first and self._is_wide:
            inputs = [f, links, shapes, self._felt, gravity, h, most]
            wp.launch(kernels.meet, (self._n, self._p), inputs=inputs)
        else:
            f.dues.zero_()
            inputs = [f, links, self._felt, gravity, h, most, self._lanes]
            wp.launch(kernels.approach, (self._n, self._lanes), inputs=inputs)
            inputs = [f, links, shapes, self._felt, gravity, h]
            wp.launch(kernels.renew, self._blocks, inputs=inputs, block_dim=BLOCK)
        self._launch_search(renewed=1)
        inputs = [f, links, shapes, self._felt, gravity, h, share]
        wp.launch(kernels.push, self._blocks, inputs=inputs, block_dim=BLOCK)
        if len(self._model.deformables) > 1:
            wp.launch(mixing.mix, (self._n, self._lanes), inputs=[f, h, self._lanes])

    def launch_flow(self, links: Any, shapes: Any, gravity: Any, h: float, share: float) -> None:
        """End the substep: let particles flow, against links that have answered the push."""
        f = self._fluid
        wp.launch(kernels.flow, self._blocks, inputs=[f, links, shapes, gravity, h], block_dim=BLOCK)
        inputs = [f, links, shapes, self._felt, h, share, self._lanes]
        wp.launch(kernels.move, (self._n, self._lanes), inputs=inputs)

    def search_again(self) -> None:
        """Find the neighbours that the last search found, from where particles then were."""
        self._fluid.stale.fill_(1)
        self._launch_search(renewed=0)

    def _launch_search(self, renewed: int) -> None:
        f, shape = self._fluid, (self._n, self._p)
        is_compared = self._p <= search.COMPARED
        if is_compared and not self._is_wide:
            wp.launch(search.follow, self._n, inputs=[f, 0.5 * self._skin, renewed])
            return
        wp.launch(search.note, (self._n, self._lanes), inputs=[f, renewed, self._lanes])
        if is_compared:
            wp.launch(search.compare, (self._n, int(search.SEARCHERS)), inputs=[f], block_dim=BLOCK)
        else:
            wp.launch(search.clear, (self._n, int(search.CLEARERS)), inputs=[f])
            wp.launch(search.insert, shape, inputs=[f])
            wp.launch(search.find, shape, inputs=[f])
