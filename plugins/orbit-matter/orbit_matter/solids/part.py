"""The solids of some environments of a world: their memory as kernels take it, and the launches of one step."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false
# Warp's arrays and structs carry their types at run time.

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from torch import Tensor

from orbit_matter import contact
from orbit_matter import kernels as particles
from orbit_matter import rows as particle_rows
from orbit_matter.solids import inside, kernels, launches, rows
from orbit_matter.solids.kernels import LANES, PARTS
from orbit_matter.solids.model import SolidModel

SKIN = 5e-4
"""Metres within a link's surface up to which a point of a solid that is attached there does not collide with it."""


class SolidPart:
    """Solids of environments in a row.

    Args:
        memory: state of these environments by name, as of :func:`orbit_matter.solids.solids.state`, and of all matter.
        model: of every environment.
        felt: what links of these environments feel from all matter.
        bodies: free bodies of these environments.
        h: seconds of a step.
        iterations: of conjugate gradients in a step.
    """

    def __init__(
        self,
        memory: Mapping[str, Tensor],
        model: SolidModel,
        felt: Any,
        bodies: Any,
        damping: np.ndarray,
        h: float,
        iterations: int,
    ) -> None:
        self._model, self._h, self._iterations, self._free = model, h, iterations, bodies
        self._n, self._bodies = len(memory["solid_x"]), len(model.deformables)
        self._device = memory["solid_x"].device
        self._solids = self._make_solids(memory, damping)
        self._solve = self._make_solve()
        self._sites = self._make_sites(memory)
        self._gather = self._make_gather()
        self._points, self._held = self._make_particles(memory)
        self._felt = self._make_felt(felt)

    @property
    def _groups(self) -> int:
        """Number of groups of environments that share a pass over the preconditioner."""
        return -(-self._n // int(kernels.FOUR))

    def _make_solids(self, memory: Mapping[str, Tensor], damping: np.ndarray) -> Any:
        made, model = kernels.Solids(), self._model
        for name, field in (("x", "x"), ("v", "v"), ("before", "before"), ("d", "d")):
            setattr(made, field, wp.from_torch(memory[f"solid_{name}"], wp.vec3))
        made.turn, made.body_turn = (wp.from_torch(memory[f"solid_{name}"], wp.quat) for name in ("turn", "body_turn"))
        made.fresh = wp.from_torch(memory["solid_fresh"])
        made.parameters = wp.from_torch(memory["parameters"])
        made.mass = wp.array(model.masses)
        made.owner, made.damping = _ints(model.deformables), wp.array(damping, dtype=float)
        made.cells, made.kind = wp.array(model.cells, dtype=int), _ints(model.kinds)
        made.body = _ints(np.repeat(np.arange(self._bodies), np.diff(model.first_node)))
        made.cell_body = _ints(np.repeat(np.arange(self._bodies), np.diff(model.first_cell)))
        made.size = wp.array(np.array([part.size for part in model.embeddings], np.float32), dtype=wp.vec3)
        made.first_cell, made.first_node = _ints(model.first_cell), _ints(model.first_node)
        made.first_row, made.inverse_at = _ints(model.first_row), wp.array(model.inverse_at, dtype=int)
        columns = np.ascontiguousarray(model.stiffness.transpose(0, 2, 1))
        made.stiffness, made.flat = _shared(columns, kernels.Column)
        made.inverse, made.flat_inverse = _shared(model.inverses, kernels.Lanes)
        made.load = wp.from_torch(memory["solid_load"], wp.vec3)
        made.inside = self._make_insides(made)
        return made

    def _make_insides(self, solids: Any) -> Any:
        made, model = inside.Insides(), self._model
        for name in ("x", "d", "cells", "cell_body", "first_cell", "first_node", "size"):
            setattr(made, name, getattr(solids, name))
        # Without lattices nothing meets a solid from within, and kernels skip the search.
        made.meets = int(bool(model.lattices))
        made.low, made.high = (wp.zeros((self._n, self._bodies), dtype=wp.vec3) for _ in range(2))
        made.inner = wp.zeros((self._n, len(model.cells)), dtype=wp.mat33)
        made.middle = wp.array(model.middles, dtype=wp.vec3)
        made.touches, made.reach = _ints(model.touches), wp.array(model.reach, dtype=float)
        made.share = wp.array(model.shares, dtype=float)
        lattices = model.lattices
        made.begin, made.spacing = (
            wp.array(np.array(rows, np.float32).reshape(-1, 3), dtype=wp.vec3)
            for rows in ([each.low for each in lattices], [each.spacing for each in lattices])
        )
        counts = np.array([each.values.shape for each in lattices], np.int32)
        made.count = wp.array(counts.reshape(-1, 3), dtype=wp.vec3i)
        made.at = _ints(np.cumsum([0, *(each.values.size for each in lattices)])[:-1])
        # An empty array in front: kernels need one even where there are no lattices.
        distances = [each.values.ravel() for each in lattices]
        made.distance = wp.array(np.concatenate([np.zeros(0, np.float32), *distances]), dtype=float)
        return made

    def _make_solve(self) -> Any:
        made, nodes = kernels.Solve(), len(self._model.nodes)
        for name in ("delta", "r", "z", "p", "q"):
            setattr(made, name, wp.zeros((self._n, nodes), dtype=wp.vec3))
        count = int(self._model.first_row[-1])
        eights = -(-self._n // int(launches.EIGHT))
        made.fours, made.flat_fours = _shared(np.zeros((2 * eights, count, 4), np.float32), wp.vec4)
        made.rows, made.out = (wp.zeros((self._n, count), dtype=float) for _ in range(2))
        # A CPU writes LANES numbers at a time and reads them one by one.
        blocks = made.out.reshape((self._n, count // LANES, LANES))
        made.out_lanes = wp.array(
            ptr=blocks.ptr, dtype=kernels.Lanes, shape=(self._n, count // LANES), device=blocks.device
        )
        for name in ("rz", "step", "turned"):
            setattr(made, name, wp.zeros((self._n, self._bodies), dtype=float))
        for name in ("rz_parts", "pq_parts"):
            setattr(made, name, wp.zeros((self._n, self._bodies, PARTS), dtype=float))
        made.preset, made.group = (wp.zeros((self._n, self._bodies), dtype=int) for _ in range(2))
        return made

    def _make_sites(self, memory: Mapping[str, Tensor]) -> Any:
        made, model = kernels.Sites(), self._model
        shape = (self._n, len(model.site_cells))
        made.x, made.v = (wp.from_torch(memory[f"site_{name}"], wp.vec3) for name in "xv")
        made.cell, made.weights = _ints(model.site_cells), wp.array(model.weights, dtype=float)
        made.stiffness, made.hold = wp.array(model.firmness, dtype=wp.mat33), wp.array(model.holds, dtype=float)
        made.set, made.whole = _ints(model.attached), wp.zeros(shape, dtype=float)
        cell_body = np.repeat(model.deformables, np.diff(model.first_cell))
        made.owner, made.contacts = _ints(cell_body[model.site_cells]), model.contacts
        made.blocked = wp.zeros(self._free.link.shape, dtype=float)
        made.firm_parts = wp.zeros((*self._free.link.shape, PARTS), dtype=float)
        made.active = wp.full(shape, -1, dtype=int)
        made.link, made.force = wp.from_torch(memory["site_link"]), wp.from_torch(memory["site_force"], wp.vec3)
        made.normal, made.last, made.pull = (wp.zeros(shape, dtype=wp.vec3) for _ in range(3))
        made.firm, made.limit = wp.zeros(shape, dtype=wp.vec2), wp.zeros(shape, dtype=float)
        made.stuck, made.place = wp.from_torch(memory["site_stuck"]), wp.from_torch(memory["site_place"], wp.vec3)
        made.press = wp.from_torch(memory["site_press"], wp.vec2)
        made.per_area = wp.array(model.per_area, dtype=float)
        made.count = wp.zeros(self._n, dtype=int)
        made.mate, made.mate_at = wp.full(shape, -1, dtype=int), wp.zeros(shape, dtype=wp.vec3)
        made.rest = wp.array(model.contact_rest, dtype=wp.vec3)
        return made

    def _make_gather(self) -> Any:
        made, model = launches.Gather(), self._model
        flat = model.cells.ravel()
        # Stable orders make sums over cells and sites the same in every run.
        order = np.argsort(flat, kind="stable")
        made.first = _ints(np.searchsorted(flat[order], np.arange(len(model.nodes) + 1)))
        made.cell, made.local = _ints(order // 27), _ints(order % 27)
        by_cell = np.argsort(model.site_cells, kind="stable")
        made.first_site = _ints(np.searchsorted(model.site_cells[by_cell], np.arange(len(model.cells) + 1)))
        made.site = _ints(by_cell)
        made.pull = wp.zeros((self._n, len(flat)), dtype=wp.vec3)
        made.busy = wp.zeros((self._n, len(model.cells)), dtype=int)
        return made

    def _make_particles(self, memory: Mapping[str, Tensor]) -> tuple[Any, Any]:
        """Return the points of contact and the vertices, as the kernels of colliders and of attachments take them."""
        found, count = [], self._model.contacts
        owner = self._sites.owner.numpy()
        for columns in (slice(0, count), slice(count, None)):
            made, wide = particles.Particles(), memory["site_x"][:, columns]
            made.x = wp.from_torch(wide, wp.vec3)
            made.v = wp.from_torch(memory["site_v"][:, columns], wp.vec3)
            made.anchor = wp.from_torch(memory["site_anchor"][:, columns])
            made.place = wp.from_torch(memory["site_held"][:, columns], wp.vec3)
            made.exempt = wp.from_torch(memory["site_exempt"][:, columns])
            made.radius = wp.full(wide.shape[1], SKIN, dtype=float)
            made.owner, made.parameters = _ints(owner[columns]), self._solids.parameters
            found.append(made)
        return found[0], found[1]

    def _make_felt(self, felt: Any) -> Any:
        made = contact.Felt()
        made.forces, made.torques, made.friction = felt.forces, felt.torques, felt.friction
        made.holds = wp.zeros(felt.holds.shape, dtype=int)
        made.near = wp.full((self._n, self._model.contacts, int(contact.NEAREST)), -1, dtype=int)
        return made

    @property
    def takes_rows(self) -> bool:
        """Return True if one launch thread takes an environment, and not a cell, a site or a node."""
        return self._device.type == "cpu"

    def hold(self, links: Any, shapes: Any, mine: Any) -> None:
        """Hold what is held where it is, in environments chosen by ``mine`` (n,) bool."""
        vertices, points = self._held.x.shape[1], self._points.x.shape[1]
        wp.launch(launches.show, (self._n, len(self._model.site_cells)), inputs=[self._solids, self._sites])
        wp.launch(particles.hold, (self._n, vertices), inputs=[self._held, links, mine])
        inputs = [self._held, self._felt, mine]
        wp.launch(contact.find_holders, (self._n, self._felt.holds.shape[1]), inputs=inputs)
        inputs = [self._points, links, shapes, self._felt, mine]
        wp.launch(contact.exempt_inside, (self._n, points), inputs=inputs)

    def depths(self, links: Any, shapes: Any, farthest: float) -> np.ndarray:
        """Return how deep (m) the points of each deformable are in each shape, (D, S), up to ``farthest`` in meshes."""
        found = wp.zeros((self._solids.parameters.shape[1], shapes.kind.shape[1]), dtype=float)
        inputs = [self._points, links, shapes, self._felt.torques.shape[1], farthest, found]
        wp.launch(contact.sound, (self._n, self._points.x.shape[1]), inputs=inputs)
        return found.numpy()

    def orient(self, number: int, mine: Any) -> None:
        """Find the rotations of a solid from scratch, in environments chosen by ``mine`` (n,) bool."""
        wp.launch(launches.orient, self._n, inputs=[self._solids, number, mine])
        wp.launch(launches.show, (self._n, len(self._model.site_cells)), inputs=[self._solids, self._sites])

    def launch_near(self, links: Any, shapes: Any, gravity: Any, physics_dt: float) -> None:
        """Find the shapes that points may meet in a physics step, and which free bodies the engine holds."""
        wp.launch(launches.block, self._free.link.shape, inputs=[self._sites, self._free, gravity])
        inputs = [self._points, links, shapes, self._felt, physics_dt]
        if self.takes_rows:
            wp.launch(particle_rows.find_near, self._n, inputs=inputs)
        else:
            wp.launch(contact.find_near, (self._n, self._points.x.shape[1]), inputs=inputs)

    def launch_push(self, links: Any, lasting: bool) -> None:
        """Move free bodies by what solids did to them last: before a step for as long as it takes, or after it."""
        inputs = [self._sites, self._free, links, self._h**2, int(lasting)]
        wp.launch(launches.push, self._free.link.shape, inputs=inputs)

    def launch_lay(self, others: Any, stiffness: float, h: float, share: float) -> None:
        """Move particles of other matter out of solids, at the end of a substep that is a ``share`` of a step."""
        wp.launch(launches.lay, others.x.shape, inputs=[others, self._solids, stiffness, h, share])

    def launch_step(self, links: Any, shapes: Any, gravity: Any, share: float) -> None:
        """Advance by one step of the solids, a ``share`` of a physics step, against links where it ends."""
        if self.takes_rows:
            self._launch_rows(links, shapes, gravity, share)
        else:
            self._launch_wide(links, shapes, gravity, share)

    def _launch_rows(self, links: Any, shapes: Any, gravity: Any, share: float) -> None:
        s, t, solve, h = self._solids, self._sites, self._solve, self._h
        wp.launch(rows.begin, self._n, inputs=[s, solve, gravity, h])
        inputs = [s, t, solve, self._held, links, shapes, self._felt, self._free, h]
        wp.launch(rows.meet, self._n, inputs=inputs)
        wp.launch(rows.ready, self._n, inputs=[s, solve])
        blocks = (int(self._model.first_row[-1]) // LANES, self._groups)
        for iteration in range(self._iterations):
            wp.launch(rows.precondition, blocks, inputs=[s, solve])
            wp.launch(rows.iterate, self._n, inputs=[s, t, solve, h, int(iteration == 0)])
        wp.launch(rows.conclude, self._n, inputs=[s, t, solve, links, self._felt, h, share])

    def _launch_wide(self, links: Any, shapes: Any, gravity: Any, share: float) -> None:
        s, t, solve, g, n, h = self._solids, self._sites, self._solve, self._gather, self._n, self._h
        cells, nodes, sites = len(self._model.cells), len(self._model.nodes), len(self._model.site_cells)
        eights = len(solve.fours) // 2
        wp.launch(launches.turn_bodies, (n, self._bodies), inputs=[s])
        wp.launch(launches.turn, (n, cells), inputs=[s, g])
        wp.launch(launches.strain, (n, 27 * cells), inputs=[s, g, h])
        wp.launch(launches.meet, (n, sites), inputs=[s, t, g, self._held, links, shapes, self._felt])
        wp.launch(launches.firmness, (*self._free.link.shape, PARTS), inputs=[t, self._free])
        wp.launch(launches.soften, (n, sites), inputs=[t, self._free, links, h])
        wp.launch(launches.choose, (n, self._bodies), inputs=[s, t, solve, self._held])
        wp.launch(launches.begin, (n, nodes), inputs=[s, t, solve, g, gravity, h])
        for iteration in range(self._iterations):
            wp.launch(launches.precondition, (eights, int(self._model.first_row[-1])), inputs=[s, solve])
            wp.launch(launches.aim, (n, self._bodies, PARTS), inputs=[s, solve])
            wp.launch(launches.direct, (n, nodes), inputs=[s, solve, int(iteration == 0)])
            wp.launch(launches.bend, (n, 27 * cells), inputs=[s, solve, g, h])
            wp.launch(launches.resist, (n, sites), inputs=[s, t, solve, g])
            wp.launch(launches.apply, (n, nodes), inputs=[s, t, solve, g, h])
            wp.launch(launches.measure, (n, self._bodies, PARTS), inputs=[s, solve])
            wp.launch(launches.advance, (n, nodes), inputs=[s, solve])
        wp.launch(launches.let_slip, (n, sites), inputs=[s, t, links, solve])
        wp.launch(launches.conclude, (n, nodes), inputs=[s, solve, h])
        wp.launch(launches.age, (n, self._bodies), inputs=[s])
        wp.launch(launches.show, (n, sites), inputs=[s, t])
        wp.launch(launches.press, (n, self._felt.torques.shape[1]), inputs=[t, self._felt, links, share])


def _ints(values: Any) -> Any:
    return wp.array(np.asarray(values, np.int32), dtype=int)


def _shared(numbers: np.ndarray, kind: Any) -> tuple[Any, Any]:
    """Return an array of vectors, which the last axis holds, and one of their numbers, with the same memory."""
    flat = wp.array(np.ascontiguousarray(numbers, np.float32), dtype=float)
    return wp.array(ptr=flat.ptr, dtype=kind, shape=numbers.shape[:-1], device=flat.device), flat
